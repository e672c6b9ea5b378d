"""What is to be inspected, when, in which order, and what each campaign needs; knows no Prefect."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
