"""Placement checks by the building model: heights of the cameras, the model in view, and tie points on its faces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Nx3, Float64x3, Int64Array, RowIndices
from facadelake.core.camera import PosedCamera
from facadelake.georeferencing.adjustment.point_to_plane import RaySurface, find_faces
from facadelake.georeferencing.placement_checks import LIMIT_SIGMAS, PlacementCheck, compare_deviation
from schemas.vocabulary import PlacementCheckOutcome, PlacementStatement

# Facades are photographed from tens of metres; what is seen from a kilometre is no inspection.
MAX_VIEWING_DISTANCE_M = 1000.0
# Median height of the cameras: a site may slope, and a drone may start below the building; drones fly up to 120 m.
_MAX_BELOW_MODEL_M = 10.0
_MAX_ABOVE_MODEL_M = 300.0
# Surroundings, roads and neighbours are photographed too; a smaller share on the building is no inspection of it.
_MIN_SHARE_IN_VIEW = 0.25
_RAYS_PER_AXIS = 7  # over a photograph
# A tie point within this of the face seen behind it lies on it: relief and deviation of the building from its model.
_GATE_M = 0.5
_COARSE_GATE_M = 1.0
_MAX_POINTS = 1000
_COARSE_POINTS = 200
_COARSE_STEP_M = 2.0
_MIN_POINTS = 100
_MIN_SHARE_ON_MODEL = 0.05
# Beyond geoid heights in height; horizontally the errors of GPS and of coarse model georeferences.
_SEARCH_UP_M = 120.0
_SEARCH_HORIZONTAL_M = 16.0
# A shift counts where it puts clearly more tie points onto the model than there are: walls alone leave heights open.
_GAIN = 1.15
_MIN_GAIN_POINTS = 30
_RAYS_AT_ONCE = 100_000
_SHARE_PER_METRE = 0.002  # of the tie points: of shifts with equal counts the shortest is taken


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelShift:
    """A shift of a block (3,), and the numbers of tie points on the model without and with it, of those compared.

    ``matched_at_gps``: the number after the shift to GPS.
    """

    shift_site_m: Float64x3
    matched: int
    matched_shifted: int
    matched_at_gps: int
    compared: int


def find_cameras_seeing_model(cameras: Sequence[PosedCamera], surface: RaySurface) -> BoolArray:
    """Which cameras (n,) have the surface in view, within ``MAX_VIEWING_DISTANCE_M``."""
    seeing = []
    for posed in cameras:
        columns = (np.arange(_RAYS_PER_AXIS) + 0.5) * posed.camera.width_px / _RAYS_PER_AXIS
        rows = (np.arange(_RAYS_PER_AXIS) + 0.5) * posed.camera.height_px / _RAYS_PER_AXIS
        origins, directions = posed.rays_site_from_img(np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2))
        seeing.append(bool((surface.cast(origins, directions).distance_m < MAX_VIEWING_DISTANCE_M).any()))
    return np.array(seeing, dtype=np.bool_)


def check_cameras(
    cameras: Sequence[PosedCamera], surface: RaySurface, lowest_site_m: float, highest_site_m: float
) -> tuple[PlacementCheck, ...]:
    """Compare the placed cameras with the model: their median height, and the share that has the model in view.

    Args:
        cameras: the placed cameras.
        surface: the model's surface.
        lowest_site_m: height of its lowest point in site.
        highest_site_m: height of its highest point in site.

    Returns:
        the two checks.
    """
    height = float(np.median([camera.centre_site_m[2] for camera in cameras]))
    below, above = lowest_site_m - height, height - highest_site_m
    too_low = below > above
    deviation, limit = (below, _MAX_BELOW_MODEL_M) if too_low else (above, _MAX_ABOVE_MODEL_M)
    deviation = max(deviation, 0.0)
    heights = PlacementCheck(
        statement=PlacementStatement.CAMERA_HEIGHT,
        outcome=compare_deviation(deviation, limit),
        deviation=deviation,
        limit=limit,
        detail=f"the cameras lie {height - lowest_site_m:+.1f} m (median) from the lowest point of the model, which is "
        f"{highest_site_m - lowest_site_m:.1f} m high (limits {-_MAX_BELOW_MODEL_M:g} m, and "
        f"{_MAX_ABOVE_MODEL_M:g} m above the highest)",
    )
    seeing = find_cameras_seeing_model(cameras, surface)
    share = float(seeing.mean())
    in_view = PlacementCheck(
        statement=PlacementStatement.MODEL_IN_VIEW,
        outcome=PlacementCheckOutcome.AGREES if share >= _MIN_SHARE_IN_VIEW else PlacementCheckOutcome.DISAGREES,
        deviation=share,
        limit=_MIN_SHARE_IN_VIEW,
        unit="share",
        detail=f"{int(seeing.sum())} of {len(seeing)} photographs have the building model in view "
        f"(limit {_MIN_SHARE_IN_VIEW:.0%})",
    )
    return heights, in_view


def check_tie_points(
    xyz_site_m: Float64Nx3,
    origin_site_m: Float64Nx3,
    surface: RaySurface,
    *,
    gps_shift_site_m: Float64x3,
    sigma_m: Float64x3,
) -> PlacementCheck:
    """Compare the block's tie points with the model: do they lie on its faces, or would they after a shift?

    Args:
        xyz_site_m: tie points (n, 3).
        origin_site_m: centre (n, 3) of a camera that shows each of them.
        surface: the model's surface.
        gps_shift_site_m: shift (3,) by which the campaign would agree with GPS; a candidate of the search.
        sigma_m: one sigma (3,) of the campaign's position against the model.

    Returns:
        the check; its deviation is the shift that fits best, zero where no shift fits clearly better.
    """
    statement = PlacementStatement.TIE_POINTS
    found = search_model_shift(xyz_site_m, origin_site_m, surface, gps_shift_site_m)
    if found.compared < _MIN_POINTS:
        return PlacementCheck(
            statement=statement,
            outcome=PlacementCheckOutcome.NOT_COMPARABLE,
            detail=f"the block has {found.compared} tie points, {_MIN_POINTS} are needed for a comparison",
        )
    now = (
        f"{found.matched} of {found.compared} tie points lie within {_GATE_M:g} m of the faces of the model that are "
        "seen behind them"
    )
    if found.matched_shifted < max(_GAIN * found.matched, found.matched + _MIN_GAIN_POINTS):
        nothing_fits = found.matched < _MIN_SHARE_ON_MODEL * found.compared
        return PlacementCheck(
            statement=statement,
            outcome=PlacementCheckOutcome.DISAGREES if nothing_fits else PlacementCheckOutcome.AGREES,
            deviation=found.matched / found.compared if nothing_fits else 0.0,
            limit=_MIN_SHARE_ON_MODEL if nothing_fits else _GATE_M,
            unit="share" if nothing_fits else "m",
            decides=2 * found.matched > found.compared and _GAIN * found.matched_at_gps < found.matched,
            detail=f"{now}, and no shift up to {_SEARCH_HORIZONTAL_M:g} m horizontally or {_SEARCH_UP_M:g} m in height "
            "puts clearly more of them there",
        )
    shift = found.shift_site_m
    limits = np.maximum(LIMIT_SIGMAS * np.array([sigma_m[:2].max(), sigma_m[2]]), _GATE_M)
    lengths = np.array([np.hypot(shift[0], shift[1]), abs(shift[2])])
    worst = int(np.argmax(lengths / limits))
    return PlacementCheck(
        statement=statement,
        outcome=compare_deviation(float(lengths[worst]), float(limits[worst])),
        deviation=float(lengths[worst]),
        sigma=float(limits[worst] / LIMIT_SIGMAS),
        limit=float(limits[worst]),
        detail=f"{now}, {found.matched_shifted} would, if the campaign were shifted by east {shift[0]:+.1f} m, north "
        f"{shift[1]:+.1f} m, height {shift[2]:+.1f} m (limits: {limits[0]:.1f} m horizontally, {limits[1]:.1f} m in "
        "height)",
        shift_site_m=shift,
    )


def count_points_on_faces(xyz_site_m: Float64Nx3, origin_site_m: Float64Nx3, surface: RaySurface) -> int:
    """The number of tie points (n, 3) within 0.5 m of the face that the ray from ``origin_site_m`` (n, 3) hits."""
    return int(find_faces(xyz_site_m, origin_site_m, surface).match(_GATE_M).sum())


def search_model_shift(
    xyz_site_m: Float64Nx3,
    origin_site_m: Float64Nx3,
    surface: RaySurface,
    gps_shift_site_m: Float64x3,
    *,
    seed: int = 1,
) -> ModelShift:
    """The shift of a block that puts most of its tie points onto the faces of the model behind them.

    Heights first; where no height puts half of the points there, a coarse grid of positions and heights; then a
    horizontal grid, and steps down to 0.25 m. Heights and the coarse grid start from zero and from the shift to GPS.

    Args:
        xyz_site_m: tie points (n, 3), of which up to 1000 are drawn.
        origin_site_m: centre (n, 3) of a camera that shows each of them.
        surface: the model's surface.
        gps_shift_site_m: shift (3,) to start from besides zero.
        seed: seed of the draw.

    Returns:
        the shift and its counts.
    """
    random = np.random.default_rng(seed)
    xyz, origin = xyz_site_m, origin_site_m
    if len(xyz) > _MAX_POINTS:
        drawn = np.sort(random.choice(len(xyz), _MAX_POINTS, replace=False))
        xyz, origin = xyz[drawn], origin[drawn]
    if not len(xyz):
        return ModelShift(shift_site_m=np.zeros(3), matched=0, matched_shifted=0, matched_at_gps=0, compared=0)

    def count(shifts: Float64Nx3, gate_m: float, points: RowIndices | slice = slice(None)) -> Int64Array:
        moved, eyes = (shifts[:, None] + rows[points] for rows in (xyz, origin))
        matched = find_faces(moved.reshape(-1, 3), eyes.reshape(-1, 3), surface).match(gate_m)
        counts: Int64Array = matched.reshape(len(shifts), -1).sum(axis=1)
        return counts

    def choose(shifts: Float64Nx3, gate_m: float, points: RowIndices | slice = slice(None)) -> Float64x3:
        size = len(xyz[points])
        parts = np.array_split(shifts, max(1, len(shifts) * size // _RAYS_AT_ONCE))
        counts = np.concatenate([count(part, gate_m, points) for part in parts])
        scores = counts / size - _SHARE_PER_METRE * np.linalg.norm(shifts, axis=1)
        best: Float64x3 = shifts[int(np.argmax(scores))]
        return best

    zero = np.zeros((1, 3))
    matched = int(count(zero, _GATE_M)[0])
    starts = np.unique([np.zeros(3), gps_shift_site_m, gps_shift_site_m * [1.0, 1.0, 0.0]], axis=0)
    best = choose(np.vstack([start + _list_shifts(0.0, _SEARCH_UP_M, 1.0) for start in starts]), _COARSE_GATE_M)
    if max(matched, count(best[None], _GATE_M)[0]) < len(xyz) / 2:
        few = np.arange(0, len(xyz), max(1, len(xyz) // _COARSE_POINTS))
        coarse = _list_shifts(_SEARCH_HORIZONTAL_M, _SEARCH_UP_M, _COARSE_STEP_M)
        best = choose(np.vstack([start + coarse for start in starts]), _COARSE_STEP_M, few)
    best = choose(np.vstack([zero, best + _list_shifts(_SEARCH_HORIZONTAL_M, 0.0, 1.0)]), _COARSE_GATE_M)
    for step_m in (1.0, 0.5, 0.25):
        best = choose(np.vstack([zero, best + _list_shifts(step_m, step_m, step_m)]), _GATE_M)
    return ModelShift(
        shift_site_m=best,
        matched=matched,
        matched_shifted=int(count(best[None], _GATE_M)[0]),
        matched_at_gps=int(count(gps_shift_site_m[None], _GATE_M)[0]),
        compared=len(xyz),
    )


def _list_shifts(horizontal_m: float, up_m: float, step_m: float) -> Float64Nx3:
    """A grid of shifts (n, 3) about zero with a step."""
    plane = np.arange(-horizontal_m, horizontal_m + step_m / 2, step_m)
    height = np.arange(-up_m, up_m + step_m / 2, step_m)
    return np.stack(np.meshgrid(plane, plane, height), axis=-1).reshape(-1, 3)
