"""Robust fit of a similarity to point pairs with anisotropic sigmas, some of which are gross errors."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Float64Nx3, Float64x3, Float64x3x3
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity, estimate_similarity

# Three points fix a similarity; a draw whose triangle is thinner than this (height over longest side) is not tried.
_MIN_TRIANGLE_HEIGHT_RATIO = 0.02
_MAX_POINTS_FOR_ALL_TRIPLES = 18
_DRAWS = 1500
_OUTLIER_SIGMAS = 3.5


@dataclass(frozen=True, kw_only=True, eq=False)
class SimilarityFit:
    """The similarity, the points used (n,), and the residuals (n, 3) ``target - fit(source)`` of all points."""

    target_from_source: Similarity
    used: BoolArray
    residual: Float64Nx3


def fit_similarity(source: Float64Nx3, target: Float64Nx3, sigma: Float64Nx3, *, seed: int = 1) -> SimilarityFit:
    """Fit a similarity by RANSAC, then by least squares on the inliers.

    Args:
        source: points (n, 3).
        target: the same points (n, 3) in the target frame.
        sigma: one sigma (n, 3) of ``target`` per axis. A point is used where its residual is within 3.5 sigmas.
        seed: seed of the draws.

    Returns:
        the similarity and the points used.

    Raises:
        GeoreferenceError: fewer than 3 points, points on a line, or fewer than 3 that agree.

    Source: Fischler and Bolles 1981; MSAC cost by Torr and Zisserman 2000; Umeyama 1991.
    """
    if len(source) < 3:
        estimate_similarity(source, target)  # raises with the reason
    best: BoolArray = np.zeros(len(source), dtype=bool)
    best_cost = np.inf
    for triple in _draw_triples(len(source), seed):
        if _is_thin(source[triple]) or _is_thin(target[triple]):
            continue
        distance = _compute_normalised_distance(
            source, target, sigma, estimate_similarity(source[triple], target[triple])
        )
        cost = float(np.minimum(distance, _OUTLIER_SIGMAS).sum())  # MSAC: inliers count by their residual
        if cost < best_cost:
            best, best_cost = distance < _OUTLIER_SIGMAS, cost
    if best.sum() < 3:
        raise GeoreferenceError(
            f"no 3 of the {len(source)} positions agree on one placement (or all are nearly collinear); check the "
            "control points or GPS positions for gross errors, or give control points off the line"
        )
    weight = 1.0 / (sigma**2).sum(axis=1)
    for _ in range(10):
        fit = estimate_similarity(source[best], target[best], weight[best])
        inliers = _compute_normalised_distance(source, target, sigma, fit) < _OUTLIER_SIGMAS
        if inliers.sum() < 3 or (inliers == best).all():
            break
        best = inliers
    return SimilarityFit(target_from_source=fit, used=best, residual=target - fit.apply(source))


def _draw_triples(count: int, seed: int) -> list[list[int]]:
    if count <= _MAX_POINTS_FOR_ALL_TRIPLES:
        return [list(triple) for triple in combinations(range(count), 3)]
    rng = np.random.default_rng(seed)
    return [rng.choice(count, size=3, replace=False).tolist() for _ in range(_DRAWS)]


def _is_thin(corners: Float64x3x3) -> bool:
    a, b = corners[1] - corners[0], corners[2] - corners[0]
    longest = max(float(a @ a), float(b @ b), float((b - a) @ (b - a)))
    return bool(np.linalg.norm(np.cross(a, b)) < _MIN_TRIANGLE_HEIGHT_RATIO * longest)


def _compute_normalised_distance(
    source: Float64Nx3, target: Float64Nx3, sigma: Float64Nx3, target_from_source: Similarity
) -> Float64N:
    """Root mean square (n,) of the residual's components, each in its own sigma."""
    distance: Float64Array = np.sqrt((((target - target_from_source.apply(source)) / sigma) ** 2).mean(axis=1))
    return distance


def apply_parameters(start: Similarity, pivot: Float64x3, step: Float64Array) -> Similarity:
    """``start`` changed by ``step`` (7,): translation, rotation vector about ``pivot`` (3,), logarithm of scale.

    Steps about a pivot amid the points keep translation, rotation and scale nearly uncorrelated.
    """
    rotation = Rotation.from_rotvec(step[3:6]).as_matrix()
    scale = float(np.exp(step[6]))
    change = Similarity(rotation=rotation, translation=pivot - scale * rotation @ pivot + step[:3], scale=scale)
    changed = change @ start
    # Products of rotations lose orthonormality by rounding; restore it.
    return Similarity(
        rotation=Rotation.from_matrix(changed.rotation).as_matrix(),
        translation=changed.translation,
        scale=changed.scale,
    )
