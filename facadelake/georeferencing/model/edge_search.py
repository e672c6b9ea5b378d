"""Search for the shift that walls do not determine (height; along a single facade too) by the model's edges.

All photographs together score a grid of shifts, coarse to fine. Windows and storeys repeat, so several shifts can fit:
the best must exceed every other one over the building's features, else the search is refused.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter

from facadelake.building.surface import ModelEdges, Surface
from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Float64Nx3, Float64x3, Int64Array
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import GeoreferenceError
from facadelake.georeferencing.model.edge_samples import find_visible_samples, sample_edges
from facadelake.georeferencing.model.edge_scores import EdgeScene, score_shifts, shift_camera
from facadelake.georeferencing.model.gradients import GreyPhotographs

logger = logging.getLogger(__name__)

_WINDOW_SIGMAS = 3.0
# Blur of the photographs on the building, coarse to fine; a search in two directions begins one level coarser.
_LEVELS_M = (0.32, 0.16, 0.08)
_FINEST_M = 0.04
_SPACING_M = 0.10
_COARSE_SPACING = 1.25  # of the coarsest blur
_SPARSE_M = 0.6
_GROUP_LEVELS = 7.5  # visibility is determined anew after this multiple of the coarsest blur
_MAX_PHOTOGRAPHS = 30
_MIN_FEATURES = 6
_MAX_PEAKS = 5
_MIN_PEAK_SEPARATION_M = 0.40  # two closer peaks are one shift, blurred by the building's relief
_MIN_GAP_SIGMAS = 2.0
_CONSENSUS_M = 0.4
_CONSENSUS_STEP_M = 0.02
_PROFILE_M = 0.06  # frames and mouldings show lines beside the modelled one
_OUTLIER_SHARE = 0.2  # share of features that match something else
_TRUSTED_SAMPLES = 200.0
_NO_EVIDENCE = 0.1
_BOOTSTRAPS = 200


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeShift:
    """The shift found by the edges.

    ``shift_site_m`` (3,) is to be added to the cameras' centres; ``sigma_m``: one sigma along the free directions.
    ``score`` (0 to 1): fit of the edges; ``edge_score_runner_up``: the best score elsewhere; ``gap_sigmas``: their
    difference in standard errors over the building's features. ``features``: number of visible features.
    """

    shift_site_m: Float64x3
    sigma_m: float
    score: float
    edge_score_runner_up: float
    gap_sigmas: float
    features: int


def search_shift(
    cameras: Sequence[PosedCamera],
    photographs: GreyPhotographs,
    edges: ModelEdges,
    surface: Surface,
    free_directions: Float64Nx3,
    sigma_m: Float64N,
    *,
    tolerance_m: float = 0.05,
) -> EdgeShift:
    """Search for the shift within three sigmas along the free directions.

    Args:
        cameras: the block's cameras in site.
        photographs: photograph k was taken by ``cameras[k]``.
        edges: the model's edges.
        surface: the model's surface.
        free_directions: unit directions (j, 3) in site that the walls do not determine; j is 1 or 2.
        sigma_m: one sigma (j,) of the shift along each.
        tolerance_m: one sigma of as-built against as-designed.

    Returns:
        the shift.

    Raises:
        GeoreferenceError: too few edges are visible, or two shifts fit equally well.
    """
    free_directions = np.asarray(free_directions, dtype=np.float64).reshape(-1, 3)
    reach = _WINDOW_SIGMAS * np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), len(free_directions))
    levels = _LEVELS_M[-1 - len(free_directions) :]
    scene = EdgeScene(
        cameras=cameras,
        photographs=photographs,
        rows=_choose_photographs(cameras, _MAX_PHOTOGRAPHS // len(free_directions)),
        samples=sample_edges(edges, _COARSE_SPACING * levels[0]),
        surface=surface,
        free_directions=free_directions,
        features=int(edges.feature.max(initial=-1)) + 1,
    )
    grid = _build_grid(reach, levels[0] / 2)
    shifts = grid.reshape(-1, len(free_directions))
    _, group = np.unique(np.round(shifts / (_GROUP_LEVELS * levels[0])), axis=0, return_inverse=True)
    visible = _find_visible_edges(scene, edges, shifts, group.ravel())
    scene = replace(scene, samples=scene.samples.take(visible[scene.samples.edge]))
    scores = score_shifts(scene, shifts, group.ravel(), levels[0])
    peaks = _find_peaks(scores.total.reshape(grid.shape[:-1]), grid, levels[0] / 2)
    dense = sample_edges(edges, _SPACING_M)
    scene = replace(scene, samples=dense.take(visible[dense.edge]))
    candidates: list[_ShiftCandidate] = []
    for coarser, finer in pairwise(levels):
        candidates = _refine_peaks(scene, peaks, coarser, finer)
        peaks = np.array([candidate.shift for candidate in candidates])
    best = candidates[0]
    features = int((best.weight > 0).sum())
    if features < _MIN_FEATURES:
        raise GeoreferenceError(
            f"{features} edges of the building model are visible in {len(scene.rows)} photographs, {_MIN_FEATURES} are "
            "needed: model openings, storey lines or eaves, take photographs that show them, or give control points"
        )
    rival, gap = _find_closest_rival(candidates)
    if gap < _MIN_GAP_SIGMAS:
        raise GeoreferenceError(
            f"two placements of the building model fit its edges equally well: a shift of "
            f"{_describe_shift(best.shift @ free_directions)} (score {best.score:.3f}) and of "
            f"{_describe_shift(rival.shift @ free_directions)} (score {rival.score:.3f}); they differ by "
            f"{gap:.1f} standard errors (limit {_MIN_GAP_SIGMAS}): storeys or windows repeat. Give one control point "
            "on the ground, photographs with RTK, or photographs of the building's ends and its roof"
        )
    logger.info("edges: best score %.3f, next %.3f, %.1f standard errors less", best.score, rival.score, gap)
    shift, sigma = _estimate_consensus(scene, best.shift, tolerance_m)
    return EdgeShift(
        shift_site_m=shift @ free_directions,
        sigma_m=sigma,
        score=best.score,
        edge_score_runner_up=rival.score,
        gap_sigmas=gap,
        features=features,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _ShiftCandidate:
    """A shift (j,) that may be right, and each feature's best evidence near it and root weight (features,)."""

    shift: Float64N
    score: float
    evidence: Float64N
    weight: Float64N


