"""Plumb lines: jambs, corners and pilasters in the photographs tell which way is up, whatever the model says.

A line in a photograph spans a plane with the camera's centre; the planes of upright lines all hold the vertical. So
the vertical is the direction that is most nearly in all planes (the vertical vanishing point, over all photographs at
once). Segments by OpenCV's line segment detector (von Gioi et al., LSD, IPOL 2012).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from facadelake.core.arrays import Float64Array
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.progress import track
from facadelake.georeferencing.model.gradients import GreyPhotographs, choose_reduction

logger = logging.getLogger(__name__)

_MAX_PHOTOGRAPHS = 60  # the vertical is two numbers: more photographs add time, not knowledge
_MAX_IMAGE_PX = 3200.0
_MIN_LENGTH_RAD = 0.02
_GATE_DEG = 1.5  # how far the start may lean, and an upright line with it
_LOSS_SCALE_DEG = 0.3
_MAX_STEEPNESS_COSINE = 0.87  # lines closer than 30 degrees to the vertical's own vanishing point point anywhere
_MIN_LINES = 20
_MIN_PHOTOGRAPHS = 4
_ITERATIONS = 10
# Uprights of one building lean together: 16 mm over 6 m is what DIN 18202 allows a wall at most (0.15 deg).
BUILT_SIGMA_RAD = float(np.radians(0.1))


@dataclass(frozen=True, kw_only=True, eq=False)
class VerticalDirection:
    """Which way is up as upright lines have it: ``up_site`` (3,), unit, good to ``sigma_rad`` about each level axis."""

    up_site: Float64Array
    sigma_rad: float
    lines: int
    photographs: int


def estimate_vertical(cameras: Sequence[PosedCamera], photographs: GreyPhotographs) -> VerticalDirection | None:
    """The vertical as the photographs show it; None where fewer than four show twenty upright lines each.

    ``cameras`` stand in site, level to about a degree; photographs that cannot be read are passed over. ``sigma_rad``
    holds the scatter over photographs (a jackknife) and ``BUILT_SIGMA_RAD``.
    """
    chosen = np.unique(np.linspace(0, len(cameras) - 1, min(len(cameras), _MAX_PHOTOGRAPHS)).round().astype(int))
    planes, lengths = [], []
    for row in track(chosen.tolist(), label="Looking for upright lines", total=len(chosen)):
        try:
            normal, length = _select_vertical_planes(cameras[row], _detect_segments(photographs, row, cameras[row]))
        except InputDataError as error:
            logger.warning("no upright lines from it: %s", error)
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
    found = cv2.createLineSegmentDetector().detect(photographs.read_grey(row, reduction))[0]
    # OpenCV gives None, against its own types, where there is no segment.
    segments = np.zeros((0, 4)) if found is None else np.asarray(found, dtype=np.float64).reshape(-1, 4)
    return (segments + 0.5) * reduction


def _select_vertical_planes(posed: PosedCamera, segments: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Unit normals (k, 3) in site of the planes of segments that may be upright, and their lengths (k,) in radians."""
    first, second = posed.rays_site_from_img(segments[:, :2])[1], posed.rays_site_from_img(segments[:, 2:])[1]
    cross = np.cross(first, second)
    length = np.linalg.norm(cross, axis=1)
    middle = first + second
    steep = np.abs(middle[:, 2]) / np.linalg.norm(middle, axis=1)
    normal = cross / np.maximum(length, 1e-12)[:, None]
    upright = np.abs(normal[:, 2]) < 2 * np.sin(np.radians(_GATE_DEG))
    good = (length > _MIN_LENGTH_RAD) & (steep < _MAX_STEEPNESS_COSINE) & upright
    return normal[good], length[good]


def _compute_moment(normal: Float64Array, length: Float64Array, up: Float64Array) -> Float64Array:
    """Weighted moment (3, 3) of the planes' normals that ``up`` nearly lies in; longer lines count more (Cauchy)."""
    off = normal @ up
    inside = np.abs(off) < np.sin(np.radians(_GATE_DEG))
    weight = length[inside] / (1.0 + (off[inside] / np.radians(_LOSS_SCALE_DEG)) ** 2)
    moment: Float64Array = (normal[inside] * weight[:, None]).T @ normal[inside]
    return moment


def _find_vertical(moment: Float64Array) -> Float64Array:
    lowest = np.linalg.eigh(moment)[1][:, 0]
    up: Float64Array = lowest * np.sign(lowest[2])
    return up
