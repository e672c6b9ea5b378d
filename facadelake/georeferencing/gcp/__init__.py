"""Control by surveyed points: OpenDroneMap's gcp_list.txt, image marks, and the placement by them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
