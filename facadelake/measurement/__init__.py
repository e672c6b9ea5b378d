"""Length and width of cracks in photographs, in pixels, with standard deviations and resolution limits."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
