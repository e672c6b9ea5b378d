"""The site frame of a building, as georeferencing needs it."""

from __future__ import annotations

from dataclasses import dataclass

from facadelake.core.geodesy import SiteOrigin


@dataclass(frozen=True, kw_only=True)
class SiteFrame:
    """The site frame and the georeference of its model.

    ``origin``: origin of the site frame; ``map_crs``: the model's projected CRS; ``vertical_datum``: "ellipsoidal" or a
    vertical CRS; ``georeference_level``: how the model states its georeference (LoGeoRef, Clemen and Goerne 2019);
    ``model_remarks``: the assumptions made to place the model, which the passport repeats.
    """

    origin: SiteOrigin
    map_crs: str
    vertical_datum: str
    georeference_level: str
    model_remarks: str = ""

    def list_model_remarks(self) -> list[str]:
        """The assumptions as remarks of the passport."""
        return [f"model: {remark}" for remark in self.model_remarks.split("; ") if remark]
