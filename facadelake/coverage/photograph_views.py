"""What the photographs of a campaign show of its facades' cells, and how well."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from facadelake.building.surface import Obstructions, Surface, check_visibility, project_points
from facadelake.core.arrays import BoolArray, Float64N, Float64Nx2, Int64Array, RowIndices
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.progress import track
from facadelake.coverage.cells import FacadeCells
from facadelake.coverage.detector_reach import DetectorReach
from facadelake.detection.inference import read_photograph
from facadelake.measurement import TYPICAL_BLUR, BlurMap, map_blur
from facadelake.registration import read_mask

_log = logging.getLogger(__name__)
_SHOWN_SHARE = 0.5  # of a cell's samples, for a photograph to show the cell
NONE = -1


@dataclass(frozen=True, kw_only=True)
class CoverageSettings:
    """``grazing_above_deg``: at a larger incidence a photograph does not show a cell.

    ``visibility_tolerance_m``: a surface up to this distance in front of a cell does not hide it.
    """

    grazing_above_deg: float = 80.0
    visibility_tolerance_m: float = 0.08


@dataclass(frozen=True, kw_only=True, eq=False)
class CampaignPhotographs:
    """The photographs of a campaign: ``posed`` by photo_id, files below ``root``, exclusion masks by photo_id."""

    posed: Mapping[str, PosedCamera]
    root: Path
    masks: Mapping[str, Path] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class CellViews:
    """What the photographs show of n cells.

    ``imaged_count``, ``searched_count``: photographs that show the cell, and those of them that the detector processed.
    Numbers of views of the cell's samples, each contained in the one before: ``framed``, a photograph's frame contains
    the sample and faces it; ``clear``, the model does not hide it; ``viewed``, the incidence is permitted; ``blocked``,
    something before the wall hides it. ``hidden``: in a photograph something hides a part of the cell or a neighbour.
    ``best``: index in ``photo_ids`` of the photograph that would show the smallest crack, ``NONE`` where there is none;
    ``gsd_mm``, ``incidence_deg``, ``blur_px`` in it, NaN where unknown.
    ``found_crack_width_mm``, ``found_patch_mm``: the smallest that the detector finds, NaN where unknown.
    """

    photo_ids: tuple[str, ...]
    imaged_count: Int64Array
    searched_count: Int64Array
    framed: Float64N
    clear: Float64N
    viewed: Float64N
    blocked: Float64N
    hidden: BoolArray
    best: NDArray[np.int64]
    gsd_mm: Float64N
    incidence_deg: Float64N
    blur_px: Float64N
    found_crack_width_mm: Float64N
    found_patch_mm: Float64N


def view_cells(
    cells: FacadeCells,
    surface: Surface,
    photographs: CampaignPhotographs,
    reach: DetectorReach,
    *,
    settings: CoverageSettings,
    obstructions: Obstructions | None = None,
) -> CellViews:
    """View the cells in every photograph with a pose; one that cannot be read shows nothing, with a warning.

    The probability of detection is that in the best single photograph: what makes a defect hard to find is the same in
    all of them, so that they are not independent. Two photographs are in memory at a time.

    Args:
        cells: the cells of the facades.
        surface: surface of the building, which may hide a cell.
        photographs: poses, files, exclusion masks.
        reach: in which photographs the detector searched, and how small a defect it finds.
        settings: largest incidence, tolerance of visibility.
        obstructions: what stands before the walls; None: unknown.
    """
    count = len(cells)
    size = cells.sum_samples(np.ones(len(cells.cell_of_sample)))
    imaged, searched = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    framed, clear, viewed, blocked = (np.zeros(count) for _ in range(4))
    hidden = np.zeros(count, dtype=bool)
    best, pixel_mm = np.full(count, NONE, dtype=np.int64), np.full(count, np.inf)
    gsd_mm, incidence_deg, blur_px = (np.full(count, np.nan) for _ in range(3))
    crack_mm, patch_mm = np.full(count, np.nan), np.full(count, np.nan)
    photo_ids = tuple(photographs.posed)
    for index, (photo_id, blur) in enumerate(track(_measure_blur_ahead(photographs), label="Coverage")):
        if blur is None:
            _log.warning("%s cannot be read: it shows no part of the facades", photo_id)
            continue
        posed = photographs.posed[photo_id]
        seen = _view_samples(cells, surface, posed, settings, obstructions, photographs.masks.get(photo_id))
        framed += cells.sum_samples(seen.framed)
        clear += cells.sum_samples(seen.clear)
        viewed_here, blocked_here = cells.sum_samples(seen.viewed), cells.sum_samples(seen.blocked)
        viewed += viewed_here
        blocked += blocked_here
        # An as-built surface ends short of the edges of an object: beside what it hides the photograph may show them.
        is_hidden = cells.widen_to_neighbours(blocked_here > 0)
        hidden |= is_hidden & (viewed_here > 0)
        shown = np.flatnonzero((viewed_here >= _SHOWN_SHARE * size) & ~is_hidden)
        imaged[shown] += 1
        scale = _measure_scale(cells, shown, posed, blur)
        area_mm = np.sqrt(scale.gsd_mm * scale.pixel_mm)  # root of the area of a pixel on the surface
        if photo_id in reach.searched:
            searched[shown] += 1
            found = reach.compute_crack_width_mm(scale.pixel_mm * scale.softness)
            crack_mm[shown] = np.fmin(crack_mm[shown], found)
            patch_mm[shown] = np.fmin(patch_mm[shown], reach.compute_patch_mm(area_mm * scale.softness))
        is_better = scale.pixel_mm * scale.softness < pixel_mm[shown]
        better = shown[is_better]
        best[better] = index
        pixel_mm[better] = (scale.pixel_mm * scale.softness)[is_better]
        gsd_mm[better], incidence_deg[better] = scale.gsd_mm[is_better], scale.incidence_deg[is_better]
        blur_px[better] = scale.blur_px[is_better]
    return CellViews(
        photo_ids=photo_ids, imaged_count=imaged, searched_count=searched, framed=framed, clear=clear, viewed=viewed,
        blocked=blocked, hidden=hidden, best=best, gsd_mm=gsd_mm, incidence_deg=incidence_deg, blur_px=blur_px,
        found_crack_width_mm=crack_mm, found_patch_mm=patch_mm,
    )  # fmt: skip


def _measure_blur_ahead(photographs: CampaignPhotographs) -> Iterator[tuple[str, BlurMap | None]]:
    """Each photograph with its blur, None where it cannot be read; the next one is measured in the background."""

    def measure(photo_id: str) -> BlurMap | None:
        image = read_photograph(photographs.root / photo_id)
        return None if image is None else map_blur(image)

    photo_ids = list(photographs.posed)
    with ThreadPoolExecutor(1) as worker:
        pending: Future[BlurMap | None] | None = None
        for photo_id, next_id in zip_longest(photo_ids, photo_ids[1:]):
            blur = (pending or worker.submit(measure, photo_id)).result()
            pending = worker.submit(measure, next_id) if next_id is not None else None
            yield photo_id, blur


@dataclass(frozen=True, kw_only=True, eq=False)
class _SampleViews:
    """Masks (m,) of the samples in one photograph, each within the one before; see ``CellViews``."""

    framed: BoolArray
    clear: BoolArray
    viewed: BoolArray
    blocked: BoolArray


def _view_samples(
    cells: FacadeCells,
    surface: Surface,
    posed: PosedCamera,
    settings: CoverageSettings,
    obstructions: Obstructions | None,
    mask: Path | None,
) -> _SampleViews:
    """View the samples of all cells in one photograph.

    Args:
        cells: the cells.
        surface: surface of the building.
        posed: the camera.
        settings: largest incidence, tolerance of visibility.
        obstructions: what stands before the walls; None: unknown.
        mask: exclusion mask of the photograph; None: it has none.
    """
    xyz, normal = cells.sample_xyz_site_m, cells.sample_normal_site
    view = check_visibility(
        posed, surface, xyz, normal, tolerance_m=settings.visibility_tolerance_m, max_incidence_deg=90.0
    )
    is_viewed = view.visible & (_measure_cosine(posed, xyz, normal) >= np.cos(np.radians(settings.grazing_above_deg)))
    rows = np.flatnonzero(is_viewed)
    blocked = np.zeros(len(xyz), dtype=bool)
    if obstructions is not None and len(rows):
        blocked[rows] = obstructions.find_hidden_points(posed.centre_site_m, xyz[rows])
    if mask is not None and len(rows):
        xy, _ = project_points(posed, xyz[rows])
        blocked[rows] |= _find_masked(mask, posed, xy)
    return _SampleViews(framed=view.in_view, clear=view.visible, viewed=is_viewed, blocked=blocked)


def _measure_cosine(posed: PosedCamera, xyz_site_m: Float64Nx2, normal_site: Float64Nx2) -> Float64N:
    """Cosine (n,) of the incidence at points (n, 3) with unit normals (n, 3)."""
    to_point = xyz_site_m - posed.centre_site_m
    distance = np.maximum(np.linalg.norm(to_point, axis=1), 1e-9)
    cosine: Float64N = -np.einsum("ij,ij->i", to_point, normal_site) / distance
    return cosine


def _find_masked(mask: Path, posed: PosedCamera, xy: Float64Nx2) -> BoolArray:
    """Which pixels (n, 2) an exclusion mask covers; one that cannot be used covers none, with a warning."""
    try:
        black = read_mask(mask, posed.camera)
    except InputDataError as error:
        _log.warning("%s; the mask is not used", error)
        return np.zeros(len(xy), dtype=bool)
    masked: BoolArray = black[xy[:, 1].astype(np.int64), xy[:, 0].astype(np.int64)]
    return masked


@dataclass(frozen=True, kw_only=True, eq=False)
class _Scale:
    """Of k cells in one photograph: GSD, incidence, blur (NaN: unknown); ``pixel_mm``: longest side of a pixel on the
    surface; ``softness``: factor by which the photograph is less sharp there than drone photographs typically are."""

    gsd_mm: Float64N
    incidence_deg: Float64N
    blur_px: Float64N
    pixel_mm: Float64N
    softness: Float64N


def _measure_scale(cells: FacadeCells, rows: RowIndices, posed: PosedCamera, blur: BlurMap) -> _Scale:
    """Scale and sharpness of a photograph at the centres of cells ``rows``."""
    xyz = cells.xyz_site_m[rows]
    xyz_cam = posed.site_from_cam.invert().apply(xyz)
    gsd_mm = 1000.0 * xyz_cam[:, 2] / posed.camera.fx_px
    cosine = np.clip(_measure_cosine(posed, xyz, cells.normal_site[rows]), 1e-3, 1.0)
    blur_px = blur.get_sigma_px(posed.camera.project(xyz_cam)) if len(rows) else np.zeros(0)
    softness = np.maximum(1.0, np.nan_to_num(blur_px, nan=TYPICAL_BLUR.sigma_px) / TYPICAL_BLUR.sigma_px)
    return _Scale(
        gsd_mm=gsd_mm, incidence_deg=np.degrees(np.arccos(cosine)), blur_px=blur_px, pixel_mm=gsd_mm / cosine,
        softness=softness,
    )  # fmt: skip
