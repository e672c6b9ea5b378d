"""Table ``coverage`` of a campaign."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import shapely

from facadelake.building import BuildingModel, find_storeys
from facadelake.building.surface import Obstructions, Surface
from facadelake.core.arrays import Float64N
from facadelake.core.tables import get_stage_schema
from facadelake.coverage.cells import FacadeCells, divide_facades
from facadelake.coverage.detector_reach import DetectorReach
from facadelake.coverage.photograph_views import NONE, CampaignPhotographs, CellViews, CoverageSettings, view_cells
from schemas.vocabulary import CoverageOutcome, SurfaceKind

_AS_BUILT_TOLERANCE_M = 0.25  # bumps of an as-built surface do not hide what is beside them


def measure_coverage(
    building: BuildingModel,
    photographs: CampaignPhotographs,
    reach: DetectorReach,
    *,
    grazing_above_deg: float,
    as_built: Surface | None = None,
    placement_sigma_m: float = 0.0,
) -> pa.Table:
    """Measure which parts of the facades the photographs of a campaign show, and how well.

    Args:
        building: the building model. Where its surface is as built, what no photograph shows has no cells.
        photographs: poses, files, exclusion masks; without a pose no cell is imaged.
        reach: in which photographs the detector searched, and how small a defect it finds.
        grazing_above_deg: largest incidence at which a detection is registered, degrees.
        as_built: surface of the campaign's tie points, which shows what stands before the walls; None: unknown.
        placement_sigma_m: standard deviation of the campaign's position relative to the model, metres.

    Returns:
        Table ``coverage``; empty where the building has no facades.

    Raises:
        ModelError: the building has no surface.
    """
    surface = Surface(building)
    settings = CoverageSettings(grazing_above_deg=grazing_above_deg)
    if building.surface_kind is SurfaceKind.AS_BUILT:
        settings = CoverageSettings(grazing_above_deg=grazing_above_deg, visibility_tolerance_m=_AS_BUILT_TOLERANCE_M)
    cells = divide_facades(building, surface, photographs.posed, tolerance_m=settings.visibility_tolerance_m)
    obstructions = None if as_built is None else Obstructions(as_built, surface, placement_sigma_m)
    views = view_cells(cells, surface, photographs, reach, settings=settings, obstructions=obstructions)
    return _build_table(building, cells, views, obstructions is not None)


def _build_table(building: BuildingModel, cells: FacadeCells, views: CellViews, obstructions_known: bool) -> pa.Table:
    elements = building.elements
    guids = elements.column("element_guid").to_pylist()
    storeys = find_storeys(
        building.storeys, elements.column("storey").to_pylist(), building.compute_vertical_extents(), cells.element,
        cells.xyz_site_m[:, 2],
    )  # fmt: skip
    outlines = cells.build_outlines()
    geo = building.origin.geo_from_site(outlines.reshape(-1, 3)).reshape(outlines.shape) if len(cells) else outlines
    looked = (views.viewed > 0) & obstructions_known
    columns: dict[str, Sequence[object] | np.ndarray] = {
        "facade": [cells.facades[index] for index in cells.facade.tolist()],
        "facade_azimuth_deg": cells.azimuth_deg,
        "cell_column": cells.column,
        "cell_row": cells.row,
        "element_guid": [guids[row] for row in cells.element.tolist()],
        "cell_layer": cells.layer,
        "storey": storeys,
        "coverage_outcome": _find_outcomes(views),
        **dict(zip(("u_min_m", "u_max_m", "v_min_m", "v_max_m"), cells.bounds_m.T, strict=True)),
        "area_m2": cells.area_m2,
        **dict(zip(("x_site_m", "y_site_m", "z_site_m"), cells.xyz_site_m.T, strict=True)),
        **dict(zip(("normal_x", "normal_y", "normal_z"), np.clip(cells.normal_site, -1, 1).T, strict=True)),
        "imaged_count": views.imaged_count,
        "searched_count": views.searched_count,
        "hidden_share": _null_nan(np.where(looked, views.blocked / np.maximum(views.viewed, 1), np.nan)),
        "best_photo_id": [None if index == NONE else views.photo_ids[index] for index in views.best.tolist()],
        "gsd_mm": _null_nan(views.gsd_mm),
        "incidence_deg": _null_nan(views.incidence_deg),
        "blur_px": _null_nan(views.blur_px),
        "found_crack_width_mm": _null_nan(views.found_crack_width_mm),
        "found_patch_mm": _null_nan(views.found_patch_mm),
        "geometry": shapely.to_wkb(shapely.polygons(geo)) if len(cells) else [],
    }
    schema = get_stage_schema("coverage")
    return pa.table({field.name: pa.array(columns[field.name], field.type) for field in schema}, schema=schema)


def _find_outcomes(views: CellViews) -> list[str]:
    """Whether the cells are imaged, else what prevents it: the obstacle that is the easiest to get around first."""
    outcomes = np.full(len(views.framed), CoverageOutcome.NOT_IN_VIEW, dtype=object)
    outcomes[views.framed > views.clear] = CoverageOutcome.HIDDEN_BY_MODEL
    outcomes[views.clear > views.viewed] = CoverageOutcome.GRAZING
    outcomes[views.hidden] = CoverageOutcome.OBSTRUCTED
    outcomes[views.imaged_count > 0] = CoverageOutcome.IMAGED
    return [str(outcome) for outcome in outcomes]


def _null_nan(values: Float64N) -> pa.Array:
    return pa.array(values, pa.float64(), from_pandas=True)
