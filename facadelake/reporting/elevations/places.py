"""Which facade each defect is shown on."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from facadelake.building.surface import Surface
from facadelake.reporting.elevations.backdrop import FacadeOverview, render_model_overview
from facadelake.reporting.elevations.elevation import Elevation
from facadelake.reporting.elevations.facades import Facade
from facadelake.reporting.elevations.marks import assign_marks, create_marks
from facadelake.reporting.inspection import Inspection


def map_defects_to_elevations(elevations: Sequence[Elevation]) -> dict[str, FacadeOverview]:
    """The drawn elevation of each defect by defect_id; those on none are absent."""
    return {mark.defect_id: elevation.overview for elevation in elevations for mark in elevation.marks}


def map_defects_to_model(
    inspection: Inspection, surface: Surface, facades: Sequence[Facade], defect_ids: Collection[str]
) -> dict[str, FacadeOverview]:
    """The facade of each of ``defect_ids`` as a grey drawing; those on none are absent."""
    building = inspection.building
    marks = [mark for mark in create_marks(inspection.defects, building.origin) if mark.defect_id in defect_ids]
    shown, _ = assign_marks(facades, marks, building)
    places: dict[str, FacadeOverview] = {}
    for facade, own in zip(facades, shown, strict=True):
        if own:
            backdrop = render_model_overview(facade, surface, building)
            places |= {mark.defect_id: backdrop for mark in own}
    return places
