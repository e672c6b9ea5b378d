"""Which facade each defect is shown on."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from facadelake.building.surface import Surface
from facadelake.reporting.elevations.backdrop import Backdrop, model_backdrop
from facadelake.reporting.elevations.elevation import Elevation
from facadelake.reporting.elevations.facades import Facade
from facadelake.reporting.elevations.marks import marks_of, marks_per_facade
from facadelake.reporting.inspection import Inspection


def places_on_elevations(elevations: Sequence[Elevation]) -> dict[str, Backdrop]:
    """The drawn elevation of each defect by defect_id; those on none are absent."""
    return {mark.defect_id: elevation.overview for elevation in elevations for mark in elevation.marks}


def places_on_model(
    inspection: Inspection, surface: Surface, facades: Sequence[Facade], defect_ids: Collection[str]
) -> dict[str, Backdrop]:
    """The facade of each of ``defect_ids`` as a grey drawing; those on none are absent."""
    building = inspection.building
    marks = [mark for mark in marks_of(inspection.defects, building.origin) if mark.defect_id in defect_ids]
    shown, _ = marks_per_facade(facades, marks, building)
    places: dict[str, Backdrop] = {}
    for facade, own in zip(facades, shown, strict=True):
        if own:
            backdrop = model_backdrop(facade, surface, building)
            places |= {mark.defect_id: backdrop for mark in own}
    return places
