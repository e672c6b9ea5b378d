"""The demo building: IFC model, photographs, annotations and truth, all generated from one recipe."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
