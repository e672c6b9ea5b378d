"""The shift that walls do not observe (height; along a lone facade too), searched by the model's edges.

All photographs together score a grid of shifts, coarse to fine. Windows and storeys repeat, so several answers can
look alike: the best must beat every other one feature by feature, else the search refuses.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter

from facadelake.camera import PosedCamera
from facadelake.errors import GeoreferenceError
from facadelake.frames import Array, Similarity
from facadelake.geobim.edges import ModelEdges
from facadelake.geobim.surface import Surface
from facadelake.pose.edge_views import EdgeSamples, SeenSamples, sample_edges, seen_samples
from facadelake.pose.gradients import Gradients, GreyPhotographs, gradients, reduction_for

_log = logging.getLogger(__name__)

_WINDOW_SIGMAS = 3.0
# Blur of the photographs on the building, coarse to fine; a search in two directions begins one level coarser.
_LEVELS_M = (0.32, 0.16, 0.08)
_FINEST_M = 0.04
_SPACING_M = 0.10
_COARSE_SPACING = 1.25  # of the coarsest blur
_SPARSE_M = 0.6
_NODE_LEVELS = 7.5  # what is visible is asked anew after so many times the coarsest blur
_MOST_PHOTOS = 30
_LEAST_SAMPLES = 3  # of an edge in a photograph
_LEAST_FEATURES = 6
_RIVALS = 5
_APART_M = 0.40  # two peaks closer than this are one answer, blurred by the building's relief
_LEAST_GAP_SIGMAS = 2.0
_BATCH = 64
_CONSENSUS_M = 0.4
_CONSENSUS_STEP_M = 0.02
_PROFILE_M = 0.06  # frames and mouldings show lines beside the one that was modelled
_MISTAKEN = 0.2  # share of features that show something else
_TRUSTED_SAMPLES = 200.0
_NO_EVIDENCE = 0.1
_BOOTSTRAPS = 200


@dataclass(frozen=True, kw_only=True, eq=False)
class ShiftFound:
    """``shift_site_m`` (3,) is to be added to the cameras' centres; ``sigma_m`` one sigma along the free directions.

    ``score`` (0 to 1) is how well the edges are met there, ``competing_score`` the best elsewhere, at
    ``competing_shift_site_m`` (3,); ``gap_sigmas`` is by how many standard errors, over the building's features, the
    best is better.
    """

    shift_site_m: Array
    sigma_m: float
    score: float
    competing_score: float
    competing_shift_site_m: Array
    gap_sigmas: float
    features: int


@dataclass(frozen=True, kw_only=True, eq=False)
class _Search:
    """What the scores are made of; ``rows`` are the photographs used."""

    cameras: Sequence[PosedCamera]
    photographs: GreyPhotographs
    rows: NDArray[np.int64]
    samples: EdgeSamples
    surface: Surface
    free: Array
    features: int


@dataclass(frozen=True, kw_only=True, eq=False)
class _Scores:
    """Evidence (shifts, features) and its weight; ``usual_weight`` is what a shift is expected to see."""

    evidence: Array
    weight: Array
    usual_weight: float

    @property
    def mean(self) -> Array:
        """Mean evidence (shifts, features), 0 to 1; 0 where nothing is seen."""
        return np.divide(self.evidence, self.weight, out=np.zeros_like(self.evidence), where=self.weight > 0)

    @property
    def total(self) -> Array:
        """Score of each shift: mean evidence of the features, each counted by the root of what is seen of it."""
        root = np.sqrt(self.weight)
        # A shift that leaves little in sight (cameras under the ground) is not to win by a few chance hits.
        total: Array = (root * self.mean).sum(axis=1) / np.maximum(root.sum(axis=1), self.usual_weight)
        return total


def find_shift(
    cameras: Sequence[PosedCamera],
    photographs: GreyPhotographs,
    edges: ModelEdges,
    surface: Surface,
    free: Array,
    sigma_m: Array,
    *,
    tolerance_m: float = 0.05,
) -> ShiftFound:
    """Search within three ``sigma_m`` (j,) along the unit directions ``free`` (j, 3) of site; j is 1 or 2.

    Photograph k of ``photographs`` was taken by ``cameras[k]``; ``tolerance_m`` is one sigma of as-built against
    as-designed. Raises GeoreferenceError where too little of the model is seen, or two answers compete.
    """
    free = np.asarray(free, dtype=np.float64).reshape(-1, 3)
    reach = _WINDOW_SIGMAS * np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), len(free))
    levels = _LEVELS_M[-1 - len(free) :]
    search = _Search(
        cameras=cameras,
        photographs=photographs,
        rows=_spread(cameras, _MOST_PHOTOS // len(free)),
        samples=sample_edges(edges, _COARSE_SPACING * levels[0]),
        surface=surface,
        free=free,
        features=int(edges.feature.max(initial=-1)) + 1,
    )
    grid = _grid(reach, levels[0] / 2)
    shifts = grid.reshape(-1, len(free))
    _, node = np.unique(np.round(shifts / (_NODE_LEVELS * levels[0])), axis=0, return_inverse=True)
    seen = _ever_seen(search, edges, shifts, node.ravel())
    search = replace(search, samples=search.samples.take(seen[search.samples.edge]))
    scores = _scores(search, shifts, node.ravel(), levels[0])
    peaks = _peaks(scores.total.reshape(grid.shape[:-1]), grid, levels[0] / 2)
    dense = sample_edges(edges, _SPACING_M)
    search = replace(search, samples=dense.take(seen[dense.edge]))
    rivals: list[_Peak] = []
    for coarser, finer in pairwise(levels):
        rivals = _refined(search, peaks, coarser, finer)
        peaks = np.array([rival.shift for rival in rivals])
    best = rivals[0]
    features = int((best.weight > 0).sum())
    if features < _LEAST_FEATURES:
        raise GeoreferenceError(
            f"{features} edges of the building model are seen by {len(search.rows)} photographs, {_LEAST_FEATURES} are "
            "needed: model openings, storey lines or eaves, take photographs that show them, or give control points"
        )
    rival, gap = _closest_rival(rivals)
    if gap < _LEAST_GAP_SIGMAS:
        raise GeoreferenceError(
            f"two placements of the building model fit its edges alike: a shift of {_words(best.shift @ free)} (score "
            f"{best.score:.3f}) and of {_words(rival.shift @ free)} (score {rival.score:.3f}); they differ by "
            f"{gap:.1f} standard errors (limit {_LEAST_GAP_SIGMAS}): storeys or windows repeat. Give one control point "
            "on the ground, or photographs with RTK, or that show the building's ends and its roof"
        )
    shift, sigma = _consensus(search, best.shift, tolerance_m)
    return ShiftFound(
        shift_site_m=shift @ free,
        sigma_m=sigma,
        score=best.score,
        competing_score=rival.score,
        competing_shift_site_m=rival.shift @ free,
        gap_sigmas=gap,
        features=features,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Peak:
    """A shift (j,) that may be the answer, and each feature's best evidence near it and root weight (features,)."""

    shift: Array
    score: float
    evidence: Array
    weight: Array