def _refine_peaks(scene: EdgeScene, peaks: Float64Array, coarser_m: float, finer_m: float) -> list[_ShiftCandidate]:
    """The ``peaks`` (k, j) refined to the finer level, best first; visibility is determined for each."""
    around = _build_grid(np.full(len(scene.free_directions), coarser_m), finer_m / 2).reshape(
        -1, len(scene.free_directions)
    )
    shifts = (peaks[:, None, :] + around[None]).reshape(-1, len(scene.free_directions))
    scores = score_shifts(scene, shifts, np.repeat(np.arange(len(peaks)), len(around)), finer_m)
    shape = (len(peaks), len(around), scene.features)
    total, mean = scores.total.reshape(shape[:2]), scores.mean.reshape(shape)
    root = np.sqrt(scores.weight).reshape(shape).mean(axis=1)
    best = total.argmax(axis=1)
    candidates = [
        _ShiftCandidate(
            shift=peaks[k] + around[best[k]],
            score=float(total[k, best[k]]),
            evidence=mean[k].max(axis=0),
            weight=root[k],
        )
        for k in range(len(peaks))
    ]
    return sorted(candidates, key=lambda candidate: -candidate.score)


def _find_closest_rival(candidates: list[_ShiftCandidate]) -> tuple[_ShiftCandidate, float]:
    """The other shift that the best exceeds by the fewest standard errors, and their number.

    The features' differences in evidence are a sample: their mean has a standard error from their scatter.
    """
    best, closest, smallest = candidates[0], candidates[0], np.inf
    for other in candidates[1:]:
        if np.linalg.norm(other.shift - best.shift) < _MIN_PEAK_SEPARATION_M:
            continue
        weight = np.maximum(best.weight, other.weight)
        share = weight / max(float(weight.sum()), 1e-12)
        difference = best.evidence - other.evidence
        mean = float(share @ difference)
        error = float(np.sqrt((share**2) @ (difference - mean) ** 2))
        gap = mean / max(error, 1e-9)
        if gap < smallest:
            closest, smallest = other, gap
    return closest, smallest


