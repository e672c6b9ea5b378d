"""The shift that walls do not observe (height; along a lone facade too), searched by the model's edges.

All photographs together score a grid of shifts, coarse to fine. Windows and storeys repeat, so several answers can
look alike: the best must beat every other one feature by feature, else the search refuses.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter

from facadelake.building.surface import ModelEdges, Surface
from facadelake.core.arrays import BoolArray, Float64Array, Int64Array
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
_NODE_LEVELS = 7.5  # what is visible is asked anew after so many times the coarsest blur
_MAX_PHOTOGRAPHS = 30
_MIN_FEATURES = 6
_MAX_PEAKS = 5
_MIN_PEAK_SEPARATION_M = 0.40  # two peaks closer than this are one answer, blurred by the building's relief
_MIN_GAP_SIGMAS = 2.0
_CONSENSUS_M = 0.4
_CONSENSUS_STEP_M = 0.02
_PROFILE_M = 0.06  # frames and mouldings show lines beside the one that was modelled
_OUTLIER_SHARE = 0.2  # share of features that show something else
_TRUSTED_SAMPLES = 200.0
_NO_EVIDENCE = 0.1
_BOOTSTRAPS = 200


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeShift:
    """``shift_site_m`` (3,) is to be added to the cameras' centres; ``sigma_m`` one sigma along the free directions.

    ``score`` (0 to 1) is how well the edges are met there, ``edge_score_runner_up`` the best elsewhere, at
    ``competing_shift_site_m`` (3,); ``gap_sigmas`` is by how many standard errors, over the building's features, the
    best is better.
    """

    shift_site_m: Float64Array
    sigma_m: float
    score: float
    edge_score_runner_up: float
    competing_shift_site_m: Float64Array
    gap_sigmas: float
    features: int


def search_shift(
    cameras: Sequence[PosedCamera],
    photographs: GreyPhotographs,
    edges: ModelEdges,
    surface: Surface,
    free: Float64Array,
    sigma_m: Float64Array,
    *,
    tolerance_m: float = 0.05,
) -> EdgeShift:
    """Search within three ``sigma_m`` (j,) along the unit directions ``free_directions`` (j, 3) of site; j is 1 or 2.

    Photograph k of ``photographs`` was taken by ``cameras[k]``; ``tolerance_m`` is one sigma of as-built against
    as-designed. Raises GeoreferenceError where too little of the model is seen, or two answers compete.
    """
    free = np.asarray(free, dtype=np.float64).reshape(-1, 3)
    reach = _WINDOW_SIGMAS * np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), len(free))
    levels = _LEVELS_M[-1 - len(free) :]
    search = EdgeScene(
        cameras=cameras,
        photographs=photographs,
        rows=_choose_photographs(cameras, _MAX_PHOTOGRAPHS // len(free)),
        samples=sample_edges(edges, _COARSE_SPACING * levels[0]),
        surface=surface,
        free_directions=free,
        features=int(edges.feature.max(initial=-1)) + 1,
    )
    grid = _build_grid(reach, levels[0] / 2)
    shifts = grid.reshape(-1, len(free))
    _, node = np.unique(np.round(shifts / (_NODE_LEVELS * levels[0])), axis=0, return_inverse=True)
    seen = _find_visible_edges(search, edges, shifts, node.ravel())
    search = replace(search, samples=search.samples.take(seen[search.samples.edge]))
    scores = score_shifts(search, shifts, node.ravel(), levels[0])
    peaks = _find_peaks(scores.total.reshape(grid.shape[:-1]), grid, levels[0] / 2)
    dense = sample_edges(edges, _SPACING_M)
    search = replace(search, samples=dense.take(seen[dense.edge]))
    rivals: list[_ShiftCandidate] = []
    for coarser, finer in pairwise(levels):
        rivals = _refine_peaks(search, peaks, coarser, finer)
        peaks = np.array([rival.shift for rival in rivals])
    best = rivals[0]
    features = int((best.weight > 0).sum())
    if features < _MIN_FEATURES:
        raise GeoreferenceError(
            f"{features} edges of the building model are seen by {len(search.rows)} photographs, {_MIN_FEATURES} are "
            "needed: model openings, storey lines or eaves, take photographs that show them, or give control points"
        )
    rival, gap = _find_closest_rival(rivals)
    if gap < _MIN_GAP_SIGMAS:
        raise GeoreferenceError(
            f"two placements of the building model fit its edges alike: a shift of {_describe_shift(best.shift @ free)} (score "
            f"{best.score:.3f}) and of {_describe_shift(rival.shift @ free)} (score {rival.score:.3f}); they differ by "
            f"{gap:.1f} standard errors (limit {_MIN_GAP_SIGMAS}): storeys or windows repeat. Give one control point "
            "on the ground, or photographs with RTK, or that show the building's ends and its roof"
        )
    logger.info("edges: best score %.3f, next %.3f, %.1f standard errors less", best.score, rival.score, gap)
    shift, sigma = _estimate_consensus(search, best.shift, tolerance_m)
    return EdgeShift(
        shift_site_m=shift @ free,
        sigma_m=sigma,
        score=best.score,
        edge_score_runner_up=rival.score,
        competing_shift_site_m=rival.shift @ free,
        gap_sigmas=gap,
        features=features,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _ShiftCandidate:
    """A shift (j,) that may be the answer, and each feature's best evidence near it and root weight (features,)."""

    shift: Float64Array
    score: float
    evidence: Float64Array
    weight: Float64Array


