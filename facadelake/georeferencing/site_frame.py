"""The site frame of a building, as georeferencing needs it."""

from __future__ import annotations

from dataclasses import dataclass

from facadelake.core.geodesy import SiteOrigin


@dataclass(frozen=True, kw_only=True)
class SiteFrame:
    """The site frame and the georeference of its model.

    ``origin``: origin of the site frame; ``map_crs``: the model's projected CRS; ``vertical_datum``: "ellipsoidal" or a
    vertical CRS; ``georeference_level``: how the model states its georeference (LoGeoRef, Clemen and Goerne 2019).
    """

    origin: SiteOrigin
    map_crs: str
    vertical_datum: str
    georeference_level: str
