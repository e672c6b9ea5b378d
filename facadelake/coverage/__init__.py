"""Coverage: which parts of the facades a campaign's photographs show, and how small a defect would be found there."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
