"""A picture as the trainer takes it: small, with the way of every crack; and how it is laid on the network's input."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from training.crackpath import CrackPath, crack_path
from training.data.sample import CLASSES, Sample

MAX_SIDE_PX = 640
PAD_VALUE = 114
MIN_SIDE_PX = 14.0  # what is left of a defect after a cut counts from this length on
MIN_AREA_SHARE = 0.3  # and, where it is an area, from this share on
_CRACK = 0  # index in CLASSES


@dataclass(frozen=True, kw_only=True)
class View:
    """A picture of at most MAX_SIDE_PX, its boxes (n, 4 corners, px) and class indices; ``paths`` None for areas."""

    image: NDArray[np.uint8]
    boxes_px: NDArray[np.float64]
    classes: NDArray[np.int64]
    paths: tuple[CrackPath | None, ...]


@dataclass(frozen=True, kw_only=True)
class Placing:
    """How a picture is laid on an input: ``input_from_image`` (2, 3) takes pixels of the picture to the input's."""

    input_from_image: NDArray[np.float64]
    width_px: int
    height_px: int

    @property
    def gain(self) -> float:
        """Pixels of the input per pixel of the picture (root of the area's gain)."""
        return float(np.sqrt(abs(np.linalg.det(self.input_from_image[:, :2]))))

    @property
    def upright(self) -> bool:
        """Whether boxes stay boxes: no turn but by right angles."""
        small = np.sort(np.abs(self.input_from_image[:, :2]), axis=1)[:, 0]
        return bool((small < 1e-6).all())


def view_of(sample: Sample) -> View:
    """Read, shrink and find the ways of the cracks."""
    assert CLASSES[_CRACK] == "crack"
    image = sample.read()
    gain = min(1.0, MAX_SIDE_PX / max(image.shape[:2]))
    if gain < 1.0:
        image = np.asarray(cv2.resize(image, None, fx=gain, fy=gain, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    boxes = sample.boxes_px * gain
    paths = tuple(
        crack_path(image, box) if kind == _CRACK else None for box, kind in zip(boxes, sample.classes, strict=True)
    )
    return View(image=image, boxes_px=boxes, classes=sample.classes, paths=paths)


def lay_image(image: NDArray[np.uint8], placing: Placing) -> NDArray[np.uint8]:
    """The input that the placing makes of a picture, padded with PAD_VALUE.

    Halved as often as possible and sampled from there: ten times faster than averaging over areas, and the trainer
    needs no exact picture.
    """
    matrix, gain = placing.input_from_image.copy(), placing.gain
    while gain <= 0.55:
        half = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        matrix[:, 0] *= image.shape[1] / half.shape[1]
        matrix[:, 1] *= image.shape[0] / half.shape[0]
        image, gain = np.asarray(half, dtype=np.uint8), gain * 2
    # OpenCV counts pixels from their centres, we from their corners.
    matrix[:, 2] += 0.5 * (matrix[:, 0] + matrix[:, 1]) - 0.5
    laid = cv2.warpAffine(
        image, matrix, (placing.width_px, placing.height_px), flags=cv2.INTER_LINEAR, borderValue=(PAD_VALUE,) * 3
    )
    return np.asarray(laid, dtype=np.uint8)


def lay_boxes(view: View, placing: Placing) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Boxes and classes of what can be seen of the view's defects on the input.

    A crack that is cut or turned gets the box of what is left of its way, drawn as loosely as the first one was.
    """
    boxes, classes = [], []
    for box, kind, path in zip(view.boxes_px, view.classes, view.paths, strict=True):
        whole = _moved_box(box, placing)
        seen = _cut(whole, placing)
        if path is not None and (not placing.upright or not np.allclose(seen, whole, rtol=0, atol=1.0)):
            left = _box_of_path(path, placing)
            if left is None:
                continue
            seen = (
                _cut(left, placing)
                if not placing.upright
                else np.concatenate([np.maximum(seen[:2], left[:2]), np.minimum(seen[2:], left[2:])])
            )
        elif path is None and _area(seen) < MIN_AREA_SHARE * _area(whole):
            continue
        if (seen[2:] - seen[:2]).max() >= MIN_SIDE_PX and (seen[2:] - seen[:2]).min() >= 2:
            boxes.append(seen)
            classes.append(kind)
    return np.array(boxes, dtype=np.float64).reshape(-1, 4), np.array(classes, dtype=np.int64)


def _moved_box(box: NDArray[np.float64], placing: Placing) -> NDArray[np.float64]:
    corners = np.array([[box[0], box[1]], [box[2], box[1]], [box[2], box[3]], [box[0], box[3]]])
    moved = _moved(corners, placing)
    return np.concatenate([moved.min(axis=0), moved.max(axis=0)])


def _box_of_path(path: CrackPath, placing: Placing) -> NDArray[np.float64] | None:
    points = _moved(path.points_px.astype(np.float64), placing)
    size = np.array([placing.width_px, placing.height_px])
    points = points[((points >= 0) & (points <= size)).all(axis=1)]
    if len(points) < 2:
        return None
    low, high = points.min(axis=0), points.max(axis=0)
    if (high - low).max() < MIN_SIDE_PX:
        return None
    loose = np.array([path.margin_px[[0, 2]].mean(), path.margin_px[[1, 3]].mean()], dtype=np.float64)
    margin = np.abs(placing.input_from_image[:, :2]) @ loose
    return np.concatenate([low - margin, high + margin])


def _moved(points: NDArray[np.float64], placing: Placing) -> NDArray[np.float64]:
    moved: NDArray[np.float64] = points @ placing.input_from_image[:, :2].T + placing.input_from_image[:, 2]
    return moved


def _cut(box: NDArray[np.float64], placing: Placing) -> NDArray[np.float64]:
    size = np.array([placing.width_px, placing.height_px] * 2, dtype=np.float64)
    return np.clip(box, 0, size)


def _area(box: NDArray[np.float64]) -> float:
    return float(np.prod(np.clip(box[2:] - box[:2], 0, None)))
