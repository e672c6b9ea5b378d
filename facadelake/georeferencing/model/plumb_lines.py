"""Plumb lines: jambs, corners and pilasters in the photographs determine the vertical without the model.

A line in a photograph spans a plane with the camera's centre; the planes of plumb lines all contain the vertical. The
vertical is the direction nearest to all planes (the vertical vanishing point, over all photographs at once). Segments
by OpenCV's line segment detector (von Gioi et al. 2012, LSD, IPOL).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from facadelake.core.arrays import Float64Array, Float64N, Float64Nx3, Float64x3, Float64x3x3
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.progress import track
from facadelake.georeferencing.model.gradients import GreyPhotographs, choose_reduction

logger = logging.getLogger(__name__)

_MAX_PHOTOGRAPHS = 60  # the vertical has two parameters: more photographs cost time without a gain
_MAX_IMAGE_PX = 3200.0
_MIN_LENGTH_RAD = 0.02
_GATE_DEG = 1.5  # largest lean of the initial vertical, and of a plumb line with it
_LOSS_SCALE_DEG = 0.3
_MAX_STEEPNESS_COSINE = 0.87  # within 30 degrees of the vertical vanishing point the direction of a line is unreliable
_MIN_LINES = 20
_MIN_PHOTOGRAPHS = 4
_ITERATIONS = 10
# Plumb lines of one building lean together: DIN 18202 allows a wall at most 16 mm over 6 m (0.15 deg).
BUILT_SIGMA_RAD = float(np.radians(0.1))


@dataclass(frozen=True, kw_only=True, eq=False)
class VerticalDirection:
    """The vertical by plumb lines: unit vector ``up_site`` (3,), with ``sigma_rad`` about each level axis."""

    up_site: Float64x3
    sigma_rad: float
    lines: int
    photographs: int


def estimate_vertical(cameras: Sequence[PosedCamera], photographs: GreyPhotographs) -> VerticalDirection | None:
    """The vertical by plumb lines; None where fewer than four photographs show twenty of them each.

    ``cameras`` are in site, level to about a degree; photographs that cannot be decoded are skipped. ``sigma_rad``
    contains the scatter over photographs (a jackknife) and ``BUILT_SIGMA_RAD``.
    """
    chosen = np.unique(np.linspace(0, len(cameras) - 1, min(len(cameras), _MAX_PHOTOGRAPHS)).round().astype(int))
    planes, lengths = [], []
    for row in track(chosen.tolist(), label="Detecting plumb lines", total=len(chosen)):
        try:
            normal, length = _select_vertical_planes(cameras[row], _detect_segments(photographs, row, cameras[row]))
        except InputDataError as error:
            logger.warning("no plumb lines: %s", error)
            continue
        if len(normal) >= _MIN_LINES:
            planes.append(normal)
            lengths.append(length)
    if len(planes) < _MIN_PHOTOGRAPHS:
        return None
    up = np.array([0.0, 0.0, 1.0])
    for _ in range(_ITERATIONS):
        moments = np.array(
            [_compute_moment(normal, length, up) for normal, length in zip(planes, lengths, strict=True)]
        )
        up = _find_vertical(moments.sum(axis=0))
    without = np.array([_find_vertical(moments.sum(axis=0) - moment)[:2] for moment in moments])
    n = len(without)
    scatter = float(np.sqrt((n - 1) / n * ((without - without.mean(axis=0)) ** 2).sum(axis=0).max()))
    lines = sum(int((np.abs(normal @ up) < np.sin(np.radians(_GATE_DEG))).sum()) for normal in planes)
    return VerticalDirection(
        up_site=up, sigma_rad=float(np.hypot(scatter, BUILT_SIGMA_RAD)), lines=lines, photographs=n
    )


def _detect_segments(photographs: GreyPhotographs, row: int, posed: PosedCamera) -> Float64Array:
    """Line segments (k, 4: x, y, x, y) in pixels of the photograph."""
    camera = posed.camera
    reduction = choose_reduction(max(camera.width_px, camera.height_px) / _MAX_IMAGE_PX, camera)
    detected = cv2.createLineSegmentDetector().detect(photographs.read_grey(row, reduction))[0]
    # OpenCV returns None, against its own types, where there is no segment.
    segments = np.zeros((0, 4)) if detected is None else np.asarray(detected, dtype=np.float64).reshape(-1, 4)
    return (segments + 0.5) * reduction


def _select_vertical_planes(posed: PosedCamera, segments: Float64Array) -> tuple[Float64Nx3, Float64N]:
    """Unit normals (k, 3) in site of the planes of nearly vertical segments, and their lengths (k,) in radians."""
    first, second = posed.rays_site_from_img(segments[:, :2])[1], posed.rays_site_from_img(segments[:, 2:])[1]
    cross = np.cross(first, second)
    length = np.linalg.norm(cross, axis=1)
    bisector = first + second
    steepness = np.abs(bisector[:, 2]) / np.linalg.norm(bisector, axis=1)
    normal = cross / np.maximum(length, 1e-12)[:, None]
    vertical = np.abs(normal[:, 2]) < 2 * np.sin(np.radians(_GATE_DEG))
    selected = (length > _MIN_LENGTH_RAD) & (steepness < _MAX_STEEPNESS_COSINE) & vertical
    return normal[selected], length[selected]


def _compute_moment(normal: Float64Nx3, length: Float64N, up: Float64x3) -> Float64x3x3:
    """Moment (3, 3) of the normals of planes that nearly contain ``up``, weighted by length and Cauchy's loss."""
    deviation = normal @ up
    inlier = np.abs(deviation) < np.sin(np.radians(_GATE_DEG))
    weight = length[inlier] / (1.0 + (deviation[inlier] / np.radians(_LOSS_SCALE_DEG)) ** 2)
    moment: Float64Array = (normal[inlier] * weight[:, None]).T @ normal[inlier]
    return moment


def _find_vertical(moment: Float64x3x3) -> Float64x3:
    """Unit eigenvector (3,) of the smallest eigenvalue, upwards."""
    smallest = np.linalg.eigh(moment)[1][:, 0]
    up: Float64Array = smallest * np.sign(smallest[2])
    return up
