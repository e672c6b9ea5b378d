"""How well shifted cameras meet the model's edges: gradients across the visible edges, feature by feature."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.building.surface import Surface
from facadelake.core.arrays import Float64Array, Int64Array
from facadelake.core.camera import PosedCamera
from facadelake.core.frames import Similarity
from facadelake.georeferencing.model.edge_samples import EdgeSamples, VisibleEdgeSamples, find_visible_samples
from facadelake.georeferencing.model.gradients import (
    GreyPhotographs,
    ImageGradients,
    choose_reduction,
    compute_gradients,
)

_MIN_SAMPLES = 3  # of an edge in a photograph
_BATCH = 64


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeScene:
    """What is scored: photograph k was taken by ``cameras[k]``; ``rows`` are used; shifts run along ``free_directions`` (j, 3);
    ``features`` counts the model's."""

    cameras: Sequence[PosedCamera]
    photographs: GreyPhotographs
    rows: Int64Array
    samples: EdgeSamples
    surface: Surface
    free_directions: Float64Array
    features: int


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeScores:
    """Evidence (shifts, features) and its weight, in samples; ``usual_weight`` is what a shift is expected to see."""

    evidence: Float64Array
    weight: Float64Array
    usual_weight: float

    @property
    def mean(self) -> Float64Array:
        """Mean evidence (shifts, features), 0 to 1; 0 where nothing is seen."""
        return np.divide(self.evidence, self.weight, out=np.zeros_like(self.evidence), where=self.weight > 0)

    @property
    def total(self) -> Float64Array:
        """Score of each shift: mean evidence of the features, each counted by the root of what is seen of it."""
        root = np.sqrt(self.weight)
        # A shift that leaves little in sight (cameras under the ground) is not to win by a few chance hits.
        total: Float64Array = (root * self.mean).sum(axis=1) / np.maximum(
            root.sum(axis=1), max(self.usual_weight, 1e-12)
        )
        return total


def score_shifts(search: EdgeScene, shifts: Float64Array, node: Int64Array, tolerance_m: float) -> EdgeScores:
    """Evidence for ``shifts`` (s, j); what is visible is asked once for those of one ``node`` (s,)."""
    evidence, weight = np.zeros((len(shifts), search.features)), np.zeros((len(shifts), search.features))
    nodes = [np.flatnonzero(node == k) for k in range(node.max() + 1)]
    for row in search.rows:
        level: ImageGradients | None = None
        for members in nodes:
            centre = shifts[members].mean(axis=0)
            posed = shift_camera(search.cameras[row], centre @ search.free_directions)
            seen = find_visible_samples(
                search.samples, posed, search.surface, border_px=4.0, free_directions=search.free_directions
            )
            if len(seen.row) < _MIN_SAMPLES:
                continue
            if level is None:
                level = _compute_gradients(search, int(row), float(np.median(seen.pixel_m)), tolerance_m)
            for batch in _split_into_batches(members):
                _add_evidence(search, posed, seen, level, shifts[batch] - centre, evidence, weight, batch)
    usual = float(np.median(np.sqrt(weight).sum(axis=1)))
    return EdgeScores(evidence=evidence, weight=weight, usual_weight=usual)


def _split_into_batches(members: Int64Array) -> Iterator[Int64Array]:
    for begin in range(0, len(members), _BATCH):
        yield members[begin : begin + _BATCH]


def _compute_gradients(search: EdgeScene, row: int, pixel_m: float, tolerance_m: float) -> ImageGradients:
    """Gradients blurred by half of ``tolerance_m`` on the building."""
    sigma = tolerance_m / 2 / pixel_m
    reduction = choose_reduction(sigma, search.cameras[row].camera)
    return compute_gradients(
        search.photographs.read_grey(row, reduction), reduction=reduction, sigma_px=max(sigma / reduction, 0.7)
    )


def _add_evidence(
    search: EdgeScene,
    posed: PosedCamera,
    seen: VisibleEdgeSamples,
    level: ImageGradients,
    shifts: Float64Array,
    evidence: Float64Array,
    weight: Float64Array,
    rows: Int64Array,
) -> None:
    """Add one photograph's evidence for ``shifts`` (b, j), from where ``posed`` stands, to their ``rows``.

    Along one edge in one photograph the contrast has one sign, which texture has not: the mean comes before the square.
    """
    xyz = search.samples.xyz_site_m[seen.row]
    moved = (xyz[None] - (shifts @ search.free_directions)[:, None, :]).reshape(-1, 3)
    xy = posed.project_site(moved).reshape(len(shifts), -1, 2)
    inside = posed.camera.is_inside(xy.reshape(-1, 2)).reshape(xy.shape[:2])
    across = level.sample_across(np.nan_to_num(xy, nan=-1e4), np.broadcast_to(seen.normal_img, xy.shape))
    edge = search.samples.edge[seen.row]  # in rising order, as the samples are
    first = np.flatnonzero(np.r_[True, edge[1:] != edge[:-1]])
    count = np.add.reduceat(inside, first, axis=1, dtype=np.float64)
    total = np.add.reduceat(across * inside, first, axis=1, dtype=np.float64)
    count[count < _MIN_SAMPLES] = 0.0
    mean = np.divide(total, count, out=np.zeros_like(total), where=count > 0)
    feature = search.samples.feature[seen.row[first]]
    for k, row in enumerate(rows):
        evidence[row] += np.bincount(feature, count[k] * mean[k] ** 2, search.features)
        weight[row] += np.bincount(feature, count[k], search.features)


def shift_camera(posed: PosedCamera, shift_site_m: Float64Array) -> PosedCamera:
    site_from_cam = posed.site_from_cam
    return PosedCamera(
        camera=posed.camera,
        site_from_cam=Similarity(rotation=site_from_cam.rotation, translation=site_from_cam.translation + shift_site_m),
    )
