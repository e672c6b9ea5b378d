"""Where the site frame of a building lies, as georeferencing needs it."""

from __future__ import annotations

from dataclasses import dataclass

from facadelake.core.geodesy import SiteOrigin


@dataclass(frozen=True, kw_only=True)
class SiteFrame:
    """Where the site frame lies: its origin, the model's projected CRS and vertical datum ("ellipsoidal" or a vertical
    CRS), and how the model is georeferenced (LoGeoRef)."""

    origin: SiteOrigin
    map_crs: str
    vertical_datum: str
    georeference_level: str