def _estimate_consensus(scene: EdgeScene, start: Float64N, tolerance_m: float) -> tuple[Float64N, float]:
    """The shift (j,) that most features agree on, near ``start`` (j,), and its standard error (m).

    Each feature has its own likelihood of the shift, with several modes where profiles run side by side. The shift of
    maximum likelihood is taken, where every feature deviates by the building's tolerance and a share of them are
    outliers. The error is the scatter under bootstrap over the features.
    """
    grid = _build_grid(np.full(len(scene.free_directions), _CONSENSUS_M), _CONSENSUS_STEP_M)
    shifts = start + grid.reshape(-1, len(scene.free_directions))
    scores = score_shifts(scene, shifts, np.zeros(len(shifts), dtype=np.int64), _FINEST_M)
    visible = np.median(scores.weight, axis=0) > 0
    curve = scores.mean[:, visible].T ** 2 + _NO_EVIDENCE**2  # flat for a feature without evidence
    curve /= curve.sum(axis=1, keepdims=True)
    trust = np.median(scores.weight[:, visible], axis=0)
    trust = trust / (trust + _TRUSTED_SAMPLES)
    blur = (0.0, *[float(np.hypot(tolerance_m, _PROFILE_M)) / _CONSENSUS_STEP_M] * len(scene.free_directions))
    likelihood = gaussian_filter(curve.reshape(-1, *grid.shape[:-1]), blur, mode="nearest").reshape(curve.shape)
    log_likelihood = np.log((1 - _OUTLIER_SHARE) * likelihood + _OUTLIER_SHARE / curve.shape[1])
    draws = np.random.default_rng(1).multinomial(len(trust), np.full(len(trust), 1 / len(trust)), size=_BOOTSTRAPS)
    total = (np.vstack([np.ones(len(trust)), draws]) * trust) @ log_likelihood
    best = shifts[total.argmax(axis=1)]
    spread = np.sqrt(((best[1:] - best[0]) ** 2).mean(axis=0).max() + _CONSENSUS_STEP_M**2 / 12)
    return best[0], float(spread)


def _describe_shift(shift_site_m: Float64x3) -> str:
    east, north, up = shift_site_m
    return f"{east:+.2f} m east, {north:+.2f} m north, {up:+.2f} m up"


def _build_grid(reach_m: Float64N, step_m: float) -> Float64Array:
    """Shifts (..., j) on a grid within ``reach_m`` (j,) about zero, which is one of them."""
    counts = [max(1, int(np.ceil(limit / step_m))) for limit in reach_m]
    axes = [np.arange(-count, count + 1) * step_m for count in counts]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def _choose_photographs(cameras: Sequence[PosedCamera], most: int) -> Int64Array:
    """Rows of at most ``most`` photographs, in even steps through the block."""
    count = min(len(cameras), most)
    return np.unique(np.linspace(0, len(cameras) - 1, count).round().astype(np.int64))


def _find_visible_edges(scene: EdgeScene, edges: ModelEdges, shifts: Float64Array, group: Int64Array) -> BoolArray:
    """The edges with a visible sparse sample from any group of shifts: most edges of a building are inside."""
    sparse = sample_edges(edges, _SPARSE_M)
    visible = np.zeros(len(edges.feature), dtype=bool)
    for k in range(group.max() + 1):
        centre = shifts[group == k].mean(axis=0) @ scene.free_directions
        for row in scene.rows:
            samples = find_visible_samples(
                sparse,
                shift_camera(scene.cameras[row], centre),
                scene.surface,
                border_px=0.0,
                free_directions=scene.free_directions,
            )
            visible[sparse.edge[samples.row]] = True
    return visible


def _find_peaks(total: Float64Array, grid: Float64Array, step_m: float) -> Float64Array:
    """The best local maxima (k, j), best first, each the highest within ``_MIN_PEAK_SEPARATION_M``."""
    highest = total == maximum_filter(total, size=2 * round(_MIN_PEAK_SEPARATION_M / step_m) + 1, mode="nearest")
    rows = np.flatnonzero(highest)
    order = rows[np.argsort(-total.ravel()[rows])][:_MAX_PEAKS]
    return grid.reshape(-1, grid.shape[-1])[order]
