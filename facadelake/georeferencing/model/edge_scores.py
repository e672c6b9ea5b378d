"""Scores of shifted cameras against the model's edges: image gradients across the visible edges, by feature."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.building.surface import Surface
from facadelake.core.arrays import Float64Array, Float64N, Float64Nx3, Float64x3, Int64Array
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
_SHIFTS_PER_BATCH = 64


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeScene:
    """The input of the scores.

    Photograph k was taken by ``cameras[k]``; ``rows`` are the photographs used. Shifts run along ``free_directions``
    (j, 3). ``features``: number of features of the model.
    """

    cameras: Sequence[PosedCamera]
    photographs: GreyPhotographs
    rows: Int64Array
    samples: EdgeSamples
    surface: Surface
    free_directions: Float64Nx3
    features: int


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeScores:
    """Evidence (shifts, features) and its weight, in samples; ``usual_weight``: median of the shifts' root weights."""

    evidence: Float64Array
    weight: Float64Array
    usual_weight: float

    @property
    def mean(self) -> Float64Array:
        """Mean evidence (shifts, features), 0 to 1; 0 where nothing is visible."""
        return np.divide(self.evidence, self.weight, out=np.zeros_like(self.evidence), where=self.weight > 0)

    @property
    def total(self) -> Float64N:
        """Score of each shift: mean evidence of the features, each weighted by the root of its samples."""
        root = np.sqrt(self.weight)
        # A shift that leaves few edges visible (cameras under the ground) must not win by chance.
        total: Float64Array = (root * self.mean).sum(axis=1) / np.maximum(
            root.sum(axis=1), max(self.usual_weight, 1e-12)
        )
        return total


def score_shifts(scene: EdgeScene, shifts: Float64Array, group: Int64Array, tolerance_m: float) -> EdgeScores:
    """Score shifts of the cameras.

    Args:
        scene: cameras, photographs and edge samples.
        shifts: shifts (s, j) in metres along the free directions.
        group: group (s,) of each shift; visibility is determined once for a group, at its mean.
        tolerance_m: tolerance of the edges on the building; photographs are blurred by half of it.

    Returns:
        evidence and weight of every shift and feature.
    """
    evidence, weight = np.zeros((len(shifts), scene.features)), np.zeros((len(shifts), scene.features))
    groups = [np.flatnonzero(group == k) for k in range(group.max() + 1)]
    for row in scene.rows:
        gradients: ImageGradients | None = None
        for members in groups:
            centre = shifts[members].mean(axis=0)
            posed = shift_camera(scene.cameras[row], centre @ scene.free_directions)
            visible = find_visible_samples(
                scene.samples, posed, scene.surface, border_px=4.0, free_directions=scene.free_directions
            )
            if len(visible.row) < _MIN_SAMPLES:
                continue
            if gradients is None:
                gradients = _compute_gradients(scene, int(row), float(np.median(visible.pixel_m)), tolerance_m)
            for batch in _split_into_batches(members):
                _add_evidence(scene, posed, visible, gradients, shifts[batch] - centre, evidence, weight, batch)
    usual = float(np.median(np.sqrt(weight).sum(axis=1)))
    return EdgeScores(evidence=evidence, weight=weight, usual_weight=usual)


def _split_into_batches(members: Int64Array) -> Iterator[Int64Array]:
    for begin in range(0, len(members), _SHIFTS_PER_BATCH):
        yield members[begin : begin + _SHIFTS_PER_BATCH]


def _compute_gradients(scene: EdgeScene, row: int, pixel_m: float, tolerance_m: float) -> ImageGradients:
    """Gradients of a photograph blurred by half of ``tolerance_m`` on the building, where a pixel is ``pixel_m``."""
    sigma = tolerance_m / 2 / pixel_m
    reduction = choose_reduction(sigma, scene.cameras[row].camera)
    return compute_gradients(
        scene.photographs.read_grey(row, reduction), reduction=reduction, sigma_px=max(sigma / reduction, 0.7)
    )


def _add_evidence(
    scene: EdgeScene,
    posed: PosedCamera,
    visible: VisibleEdgeSamples,
    gradients: ImageGradients,
    shifts: Float64Array,
    evidence: Float64Array,
    weight: Float64Array,
    rows: Int64Array,
) -> None:
    """Add one photograph's evidence for ``shifts`` (b, j), relative to ``posed``, to their ``rows`` (b,) in place.

    Along one edge in one photograph the contrast has one sign, unlike texture: the mean is taken before the square.
    """
    xyz = scene.samples.xyz_site_m[visible.row]
    shifted = (xyz[None] - (shifts @ scene.free_directions)[:, None, :]).reshape(-1, 3)
    xy = posed.project_site(shifted).reshape(len(shifts), -1, 2)
    inside = posed.camera.is_inside(xy.reshape(-1, 2)).reshape(xy.shape[:2])
    across = gradients.sample_across(np.nan_to_num(xy, nan=-1e4), np.broadcast_to(visible.normal_img, xy.shape))
    edge = scene.samples.edge[visible.row]  # in rising order, as the samples are
    first = np.flatnonzero(np.r_[True, edge[1:] != edge[:-1]])
    count = np.add.reduceat(inside, first, axis=1, dtype=np.float64)
    total = np.add.reduceat(across * inside, first, axis=1, dtype=np.float64)
    count[count < _MIN_SAMPLES] = 0.0
    mean = np.divide(total, count, out=np.zeros_like(total), where=count > 0)
    feature = scene.samples.feature[visible.row[first]]
    for k, row in enumerate(rows):
        evidence[row] += np.bincount(feature, count[k] * mean[k] ** 2, scene.features)
        weight[row] += np.bincount(feature, count[k], scene.features)


def shift_camera(posed: PosedCamera, shift_site_m: Float64x3) -> PosedCamera:
    """The camera with its centre shifted by ``shift_site_m`` (3,)."""
    site_from_cam = posed.site_from_cam
    return PosedCamera(
        camera=posed.camera,
        site_from_cam=Similarity(rotation=site_from_cam.rotation, translation=site_from_cam.translation + shift_site_m),
    )