def _refine_peaks(search: EdgeScene, peaks: Float64Array, coarser_m: float, finer_m: float) -> list[_ShiftCandidate]:
    """The peaks moved to their best place at the finer level, best first; each sees what is visible there."""
    around = _build_grid(np.full(len(search.free_directions), coarser_m), finer_m / 2).reshape(
        -1, len(search.free_directions)
    )
    shifts = (peaks[:, None, :] + around[None]).reshape(-1, len(search.free_directions))
    scores = score_shifts(search, shifts, np.repeat(np.arange(len(peaks)), len(around)), finer_m)
    shape = (len(peaks), len(around), search.features)
    total, mean = scores.total.reshape(shape[:2]), scores.mean.reshape(shape)
    root = np.sqrt(scores.weight).reshape(shape).mean(axis=1)
    best = total.argmax(axis=1)
    found = [
        _ShiftCandidate(
            shift=peaks[k] + around[best[k]],
            score=float(total[k, best[k]]),
            evidence=mean[k].max(axis=0),
            weight=root[k],
        )
        for k in range(len(peaks))
    ]
    return sorted(found, key=lambda peak: -peak.score)


def _find_closest_rival(rivals: list[_ShiftCandidate]) -> tuple[_ShiftCandidate, float]:
    """The other answer that the best beats by the fewest standard errors, and by how many.

    Each feature is a witness: what they say of the difference has a mean and, from their scatter, a standard error.
    """
    best, closest, least = rivals[0], rivals[0], np.inf
    for other in rivals[1:]:
        if np.linalg.norm(other.shift - best.shift) < _MIN_PEAK_SEPARATION_M:
            continue
        weight = np.maximum(best.weight, other.weight)
        share = weight / max(float(weight.sum()), 1e-12)
        difference = best.evidence - other.evidence
        mean = float(share @ difference)
        error = float(np.sqrt((share**2) @ (difference - mean) ** 2))
        gap = mean / max(error, 1e-9)
        if gap < least:
            closest, least = other, gap
    return closest, least


