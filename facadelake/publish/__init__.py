"""Publishing: releases of a campaign (GeoParquet, GeoPackage, README.txt, report) and export of single tables."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
