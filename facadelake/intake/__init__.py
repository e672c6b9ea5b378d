"""Intake: uploads in a folder or an S3 prefix are observed, found complete, checked, and received as campaigns."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
