"""The similarity that many point pairs share when most of the pairs may be wrong.

``similarity_fit.robust_similarity`` draws for a few good points (control, GPS) whose sigmas are known; here are
thousands of pairs, of which one in ten may be right: draws follow the pairs' order (the surest first), and three pairs
whose triangles are not alike are thrown away before anything is fitted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array, RowIndices
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity, estimate_similarity

# Shares of the ordered pairs to draw from, one after the other (PROSAC: Chum and Matas 2005), and triples of each.
_SHARES = (0.05, 0.15, 0.4, 1.0)
_MIN_PAIRS_DRAWN_FROM = 60
_TRIPLES = 60_000
# Triples that are alike are fitted, this many of each share; with a tenth of the pairs right, 60 are.
_MAX_FITS = 1_500
_MAX_SCORED_PAIRS = 4_000
# A triangle's sides must be so many tolerances long, or noise decides on its shape.
_MIN_SIDE_TOLERANCES = 10.0
_MAX_ITERATIONS = 20


@dataclass(frozen=True, kw_only=True, eq=False)
class SharedSimilarity:
    """The similarity, which pairs (n,) agree with it, and all residuals (n, 3) ``target - fit(source)``."""

    target_from_source: Similarity
    agrees: BoolArray
    residual: Float64Array


def search_similarity(
    source: Float64Array, target: Float64Array, tolerance: Float64Array, *, seed: int = 1
) -> SharedSimilarity | None:
    """The similarity on which most of the pairs (n, 3), ordered from sure to unsure, agree within ``tolerance`` (n,).

    None where no four pairs agree. ``tolerance`` and ``target`` have one unit; the scale is free within what the
    triangles say. Source: Fischler and Bolles 1981; MSAC (Torr and Zisserman 2000).
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
    source: Float64Array, target: Float64Array, tolerance: Float64Array, first: int, rng: np.random.Generator
) -> RowIndices:
    """Rows (m, 3) of ``first`` pairs whose triangles are long-sided and have one shape within the tolerances."""
    rows = rng.integers(0, first, size=(_TRIPLES, 3))
    sides = [(0, 1), (1, 2), (2, 0)]
    long_target = np.stack([np.linalg.norm(target[rows[:, i]] - target[rows[:, j]], axis=1) for i, j in sides], axis=1)
    long_source = np.stack([np.linalg.norm(source[rows[:, i]] - source[rows[:, j]], axis=1) for i, j in sides], axis=1)
    widest = tolerance[rows].max(axis=1, keepdims=True)
    usable = (long_target > _MIN_SIDE_TOLERANCES * widest).all(axis=1) & (long_source > 0).all(axis=1)
    rows, long_target, long_source, widest = (x[usable] for x in (rows, long_target, long_source, widest))
    longest = long_target.max(axis=1)
    # Height of a triangle over its longest side, by Heron: a thin one leaves the turn about its line open.
    half = long_target.sum(axis=1) / 2
    area = np.sqrt(np.maximum(half * (half[:, None] - long_target).prod(axis=1), 0.0))
    scale = long_target.sum(axis=1) / long_source.sum(axis=1)
    unlike = np.abs(long_target - scale[:, None] * long_source).max(axis=1)
    alike = (2 * area > 0.1 * longest**2) & (unlike < 1.5 * widest[:, 0])
    chosen: RowIndices = rows[alike][:_MAX_FITS]
    return chosen


def _fit_umeyama(source: Float64Array, target: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
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
    source: Float64Array,
    target: Float64Array,
    tolerance: Float64Array,
    rotation: Float64Array,
    translation: Float64Array,
    scale: Float64Array,
) -> Float64Array:
    moved = (scale[:, None, None] * rotation) @ source.T + translation[:, :, None]
    squared = ((moved - target.T) ** 2).sum(axis=1) / tolerance**2
    cost: Float64Array = np.minimum(squared, 1.0).sum(axis=1)
    return cost


def _refine_similarity(
    start: Similarity, source: Float64Array, target: Float64Array, tolerance: Float64Array
) -> SharedSimilarity | None:
    """Least squares on what agrees, until that no longer changes; wide at first, for three points have a long lever."""
    fit, agrees = start, np.zeros(len(source), dtype=bool)
    for widening in np.r_[2.0, 1.5, np.ones(_MAX_ITERATIONS)]:
        residual = target - fit.apply(source)
        now = np.linalg.norm(residual, axis=1) < widening * tolerance
        if now.sum() < 4:
            return None
        if widening == 1.0 and (now == agrees).all():
            break
        agrees = now
        try:
            fit = estimate_similarity(source[agrees], target[agrees], 1.0 / tolerance[agrees] ** 2)
        except GeoreferenceError:  # what agrees lies on one line
            return None
    residual = target - fit.apply(source)
    return SharedSimilarity(target_from_source=fit, agrees=agrees, residual=residual)
