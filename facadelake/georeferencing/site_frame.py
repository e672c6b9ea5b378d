"""The site frame of a building, as georeferencing needs it."""

from __future__ import annotations

from dataclasses import dataclass

from facadelake.core.geodesy import SiteOrigin
from facadelake.core.proj.crs import GEO


@dataclass(frozen=True, kw_only=True)
class SiteFrame:
    """The site frame and the georeference of its model.

    ``origin``: origin of the site frame; ``map_crs``: the model's projected CRS; ``vertical_datum``: "ellipsoidal" or a
    vertical CRS; ``georeference_level``: how the model states its georeference (LoGeoRef, Clemen and Goerne 2019);
    ``model_remarks``: the assumptions made to place the model, which the passport repeats. ``gnss_crs``: geographic CRS
    of the photographs' positions. ``accepted_operation_accuracy_m``: worst accuracy of a coordinate operation that is
    accepted where a better one lacks its grid; None: none.
    """

    origin: SiteOrigin
    map_crs: str
    vertical_datum: str
    georeference_level: str
    model_remarks: str = ""
    gnss_crs: str = GEO
    accepted_operation_accuracy_m: float | None = None

    def list_model_remarks(self) -> list[str]:
        """The assumptions as remarks of the passport."""
        return [f"model: {remark}" for remark in self.model_remarks.split("; ") if remark]
