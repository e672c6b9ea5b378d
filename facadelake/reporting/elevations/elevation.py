"""Elevations: each main facade square-on and true to scale, coloured by rectified photographs, with its defects."""

from __future__ import annotations

import logging
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from facadelake.building import BuildingModel
from facadelake.building.surface import Obstructions, Surface
from facadelake.core.arrays import Float64x3, UInt8Image
from facadelake.core.errors import InputDataError
from facadelake.reporting.drawing.png_writer import PngWriter
from facadelake.reporting.elevations.coverage_figure import draw_coverage, select_coverage
from facadelake.reporting.elevations.facades import Facade, find_facades
from facadelake.reporting.elevations.figure import ElevationLabels, draw_elevation
from facadelake.reporting.elevations.hidden_regions import HiddenRegion, find_hidden_regions
from facadelake.reporting.elevations.marks import DefectMark, assign_marks, create_marks, find_visible_marks
from facadelake.reporting.elevations.overview import FacadeOverview, create_overview, render_model_overview
from facadelake.reporting.elevations.rectification import RectifiedElevation, rectify_elevations
from facadelake.reporting.elevations.relief import (
    choose_cell_size_m,
    find_relief_edges,
    render_relief,
    render_shaded_relief,
)
from facadelake.reporting.elevations.storeys import find_storey_bases
from facadelake.reporting.inspection import Inspection, PictureSettings

log = logging.getLogger(__name__)

_THUMBNAIL_WIDTH_PX = 1200
_HATCH_M = 0.25
_HATCH_RGB = (176, 0, 32)
_MAX_BRIGHTENING = 1.8  # largest factor by which a dark facade is brightened


@dataclass(frozen=True, kw_only=True, eq=False)
class Elevation:
    """A drawn elevation; ``coverage_path``: its layer of coverage, None where the campaign has none of the facade.

    ``covered_share``: share of the facade's surface that photographs show. ``hidden_share``: share in their view that
    something hides; ``hidden_regions``: its larger parts. ``obstructions_known``: an as-built surface showed what
    stands in front of the walls; else only contradictions of photographs did.
    """

    path: Path
    coverage_path: Path | None
    facade: Facade
    marks: tuple[DefectMark, ...]
    covered_share: float
    hidden_share: float
    hidden_regions: tuple[HiddenRegion, ...]
    obstructions_known: bool
    overview: FacadeOverview


def draw_elevations(
    inspection: Inspection,
    surface: Surface,
    folder: Path,
    settings: PictureSettings | None = None,
    names: Collection[str] | None = None,
) -> list[Elevation]:
    """Write ``elevation_<facade>.png`` and ``coverage_<facade>.png`` for each main facade, and
    ``thumbnail_elevation.jpg`` of the largest one.

    Unreadable photographs are not used, with a warning; areas that no photograph covers show the shaded model.
    Memory: one photograph, and about 60 bytes for each cell of a facade.

    Args:
        inspection: the campaign.
        surface: surface of its building model.
        folder: existing folder to write into.
        settings: resolution and limits; None: the defaults.
        names: facades to be drawn; None: all.

    Returns:
        The elevations, the largest facade first.
    """
    settings = settings or PictureSettings()
    building = inspection.building
    marks = create_marks(inspection.defects, building.origin)
    facades = find_drawn_facades(inspection, surface, settings)
    assigned, unassigned = assign_marks(facades, marks)
    if unassigned:
        log.info("%d of %d defects are not on a drawn facade", len(unassigned), len(marks))
    if names is not None:
        kept = [index for index, facade in enumerate(facades) if facade.name in names]
        facades, assigned = [facades[index] for index in kept], [assigned[index] for index in kept]
    labels = ElevationLabels(
        building_name=inspection.building_name,
        campaign_id=inspection.campaign_id,
        control=inspection.control,
        storeys=tuple(find_storey_bases(building)),
    )
    reliefs = [render_relief(facade, surface, choose_cell_size_m(facade, settings)) for facade in facades]
    photographs = {photo_id: inspection.locate_photograph(photo_id) for photo_id in inspection.posed}
    obstructions = None
    if inspection.as_built is not None:
        obstructions = Obstructions(inspection.as_built, surface, inspection.placement_sigma_m)
    elevations = []
    with PngWriter() as writer:
        for rectified, own in zip(
            rectify_elevations(reliefs, surface, inspection.posed, photographs, settings, obstructions),
            assigned,
            strict=True,
        ):
            facade = rectified.relief.facade
            path = folder / f"elevation_{facade.name}.png"
            background = render_background(rectified, building)
            met = rectified.relief.element >= 0
            covered = float((rectified.covered & ~rectified.hidden & met).sum() / max(int(met.sum()), 1))
            hidden = float((rectified.hidden & met).sum() / max(int(met.sum()), 1))
            others = find_visible_marks(rectified.relief, marks, own)
            hatched = _draw_hatch(background, rectified)
            sheet = draw_elevation(labels, rectified, hatched, own, others, covered, hidden)
            writer.write(sheet, path)
            cells = select_coverage(inspection.coverage, facade)
            coverage_path = None
            if len(cells):
                coverage_path = folder / f"coverage_{facade.name}.png"
                writer.write(draw_coverage(labels, facade, background, rectified.relief.cell_m, cells), coverage_path)
            elevations.append(
                Elevation(
                    path=path,
                    coverage_path=coverage_path,
                    facade=facade,
                    marks=tuple(own),
                    covered_share=covered,
                    hidden_share=hidden,
                    hidden_regions=tuple(find_hidden_regions(rectified.relief, rectified.hidden)),
                    obstructions_known=obstructions is not None,
                    overview=create_overview(facade, hatched, rectified.relief.cell_m),
                )
            )
    elevations.sort(key=lambda elevation: -elevation.facade.area_m2)
    if elevations:
        _write_thumbnail(elevations[0].path, folder / "thumbnail_elevation.jpg")
    return elevations


