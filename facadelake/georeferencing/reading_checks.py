"""Placement check of how a mesh was read: on which reading's faces do the block's tie points lie?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from facadelake.building import SurfaceReading
from facadelake.core.arrays import Float64Nx3
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.georeferencing.model.alignment import select_tie_points
from facadelake.georeferencing.model_checks import count_points_on_faces, search_model_shift
from facadelake.georeferencing.placement_checks import PlacementCheck
from facadelake.sfm import Reconstruction
from schemas.vocabulary import PlacementCheckOutcome, PlacementStatement

# Tie points on the faces, after the shift of the block that fits each reading best. Read rightly, they are 0.85 (castle
# courtyard) and 0.95 (demo) of all; read wrongly up to 0.4 and 0.55, where faces of both readings lie on one plane.
_MIN_ODDS_RATIO = 3.0  # of points on the faces to those that are not
_MIN_SHARE = 0.5
_SHARE_THAT_PLACES = 0.8
_MIN_POINTS = 100
_MAX_POINTS = 400


class MeshReadingError(GeoreferenceError):
    """A mesh was read with another upward axis or unit than the photographs show; no other control changes that."""


def check_reading(
    reconstruction: Reconstruction, site_from_sfm: Similarity, readings: Sequence[SurfaceReading]
) -> tuple[PlacementCheck, ...]:
    """Compare a placed block with the surfaces of a mesh by all readings that the portfolio leaves open.

    ``site_from_sfm``: a placement that does not depend on the mesh. ``readings``: the first is the one taken. Returns
    the check, none where nothing is open. Raises MeshReadingError where clearly more tie points lie on the surface
    of another reading.
    """
    if not readings:
        return ()
    xyz_sfm, origin_sfm = _draw_tie_points(reconstruction)
    check = compare_readings(site_from_sfm.apply(xyz_sfm), site_from_sfm.apply(origin_sfm), readings)
    if check.disagrees:
        raise MeshReadingError(check.detail)
    return (check,)


def compare_readings(
    xyz_site_m: Float64Nx3, origin_site_m: Float64Nx3, readings: Sequence[SurfaceReading]
) -> PlacementCheck:
    """Compare the shares of tie points on the surfaces of all readings.

    Args:
        xyz_site_m: tie points (n, 3).
        origin_site_m: centre (n, 3) of a camera that shows each of them.
        readings: the surfaces; the first is the one taken.

    Returns:
        the check; its deviation is the share of tie points on the other reading that fits best.
    """
    taken, others = readings[0], readings[1:]
    count = len(xyz_site_m)
    if count < _MIN_POINTS:
        return _build_check(
            PlacementCheckOutcome.NOT_COMPARABLE,
            f"{_describe(taken)}; the block has {count} tie points, {_MIN_POINTS} are needed to compare other readings",
        )
    fitted = search_model_shift(xyz_site_m, origin_site_m, taken.surface, np.zeros(3))
    on_taken, shift = fitted.matched_shifted, fitted.shift_site_m
    said = f"{_describe(taken)}, and {on_taken} of {count} tie points lie on its faces (after the shift that fits best)"
    if not others:
        return _build_check(PlacementCheckOutcome.AGREES, f"{said}; no other axis or unit is possible")
    counts = []
    for other in others:
        if on_taken > _SHARE_THAT_PLACES * count:  # no other reading has a position of its own
            moved = (np.zeros(3), shift)
            counts.append(
                max(count_points_on_faces(xyz_site_m + move, origin_site_m + move, other.surface) for move in moved)
            )
        else:
            counts.append(search_model_shift(xyz_site_m, origin_site_m, other.surface, np.zeros(3)).matched_shifted)
    on_best, best = max(zip(counts, others, strict=True), key=lambda pair: pair[0])
    ratio = _compute_odds(on_best, count) / _compute_odds(on_taken, count)
    said += f"; {_describe(best)}, and {on_best} do"
    if ratio >= _MIN_ODDS_RATIO and on_best >= _MIN_SHARE * count:
        outcome = PlacementCheckOutcome.DISAGREES
        said += f" (odds ratio {ratio:.1f}, limit {_MIN_ODDS_RATIO:g}): set crs.axes and crs.unit in the portfolio"
    elif 1 / ratio >= _MIN_ODDS_RATIO and on_taken >= _MIN_SHARE * count:
        outcome = PlacementCheckOutcome.AGREES
    else:
        outcome = PlacementCheckOutcome.NOT_COMPARABLE
        said += ": the tie points do not decide; set crs.axes and crs.unit in the portfolio"
    return _build_check(outcome, said, share=on_best / count, limit=on_taken / count)


def _compute_odds(on_faces: int, count: int) -> float:
    """Odds of a tie point to lie on the faces."""
    return (on_faces + 0.5) / (count - on_faces + 0.5)


def _build_check(
    outcome: PlacementCheckOutcome, detail: str, *, share: float = np.nan, limit: float = np.nan
) -> PlacementCheck:
    return PlacementCheck(
        statement=PlacementStatement.MESH_READING,
        outcome=outcome,
        deviation=share,
        limit=limit,
        unit="share",
        detail=detail,
    )


def _describe(reading: SurfaceReading) -> str:
    east, north, up = reading.size_m
    return f"read with {reading.keys}, the mesh is {east:.1f} x {north:.1f} x {up:.1f} m"


def _draw_tie_points(reconstruction: Reconstruction) -> tuple[Float64Nx3, Float64Nx3]:
    """Up to 400 tie points (n, 3) and the centre (n, 3) of the nearest camera of each."""
    xyz_sfm, camera = select_tie_points(reconstruction, seed=1)
    few = np.linspace(0, len(xyz_sfm) - 1, min(len(xyz_sfm), _MAX_POINTS)).astype(int)
    return xyz_sfm[few], reconstruction.centres_sfm[camera[few]]
