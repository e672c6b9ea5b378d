"""Control by an earlier campaign: its reference points, and their recognition among later tie points."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