def find_drawn_facades(inspection: Inspection, surface: Surface, settings: PictureSettings) -> list[Facade]:
    """The facades of which elevations are drawn, clockwise from north: the main ones and those with a defect."""
    positions: dict[str, list[Float64x3]] = {}
    for mark in create_marks(inspection.defects, inspection.building.origin):
        positions.setdefault(mark.facade, []).append(mark.centre_site_m)
    arrays = {code: np.array(points) for code, points in positions.items()}
    return find_facades(inspection.building, surface, inspection.posed, arrays, settings)


def _write_thumbnail(source: Path, path: Path) -> None:
    """Write a small copy, which is shown inline in the user interface of Prefect."""
    sheet = cv2.imread(str(source))
    if sheet is None:
        raise InputDataError(f"elevation {source} cannot be read back after writing; check free disk space")
    scale = min(1.0, _THUMBNAIL_WIDTH_PX / sheet.shape[1])
    small = cv2.resize(sheet, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(path), small, [cv2.IMWRITE_JPEG_QUALITY, 85])


def render_background(rectified: RectifiedElevation, building: BuildingModel) -> UInt8Image:
    """Background of an elevation (rows, columns, RGB): photographs, the shaded model elsewhere, edges.

    Dark photographs are brightened by one factor for the whole elevation.
    """
    picture = render_shaded_relief(rectified.relief, building)
    covered = rectified.covered
    if covered.any():
        bright_level = float(np.quantile(rectified.picture[covered].max(axis=1), 0.98))
        gain = min(max(245.0 / max(bright_level, 1.0), 1.0), _MAX_BRIGHTENING)
        picture[covered] = np.clip(rectified.picture[covered].astype(np.float32) * gain, 0, 255).astype(np.uint8)
    edges = find_relief_edges(rectified.relief, building)
    edges_on_photo, edges_on_model = edges & covered, edges & ~covered
    picture[edges_on_photo] = (0.45 * picture[edges_on_photo]).astype(np.uint8)
    picture[edges_on_model] = 110
    return picture


def _draw_hatch(background: UInt8Image, rectified: RectifiedElevation) -> UInt8Image:
    """The background with its hidden cells hatched: what they show may be the object that hides the wall."""
    picture = background.copy()
    rows, columns = np.indices(rectified.relief.shape)
    spacing = max(2, round(_HATCH_M / rectified.relief.cell_m))
    phase = (rows + columns) % spacing
    width = max(1, spacing // 5)
    picture[rectified.hidden & (phase < width)] = _HATCH_RGB
    picture[rectified.hidden & (phase >= spacing // 2) & (phase < spacing // 2 + width)] = 255
    return picture


def map_defects_to_elevations(elevations: Sequence[Elevation]) -> dict[str, FacadeOverview]:
    """Overview of the drawn elevation of each defect, by defect_id; defects on none are absent."""
    return {mark.defect_id: elevation.overview for elevation in elevations for mark in elevation.marks}


def map_defects_to_model(
    inspection: Inspection, surface: Surface, facades: Sequence[Facade], defect_ids: Collection[str]
) -> dict[str, FacadeOverview]:
    """Overview of the facade of each defect from the shaded model, by defect_id; defects on none are absent.

    Args:
        inspection: the campaign.
        surface: surface of its building model.
        facades: facades to which defects are assigned.
        defect_ids: defects.
    """
    building = inspection.building
    marks = [mark for mark in create_marks(inspection.defects, building.origin) if mark.defect_id in defect_ids]
    assigned, _ = assign_marks(facades, marks)
    overviews: dict[str, FacadeOverview] = {}
    for facade, own in zip(facades, assigned, strict=True):
        if own:
            overview = render_model_overview(facade, surface, building)
            overviews |= {mark.defect_id: overview for mark in own}
    return overviews
