"""The offset of a campaign's frame from that of the known defects: of the whole building, and of each facade.

What two campaigns' georeferencing left between them is the same for all defects of a facade. It is estimated from the
candidates themselves, robustly: most candidates of a large gate are pairs of unrelated defects, whose displacements
agree on nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from facadelake.core.arrays import Float64Nx3, Float64x3, Float64x3x3
from facadelake.tracking.campaign_defects import DefectArrays
from facadelake.tracking.candidates import EXTENT_NOISE, find_candidates
from schemas.vocabulary import OffsetOutcome

_FACADE_SIGMA_M = 0.02  # of a facade's own offset from that of the building
_PAIR_FLOOR_M = 0.01  # one sigma of a displacement besides covariance and extents
_ROUNDS = 10
_INLIER_SIGMAS = 3.0
_PAIRS_MIN = 4
_MODE_ROWS_MAX, _MODE_TRIED_MAX = 3000, 500
_ADMITTED_SIGMAS, _ADMITTED_FLOOR_M = 4.0, 0.10
_SEARCHED_M = 1.5
_JUMP_PAIRS_MIN = 6
_JUMP_SHARE = 0.4  # of the defects of the smaller campaign, which agree on a jump


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameOffset:
    """Offset ``xyz_m`` (3,) in site of a campaign's positions on a facade ('' for the whole building).

    ``covariance_m2`` (3, 3); ``pairs``: number of defects that agree on it. ``limit_m``: the largest offset that the
    georeferencing of both campaigns admits, of one that was refused.
    """

    facade: str
    outcome: OffsetOutcome
    xyz_m: Float64x3
    covariance_m2: Float64x3x3
    pairs: int
    limit_m: float | None = None


def estimate_frame_offsets(known: DefectArrays, found: DefectArrays, sigma_m: float) -> list[FrameOffset]:
    """Offsets of ``found`` from ``known``: of the building first, then of each facade with enough pairs.

    Args:
        known: known defects, as last seen.
        found: defects of the next campaign.
        sigma_m: one sigma of the offset that both campaigns' georeferencing admit.
    """
    building = _estimate(known, found, np.zeros((len(found), 3)), sigma_m, facade="")
    offsets = [building]
    for facade in sorted(set(found.facade.tolist())):
        rows = np.flatnonzero(found.facade == facade)
        on_facade = found.take(rows)
        start = np.tile(building.xyz_m, (len(rows), 1))
        own = _estimate(known, on_facade, start, _FACADE_SIGMA_M, facade=facade)
        if own.pairs >= _PAIRS_MIN:
            offsets.append(replace(own, xyz_m=building.xyz_m + own.xyz_m))
    return offsets


def find_jump(known: DefectArrays, found: DefectArrays, sigma_m: float) -> FrameOffset | None:
    """An offset on which most defects agree, but which the campaigns' georeferencing does not admit; None: no such one.

    Args:
        known: known defects, as last seen.
        found: defects of the next campaign.
        sigma_m: one sigma of the offset that both campaigns' georeferencing admit.
    """
    limit_m = _ADMITTED_SIGMAS * sigma_m + _ADMITTED_FLOOR_M
    if limit_m >= _SEARCHED_M:
        return None
    start = np.zeros((len(found), 3))
    wide = _estimate(known, found, start, _SEARCHED_M, facade="")
    if wide.pairs < _JUMP_PAIRS_MIN or float(np.linalg.norm(wide.xyz_m)) <= limit_m:
        return None
    admitted = _estimate(known, found, start, sigma_m, facade="")
    enough = max(2 * admitted.pairs, _JUMP_SHARE * min(len(known), len(found)))
    return replace(wide, outcome=OffsetOutcome.REFUSED, limit_m=limit_m) if wide.pairs >= enough else None


def expand_offsets(offsets: list[FrameOffset], found: DefectArrays) -> Float64Nx3:
    """The offset (n, 3) at each defect: that of its facade, else of the building."""
    by_facade = {offset.facade: offset.xyz_m for offset in offsets}
    return np.array([by_facade.get(name, by_facade[""]) for name in found.facade.tolist()]).reshape(-1, 3)


def _estimate(
    known: DefectArrays, found: DefectArrays, start_m: Float64Nx3, sigma_m: float, *, facade: str
) -> FrameOffset:
    """Offset that remains after ``start_m`` (n, 3), with prior sigma ``sigma_m`` around zero."""
    pairs = find_candidates(known, found, start_m, sigma_m)
    prior: Float64x3x3 = np.eye(3) / sigma_m**2
    none = FrameOffset(
        facade=facade, outcome=OffsetOutcome.TOO_FEW, xyz_m=np.zeros(3), covariance_m2=sigma_m**2 * np.eye(3), pairs=0
    )
    same = known.defect_class[pairs.known] == found.defect_class[pairs.found]
    if not same.any():
        return none
    i, j, shift = pairs.known[same], pairs.found[same], pairs.displacement_m[same]
    extent = EXTENT_NOISE * np.hypot(known.extent_m[i], found.extent_m[j])
    covariance = (
        known.covariance_m2[i] + found.covariance_m2[j] + (_PAIR_FLOOR_M**2 + extent**2)[:, None, None] * np.eye(3)
    )
    information = np.linalg.inv(covariance)
    offset = shift[_find_mode(shift, information, prior)]
    inlier = np.zeros(len(shift), dtype=bool)
    for _ in range(_ROUNDS):
        residual = shift - offset
        squared = np.einsum("ki,kij,kj->k", residual, information, residual)
        inlier = squared < _INLIER_SIGMAS**2
        total = prior + information[inlier].sum(axis=0)
        offset = np.linalg.solve(total, np.einsum("kij,kj->i", information[inlier], shift[inlier]))
    if np.count_nonzero(inlier) < _PAIRS_MIN:
        return none
    return FrameOffset(
        facade=facade,
        outcome=OffsetOutcome.ESTIMATED,
        xyz_m=offset,
        covariance_m2=np.linalg.inv(prior + information[inlier].sum(axis=0)),
        pairs=int(min(len(np.unique(i[inlier])), len(np.unique(j[inlier])))),
    )


def _find_mode(shift: Float64Nx3, information: np.ndarray, prior: Float64x3x3) -> int:
    """Row of the displacement that most others support."""
    rows = np.arange(len(shift))
    if len(shift) > _MODE_ROWS_MAX:
        rows = np.random.default_rng(0).choice(len(shift), _MODE_ROWS_MAX, replace=False)
    tried = shift[rows[:: max(1, len(rows) // _MODE_TRIED_MAX)]]
    weight = information[rows]
    # (s - t)' W (s - t) of all rows s and all tried t at once, as products of matrices.
    weighted = np.einsum("kij,kj->ki", weight, shift[rows])
    squared = (
        np.einsum("ki,ki->k", weighted, shift[rows])
        - 2 * tried @ weighted.T
        + (tried[:, :, None] * tried[:, None, :]).reshape(-1, 9) @ weight.reshape(-1, 9).T
    )
    support = np.exp(-0.5 * squared).sum(axis=1) * np.exp(-0.5 * np.einsum("ki,ij,kj->k", tried, prior, tried))
    return int(rows[:: max(1, len(rows) // _MODE_TRIED_MAX)][np.argmax(support)])
