"""Facades: outward directions of elements, clustered and named by compass."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