def _refined(search: _Search, peaks: Array, coarser_m: float, finer_m: float) -> list[_Peak]:
    """The peaks moved to their best place at the finer level, best first; each sees what is visible there."""
    around = _grid(np.full(len(search.free), coarser_m), finer_m / 2).reshape(-1, len(search.free))
    shifts = (peaks[:, None, :] + around[None]).reshape(-1, len(search.free))
    scores = _scores(search, shifts, np.repeat(np.arange(len(peaks)), len(around)), finer_m)
    shape = (len(peaks), len(around), search.features)
    total, mean = scores.total.reshape(shape[:2]), scores.mean.reshape(shape)
    root = np.sqrt(scores.weight).reshape(shape).mean(axis=1)
    best = total.argmax(axis=1)
    found = [
        _Peak(
            shift=peaks[k] + around[best[k]],
            score=float(total[k, best[k]]),
            evidence=mean[k].max(axis=0),
            weight=root[k],
        )
        for k in range(len(peaks))
    ]
    return sorted(found, key=lambda peak: -peak.score)


def _closest_rival(rivals: list[_Peak]) -> tuple[_Peak, float]:
    """The other answer that the best beats by the fewest standard errors, and by how many.

    Each feature is a witness: what they say of the difference has a mean and, from their scatter, a standard error.
    """
    best, closest, least = rivals[0], rivals[0], np.inf
    for other in rivals[1:]:
        if np.linalg.norm(other.shift - best.shift) < _APART_M:
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


