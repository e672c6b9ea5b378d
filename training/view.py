"""Reduced pictures with the paths of their cracks, and their placement on the input of the network."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from facadelake.core.arrays import Float64Array, Float64Nx2, Float64Nx4, Int64Array, UInt8Image
from training.crackpath import CrackPath, trace_crack
from training.data.sample import CLASSES, Sample

SIDE_MAX_PX = 640
PAD_VALUE = 114
SIDE_MIN_PX = 14.0  # smallest longer side of a defect's part on the input
AREA_SHARE_MIN = 0.3  # smallest share of the box of an area (spalling, moisture) that lies on the input
_CRACK = 0  # index in CLASSES


@dataclass(frozen=True, kw_only=True)
class View:
    """A picture (h, w, 3) of at most SIDE_MAX_PX, with its defects.

    ``boxes_px``: (n, 4) x_min, y_min, x_max, y_max. ``classes``: (n,) class indices. ``paths``: of the n defects;
    None for defects other than cracks.
    """

    image: UInt8Image
    boxes_px: Float64Nx4
    classes: Int64Array
    paths: tuple[CrackPath | None, ...]


@dataclass(frozen=True, kw_only=True)
class Placement:
    """Placement of a picture on an input: ``input_from_image`` (2, 3) maps pixels of the picture to the input."""

    input_from_image: Float64Array
    width_px: int
    height_px: int

    @property
    def gain(self) -> float:
        """Pixels of the input per pixel of the picture (square root of the ratio of areas)."""
        return float(np.sqrt(abs(np.linalg.det(self.input_from_image[:, :2]))))

    @property
    def keeps_boxes(self) -> bool:
        """Whether boxes stay parallel to the axes: rotation by multiples of 90 degrees only."""
        small = np.sort(np.abs(self.input_from_image[:, :2]), axis=1)[:, 0]
        return bool((small < 1e-6).all())


def read_view(sample: Sample) -> View:
    """Read and reduce a picture, and trace its cracks."""
    assert CLASSES[_CRACK] == "crack"
    image = sample.read()
    gain = min(1.0, SIDE_MAX_PX / max(image.shape[:2]))
    if gain < 1.0:
        image = np.asarray(cv2.resize(image, None, fx=gain, fy=gain, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    boxes = sample.boxes_px * gain
    paths = tuple(
        trace_crack(image, box) if kind == _CRACK else None for box, kind in zip(boxes, sample.classes, strict=True)
    )
    return View(image=image, boxes_px=boxes, classes=sample.classes, paths=paths)


def place_image(image: UInt8Image, placement: Placement) -> UInt8Image:
    """Transform a picture (h, w, 3) to the input (height_px, width_px, 3), padded with PAD_VALUE.

    The picture is halved as often as possible and then sampled linearly: ten times faster than averages over areas, and
    exact enough for training.
    """
    matrix, gain = placement.input_from_image.copy(), placement.gain
    while gain <= 0.55:
        half = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        matrix[:, 0] *= image.shape[1] / half.shape[1]
        matrix[:, 1] *= image.shape[0] / half.shape[0]
        image, gain = np.asarray(half, dtype=np.uint8), gain * 2
    # In OpenCV the origin is the centre of the first pixel, here its outer corner.
    matrix[:, 2] += 0.5 * (matrix[:, 0] + matrix[:, 1]) - 0.5
    placed = cv2.warpAffine(
        image, matrix, (placement.width_px, placement.height_px), flags=cv2.INTER_LINEAR, borderValue=(PAD_VALUE,) * 3
    )
    return np.asarray(placed, dtype=np.uint8)


def place_boxes(view: View, placement: Placement) -> tuple[Float64Nx4, Int64Array]:
    """Boxes (m, 4) and classes (m,) of the parts of the view's defects that lie on the input.

    The box of a crack that is cut or rotated is that of the visible part of its path, with the margins of its
    first box.
    """
    boxes, classes = [], []
    for box, kind, path in zip(view.boxes_px, view.classes, view.paths, strict=True):
        transformed = _transform_box(box, placement)
        visible = _clip_box(transformed, placement)
        if path is not None and not (placement.keeps_boxes and np.allclose(visible, transformed, rtol=0, atol=1.0)):
            part = _compute_path_box(path, placement)
            if part is None:
                continue
            visible = (
                _clip_box(part, placement)
                if not placement.keeps_boxes
                else np.concatenate([np.maximum(visible[:2], part[:2]), np.minimum(visible[2:], part[2:])])
            )
        elif path is None and _compute_area(visible) < AREA_SHARE_MIN * _compute_area(transformed):
            continue
        if (visible[2:] - visible[:2]).max() >= SIDE_MIN_PX and (visible[2:] - visible[:2]).min() >= 2:
            boxes.append(visible)
            classes.append(kind)
    return np.array(boxes, dtype=np.float64).reshape(-1, 4), np.array(classes, dtype=np.int64)


def _transform_box(box: Float64Array, placement: Placement) -> Float64Array:
    """Box (4,) around the transformed box (4,)."""
    corners = np.array([[box[0], box[1]], [box[2], box[1]], [box[2], box[3]], [box[0], box[3]]])
    transformed = _transform_points(corners, placement)
    return np.concatenate([transformed.min(axis=0), transformed.max(axis=0)])


def _compute_path_box(path: CrackPath, placement: Placement) -> Float64Array | None:
    """Box (4,) of the part of a path on the input, with margins; None if the part is too short."""
    points = _transform_points(path.points_px.astype(np.float64), placement)
    size = np.array([placement.width_px, placement.height_px])
    points = points[((points >= 0) & (points <= size)).all(axis=1)]
    if len(points) < 2:
        return None
    low, high = points.min(axis=0), points.max(axis=0)
    if (high - low).max() < SIDE_MIN_PX:
        return None
    margins = np.array([path.margin_px[[0, 2]].mean(), path.margin_px[[1, 3]].mean()], dtype=np.float64)
    margin = np.abs(placement.input_from_image[:, :2]) @ margins
    return np.concatenate([low - margin, high + margin])


def _transform_points(points: Float64Nx2, placement: Placement) -> Float64Nx2:
    transformed: Float64Nx2 = points @ placement.input_from_image[:, :2].T + placement.input_from_image[:, 2]
    return transformed


def _clip_box(box: Float64Array, placement: Placement) -> Float64Array:
    size = np.array([placement.width_px, placement.height_px] * 2, dtype=np.float64)
    return np.clip(box, 0, size)


def _compute_area(box: Float64Array) -> float:
    return float(np.prod(np.clip(box[2:] - box[:2], 0, None)))