def _estimate_consensus(search: EdgeScene, start: Float64Array, tolerance_m: float) -> tuple[Float64Array, float]:
    """The shift (j,) that most features agree on, and its standard error (m).

    Each feature has its own idea of the shift, with several candidates where profiles run side by side. The likeliest
    shift is taken, where every feature is off by its own normal deviation, the building's tolerance, and a share of
    them is mistaken. The error is the scatter under resampling of the features.
    """
    grid = _build_grid(np.full(len(search.free_directions), _CONSENSUS_M), _CONSENSUS_STEP_M)
    shifts = start + grid.reshape(-1, len(search.free_directions))
    scores = score_shifts(search, shifts, np.zeros(len(shifts), dtype=np.int64), _FINEST_M)
    seen = np.median(scores.weight, axis=0) > 0
    curve = scores.mean[:, seen].T ** 2 + _NO_EVIDENCE**2  # a feature that nothing shows says nothing
    curve /= curve.sum(axis=1, keepdims=True)
    trust = np.median(scores.weight[:, seen], axis=0)
    trust = trust / (trust + _TRUSTED_SAMPLES)
    blur = (0.0, *[float(np.hypot(tolerance_m, _PROFILE_M)) / _CONSENSUS_STEP_M] * len(search.free_directions))
    likely = gaussian_filter(curve.reshape(-1, *grid.shape[:-1]), blur, mode="nearest").reshape(curve.shape)
    ballots = np.log((1 - _OUTLIER_SHARE) * likely + _OUTLIER_SHARE / curve.shape[1])
    draws = np.random.default_rng(1).multinomial(len(trust), np.full(len(trust), 1 / len(trust)), size=_BOOTSTRAPS)
    total = (np.vstack([np.ones(len(trust)), draws]) * trust) @ ballots
    places = shifts[total.argmax(axis=1)]
    spread = np.sqrt(((places[1:] - places[0]) ** 2).mean(axis=0).max() + _CONSENSUS_STEP_M**2 / 12)
    return places[0], float(spread)


def _describe_shift(shift_site_m: Float64Array) -> str:
    east, north, up = shift_site_m
    return f"{east:+.2f} m east, {north:+.2f} m north, {up:+.2f} m up"


def _build_grid(reach_m: Float64Array, step_m: float) -> Float64Array:
    """Shifts (..., j) on a grid within ``reach_m`` (j,) of none, none among them."""
    counts = [max(1, int(np.ceil(limit / step_m))) for limit in reach_m]
    axes = [np.arange(-count, count + 1) * step_m for count in counts]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def _choose_photographs(cameras: Sequence[PosedCamera], most: int) -> Int64Array:
    """Rows of at most ``most`` photographs, in even steps through the block."""
    count = min(len(cameras), most)
    return np.unique(np.linspace(0, len(cameras) - 1, count).round().astype(np.int64))


def _find_visible_edges(search: EdgeScene, edges: ModelEdges, shifts: Float64Array, node: Int64Array) -> BoolArray:
    """The edges that a sparse look, from every node, finds visible: most of a building is inside."""
    sparse = sample_edges(edges, _SPARSE_M)
    seen = np.zeros(len(edges.feature), dtype=bool)
    for k in range(node.max() + 1):
        centre = shifts[node == k].mean(axis=0) @ search.free_directions
        for row in search.rows:
            found = find_visible_samples(
                sparse,
                shift_camera(search.cameras[row], centre),
                search.surface,
                border_px=0.0,
                free_directions=search.free_directions,
            )
            seen[sparse.edge[found.row]] = True
    return seen


def _find_peaks(total: Float64Array, grid: Float64Array, step_m: float) -> Float64Array:
    """The best local maxima (k, j), best first, each the highest within ``_MIN_PEAK_SEPARATION_M``."""
    highest = total == maximum_filter(total, size=2 * round(_MIN_PEAK_SEPARATION_M / step_m) + 1, mode="nearest")
    at = np.flatnonzero(highest)
    order = at[np.argsort(-total.ravel()[at])][:_MAX_PEAKS]
    return grid.reshape(-1, grid.shape[-1])[order]
