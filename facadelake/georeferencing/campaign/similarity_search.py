"""Search for the similarity that many point pairs share when most of the pairs may be wrong.

``similarity_fit.fit_similarity`` draws from a few good points (control, GPS) with known sigmas. Here are thousands of
pairs, of which one in ten may be right: draws follow the pairs' order (the most distinctive first), and three pairs
with triangles of different shape are rejected before anything is fitted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Float64Nx3, Float64Nx3x3, RowIndices
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity, estimate_similarity

# Shares of the ordered pairs to draw from, one after the other (PROSAC: Chum and Matas 2005), and triples of each.
_SHARES = (0.05, 0.15, 0.4, 1.0)
_MIN_PAIRS_DRAWN_FROM = 60
_TRIPLES = 60_000
# Similar triples to fit of each share; with a tenth of the pairs right, 60 of 60,000 are.
_MAX_FITS = 1_500
_MAX_SCORED_PAIRS = 4_000
# A triangle's sides must be so many tolerances long, or noise determines its shape.
_MIN_SIDE_TOLERANCES = 10.0
_MAX_ITERATIONS = 20


@dataclass(frozen=True, kw_only=True, eq=False)
class SharedSimilarity:
    """The similarity, the pairs (n,) that agree with it, and all residuals (n, 3) ``target - fit(source)``."""

    target_from_source: Similarity
    agrees: BoolArray
    residual: Float64Nx3


def search_similarity(
    source: Float64Nx3, target: Float64Nx3, tolerance: Float64N, *, seed: int = 1
) -> SharedSimilarity | None:
    """Search for the similarity on which most pairs agree.

    Args:
        source: points (n, 3), ordered from the most to the least distinctive pair.
        target: their partners (n, 3) in the target frame.
        tolerance: tolerance (n,) of each residual, in the unit of ``target``.
        seed: seed of the draws.

    Returns:
        the similarity; None where no four pairs agree.

    Source: Fischler and Bolles 1981; MSAC (Torr and Zisserman 2000); PROSAC (Chum and Matas 2005).
    """
    if len(source) < 3:
        return None
    rng = np.random.default_rng(seed)
    scored = np.sort(rng.permutation(len(source))[:_MAX_SCORED_PAIRS])
    best, best_cost = None, np.inf
    for share in _SHARES:
        first = min(max(int(share * len(source)), _MIN_PAIRS_DRAWN_FROM), len(source))
        triples = _draw_similar_triples(source, target, tolerance, first, rng)
        for rows in np.array_split(triples, max(len(triples) // 50, 1)):
            rotation, translation, scale = _fit_umeyama(source[rows], target[rows])
            cost = _compute_cost(source[scored], target[scored], tolerance[scored], rotation, translation, scale)
            if len(cost) and cost.min() < best_cost:
                k = int(cost.argmin())
                best_cost = float(cost[k])
                best = Similarity(rotation=rotation[k], translation=translation[k], scale=float(scale[k]))
        if best_cost < 0.5 * len(scored):  # more than half agree: no other placement can have more
            break
    return None if best is None else _refine_similarity(best, source, target, tolerance)


def _draw_similar_triples(
    source: Float64Nx3, target: Float64Nx3, tolerance: Float64N, first: int, rng: np.random.Generator
) -> RowIndices:
    """Rows (m, 3) of the ``first`` pairs whose triangles have long sides and one shape within the tolerances."""
    rows = rng.integers(0, first, size=(_TRIPLES, 3))
    sides = [(0, 1), (1, 2), (2, 0)]
    long_target = np.stack([np.linalg.norm(target[rows[:, i]] - target[rows[:, j]], axis=1) for i, j in sides], axis=1)
    long_source = np.stack([np.linalg.norm(source[rows[:, i]] - source[rows[:, j]], axis=1) for i, j in sides], axis=1)
    widest = tolerance[rows].max(axis=1, keepdims=True)
    usable = (long_target > _MIN_SIDE_TOLERANCES * widest).all(axis=1) & (long_source > 0).all(axis=1)
    rows, long_target, long_source, widest = (x[usable] for x in (rows, long_target, long_source, widest))
    longest = long_target.max(axis=1)
    # Height of a triangle over its longest side, by Heron: a thin one leaves the rotation about its line open.
    half = long_target.sum(axis=1) / 2
    area = np.sqrt(np.maximum(half * (half[:, None] - long_target).prod(axis=1), 0.0))
    scale = long_target.sum(axis=1) / long_source.sum(axis=1)
    difference = np.abs(long_target - scale[:, None] * long_source).max(axis=1)
    similar = (2 * area > 0.1 * longest**2) & (difference < 1.5 * widest[:, 0])
    chosen: RowIndices = rows[similar][:_MAX_FITS]
    return chosen


def _fit_umeyama(source: Float64Nx3x3, target: Float64Nx3x3) -> tuple[Float64Nx3x3, Float64Nx3, Float64N]:
    """Rotations (m, 3, 3), translations (m, 3), scales (m,) of triples (m, 3, 3); Umeyama 1991, many at once."""
    mean_source, mean_target = source.mean(axis=1), target.mean(axis=1)
    a, b = source - mean_source[:, None], target - mean_target[:, None]
    u, s, vt = np.linalg.svd(b.transpose(0, 2, 1) @ a)
    s[:, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))
    u[:, :, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[:, None]
    rotation = u @ vt
    scale = s.sum(axis=1) / (a**2).sum(axis=(1, 2))
    translation = mean_target - scale[:, None] * np.einsum("mij,mj->mi", rotation, mean_source)
    return rotation, translation, scale


def _compute_cost(
    source: Float64Nx3,
    target: Float64Nx3,
    tolerance: Float64N,
    rotation: Float64Nx3x3,
    translation: Float64Nx3,
    scale: Float64N,
) -> Float64N:
    """MSAC cost (m,) of m similarities on n pairs."""
    transformed = (scale[:, None, None] * rotation) @ source.T + translation[:, :, None]
    squared = ((transformed - target.T) ** 2).sum(axis=1) / tolerance**2
    cost: Float64Array = np.minimum(squared, 1.0).sum(axis=1)
    return cost


def _refine_similarity(
    start: Similarity, source: Float64Nx3, target: Float64Nx3, tolerance: Float64N
) -> SharedSimilarity | None:
    """Least squares on the agreeing pairs until they no longer change; None where fewer than four agree.

    The tolerance is wide at first, because the error of three points grows with the distance from them.
    """
    fit, agrees = start, np.zeros(len(source), dtype=bool)
    for widening in np.r_[2.0, 1.5, np.ones(_MAX_ITERATIONS)]:
        residual = target - fit.apply(source)
        within = np.linalg.norm(residual, axis=1) < widening * tolerance
        if within.sum() < 4:
            return None
        if widening == 1.0 and (within == agrees).all():
            break
        agrees = within
        try:
            fit = estimate_similarity(source[agrees], target[agrees], 1.0 / tolerance[agrees] ** 2)
        except GeoreferenceError:  # the agreeing points lie on one line
            return None
    residual = target - fit.apply(source)
    return SharedSimilarity(target_from_source=fit, agrees=agrees, residual=residual)
