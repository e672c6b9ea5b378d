"""Control by the building model: point-to-plane alignment, edges in the photographs, plumb lines."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