def _consensus(search: _Search, start: Array, tolerance_m: float) -> tuple[Array, float]:
    """The shift (j,) that most features agree on, and its standard error (m).

    Each feature has its own idea of the shift, with several candidates where profiles run side by side. The likeliest
    shift is taken, where every feature is off by its own normal deviation, the building's tolerance, and a share of
    them is mistaken. The error is the scatter under resampling of the features.
    """
    grid = _grid(np.full(len(search.free), _CONSENSUS_M), _CONSENSUS_STEP_M)
    shifts = start + grid.reshape(-1, len(search.free))
    scores = _scores(search, shifts, np.zeros(len(shifts), dtype=np.int64), _FINEST_M)
    seen = np.median(scores.weight, axis=0) > 0
    curve = scores.mean[:, seen].T ** 2 + _NO_EVIDENCE**2  # a feature that nothing shows says nothing
    curve /= curve.sum(axis=1, keepdims=True)
    trust = np.median(scores.weight[:, seen], axis=0)
    trust = trust / (trust + _TRUSTED_SAMPLES)
    blur = (0.0, *[float(np.hypot(tolerance_m, _PROFILE_M)) / _CONSENSUS_STEP_M] * len(search.free))
    likely = gaussian_filter(curve.reshape(-1, *grid.shape[:-1]), blur, mode="nearest").reshape(curve.shape)
    ballots = np.log((1 - _MISTAKEN) * likely + _MISTAKEN / curve.shape[1])
    draws = np.random.default_rng(1).multinomial(len(trust), np.full(len(trust), 1 / len(trust)), size=_BOOTSTRAPS)
    total = (np.vstack([np.ones(len(trust)), draws]) * trust) @ ballots
    places = shifts[total.argmax(axis=1)]
    spread = np.sqrt(((places[1:] - places[0]) ** 2).mean(axis=0).max() + _CONSENSUS_STEP_M**2 / 12)
    return places[0], float(spread)


def _words(shift_site_m: Array) -> str:
    east, north, up = shift_site_m
    return f"{east:+.2f} m east, {north:+.2f} m north, {up:+.2f} m up"


def _grid(reach_m: Array, step_m: float) -> Array:
    """Shifts (..., j) on a grid within ``reach_m`` (j,) of none, none among them."""
    counts = [max(1, int(np.ceil(limit / step_m))) for limit in reach_m]
    axes = [np.arange(-count, count + 1) * step_m for count in counts]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def _spread(cameras: Sequence[PosedCamera], most: int) -> NDArray[np.int64]:
    """Rows of at most ``most`` photographs, in even steps through the block."""
    count = min(len(cameras), most)
    return np.unique(np.linspace(0, len(cameras) - 1, count).round().astype(np.int64))


def _ever_seen(search: _Search, edges: ModelEdges, shifts: Array, node: NDArray[np.int64]) -> NDArray[np.bool_]:
    """The edges that a sparse look, from every node, finds visible: most of a building is inside."""
    sparse = sample_edges(edges, _SPARSE_M)
    seen = np.zeros(len(edges.feature), dtype=bool)
    for k in range(node.max() + 1):
        centre = shifts[node == k].mean(axis=0) @ search.free
        for row in search.rows:
            found = seen_samples(
                sparse, _moved(search.cameras[row], centre), search.surface, border_px=0.0, free=search.free
            )
            seen[sparse.edge[found.row]] = True
    return seen


