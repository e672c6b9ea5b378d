"""Detection in photographs of any size: tile passes and the merging of their detections."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
