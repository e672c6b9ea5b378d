"""A similarity fitted to points of which some are wrong, with anisotropic sigmas, and how well it is determined."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from facadelake.core.arrays import BoolArray, Float64Array
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity, estimate_similarity

# Three points fix a similarity; a draw whose triangle is thinner than this (height over longest side) is not tried.
_MIN_TRIANGLE_HEIGHT_RATIO = 0.02
_MAX_POINTS_FOR_ALL_TRIPLES = 18
_DRAWS = 1500
_OUTLIER_SIGMAS = 3.5


@dataclass(frozen=True, kw_only=True, eq=False)
class SimilarityFit:
    """The similarity, which points it rests on, and the residuals (n, 3) ``target - fit(source)`` of all points."""

    target_from_source: Similarity
    used: BoolArray
    residual: Float64Array


def fit_similarity(source: Float64Array, target: Float64Array, sigma: Float64Array, *, seed: int = 1) -> SimilarityFit:
    """RANSAC similarity of point pairs (n, 3), then least squares; ``sigma`` (n, 3) are one-sigma errors of ``target``.

    A point is used where its residual stays within 3.5 sigma. Raises GeoreferenceError for fewer than 3 points, points
    on a line, or fewer than 3 that agree. Source: Fischler and Bolles 1981; Umeyama 1991.
    """
    if len(source) < 3:
        estimate_similarity(source, target)  # says what is missing
    best: BoolArray = np.zeros(len(source), dtype=bool)
    best_cost = np.inf
    for triple in _draw_triples(len(source), seed):
        if _is_thin(source[triple]) or _is_thin(target[triple]):
            continue
        distance = _compute_normalised_distance(
            source, target, sigma, estimate_similarity(source[triple], target[triple])
        )
        cost = float(np.minimum(distance, _OUTLIER_SIGMAS).sum())  # MSAC: inliers count by how well they fit
        if cost < best_cost:
            best, best_cost = distance < _OUTLIER_SIGMAS, cost
    if best.sum() < 3:
        raise GeoreferenceError(
            f"no 3 of the {len(source)} positions agree on one placement (or all lie near a line); check the control "
            "points or GPS positions for gross errors, or give control points off the line"
        )
    weight = 1.0 / (sigma**2).sum(axis=1)
    for _ in range(10):
        fit = estimate_similarity(source[best], target[best], weight[best])
        now = _compute_normalised_distance(source, target, sigma, fit) < _OUTLIER_SIGMAS
        if now.sum() < 3 or (now == best).all():
            break
        best = now
    return SimilarityFit(target_from_source=fit, used=best, residual=target - fit.apply(source))


def _draw_triples(n: int, seed: int) -> list[list[int]]:
    if n <= _MAX_POINTS_FOR_ALL_TRIPLES:
        return [list(triple) for triple in combinations(range(n), 3)]
    rng = np.random.default_rng(seed)
    return [rng.choice(n, size=3, replace=False).tolist() for _ in range(_DRAWS)]


def _is_thin(corners: Float64Array) -> bool:
    a, b = corners[1] - corners[0], corners[2] - corners[0]
    longest = max(float(a @ a), float(b @ b), float((b - a) @ (b - a)))
    return bool(np.linalg.norm(np.cross(a, b)) < _MIN_TRIANGLE_HEIGHT_RATIO * longest)


def _compute_normalised_distance(
    source: Float64Array, target: Float64Array, sigma: Float64Array, fit: Similarity
) -> Float64Array:
    distance: Float64Array = np.sqrt((((target - fit.apply(source)) / sigma) ** 2).mean(axis=1))
    return distance


def apply_parameters(start: Similarity, pivot: Float64Array, step: Float64Array) -> Similarity:
    """``start`` moved by ``step``: translation (3), rotation vector (3) about ``pivot`` (3,), logarithm of scale (1).

    Steps about a pivot amid the points keep translation, rotation and scale nearly uncorrelated.
    """
    turn = Rotation.from_rotvec(step[3:6]).as_matrix()
    scale = float(np.exp(step[6]))
    about = Similarity(rotation=turn, translation=pivot - scale * turn @ pivot + step[:3], scale=scale)
    moved = about @ start
    # Products of rotations drift from orthonormal by rounding; put them back.
    return Similarity(
        rotation=Rotation.from_matrix(moved.rotation).as_matrix(), translation=moved.translation, scale=moved.scale
    )