def _peaks(total: Array, grid: Array, step_m: float) -> Array:
    """The best local maxima (k, j), best first, each the highest within ``_APART_M``."""
    highest = total == maximum_filter(total, size=2 * round(_APART_M / step_m) + 1, mode="nearest")
    at = np.flatnonzero(highest)
    order = at[np.argsort(-total.ravel()[at])][:_RIVALS]
    return grid.reshape(-1, grid.shape[-1])[order]


def _scores(search: _Search, shifts: Array, node: NDArray[np.int64], tolerance_m: float) -> _Scores:
    """Evidence for ``shifts`` (s, j); what is visible is asked once for those of one ``node`` (s,)."""
    evidence, weight = np.zeros((len(shifts), search.features)), np.zeros((len(shifts), search.features))
    nodes = [np.flatnonzero(node == k) for k in range(node.max() + 1)]
    for row in search.rows:
        level: Gradients | None = None
        for members in nodes:
            centre = shifts[members].mean(axis=0)
            posed = _moved(search.cameras[row], centre @ search.free)
            seen = seen_samples(search.samples, posed, search.surface, border_px=4.0, free=search.free)
            if len(seen.row) < _LEAST_SAMPLES:
                continue
            if level is None:
                level = _level(search, int(row), float(np.median(seen.pixel_m)), tolerance_m)
            for batch in _batches(members):
                _add(search, posed, seen, level, shifts[batch] - centre, evidence, weight, batch)
    usual = float(np.median(np.sqrt(weight).sum(axis=1)))
    return _Scores(evidence=evidence, weight=weight, usual_weight=usual)


def _batches(members: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    for begin in range(0, len(members), _BATCH):
        yield members[begin : begin + _BATCH]


def _level(search: _Search, row: int, pixel_m: float, tolerance_m: float) -> Gradients:
    """Gradients blurred by half of ``tolerance_m`` on the building."""
    sigma = tolerance_m / 2 / pixel_m
    reduction = reduction_for(sigma, search.cameras[row].camera)
    return gradients(search.photographs.grey(row, reduction), reduction=reduction, sigma_px=max(sigma / reduction, 0.7))


def _add(
    search: _Search,
    posed: PosedCamera,
    seen: SeenSamples,
    level: Gradients,
    shifts: Array,
    evidence: Array,
    weight: Array,
    rows: NDArray[np.int64],
) -> None:
    """Add one photograph's evidence for ``shifts`` (b, j), from where ``posed`` stands, to their ``rows``.

    Along one edge in one photograph the contrast has one sign, which texture has not: the mean comes before the square.
    """
    xyz = search.samples.xyz_site_m[seen.row]
    moved = (xyz[None] - (shifts @ search.free)[:, None, :]).reshape(-1, 3)
    xy = posed.project_site(moved).reshape(len(shifts), -1, 2)
    inside = posed.camera.contains(xy.reshape(-1, 2)).reshape(xy.shape[:2])
    across = level.across(np.nan_to_num(xy, nan=-1e4), np.broadcast_to(seen.normal_img, xy.shape))
    edge = search.samples.edge[seen.row]  # in rising order, as the samples are
    first = np.flatnonzero(np.r_[True, edge[1:] != edge[:-1]])
    count = np.add.reduceat(inside, first, axis=1, dtype=np.float64)
    total = np.add.reduceat(across * inside, first, axis=1, dtype=np.float64)
    count[count < _LEAST_SAMPLES] = 0.0
    mean = np.divide(total, count, out=np.zeros_like(total), where=count > 0)
    feature = search.samples.feature[seen.row[first]]
    for k, row in enumerate(rows):
        evidence[row] += np.bincount(feature, count[k] * mean[k] ** 2, search.features)
        weight[row] += np.bincount(feature, count[k], search.features)


def _moved(posed: PosedCamera, shift_site_m: Array) -> PosedCamera:
    site_from_cam = posed.site_from_cam
    return PosedCamera(
        camera=posed.camera,
        site_from_cam=Similarity(rotation=site_from_cam.rotation, translation=site_from_cam.translation + shift_site_m),
    )
