"""Georeferencing: a campaign's block brought into site by one adjustment with control, and its poses."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
