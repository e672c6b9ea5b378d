"""A photograph brought to a detector's input size, and boxes brought back, exactly.

Both sides measure from the corner of the first pixel, so that an image ``w`` wide resized to ``r`` maps x to
``x * r / w``: the gain is taken from the rounded sizes, for each axis, not from the ratio that was rounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from facadelake.detect.card import CardInput, Resize
from facadelake.frames import Array

Image = NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True)
class Letterbox:
    """Where a photograph lies in the model's input: ``x_input = x_img * gain_x + left_px``, y alike."""

    spec: CardInput
    image_width_px: int
    image_height_px: int
    resized_width_px: int
    resized_height_px: int
    left_px: int
    top_px: int

    def input_from_image(self, image_bgr: Image) -> NDArray[np.float32]:
        """The model's input (1, 3, height, width) of a photograph (h, w, 3: blue, green, red; 0..255)."""
        spec = self.spec
        # Averaging over the area keeps thin bright or dark lines that plain sampling would skip; it cannot enlarge.
        shrunk = (min(self.resized_width_px, self.image_width_px), min(self.resized_height_px, self.image_height_px))
        resized = cv2.resize(image_bgr, shrunk, interpolation=cv2.INTER_AREA)
        resized = cv2.resize(resized, (self.resized_width_px, self.resized_height_px), interpolation=cv2.INTER_LINEAR)
        canvas = np.full((spec.height_px, spec.width_px, 3), spec.pad_value, dtype=np.uint8)
        rows = slice(self.top_px, self.top_px + self.resized_height_px)
        canvas[rows, self.left_px : self.left_px + self.resized_width_px] = resized
        ordered = canvas if spec.colour == "bgr" else canvas[:, :, ::-1]
        values = (ordered.astype(np.float32) * spec.scale - np.array(spec.mean)) / np.array(spec.std)
        return np.ascontiguousarray(values.transpose(2, 0, 1)[None], dtype=np.float32)

    def image_from_input(self, corners_input: Array) -> Array:
        """Corners (n, 4: left, top, right, bottom) in pixels of the input as pixels of the photograph."""
        gain = np.array(
            [self.resized_width_px / self.image_width_px, self.resized_height_px / self.image_height_px] * 2
        )
        offset = np.array([self.left_px, self.top_px] * 2, dtype=np.float64)
        image: Array = (np.asarray(corners_input, dtype=np.float64).reshape(-1, 4) - offset) / gain
        return image


def letterbox(spec: CardInput, *, image_width_px: int, image_height_px: int) -> Letterbox:
    """How a photograph of the given size goes into the input that ``spec`` describes."""
    width, height = spec.width_px, spec.height_px
    if spec.resize is not Resize.STRETCH:
        gain = min(width / image_width_px, height / image_height_px)
        width = min(width, max(1, round(image_width_px * gain)))
        height = min(height, max(1, round(image_height_px * gain)))
    centred = spec.resize is Resize.CENTRE
    return Letterbox(
        spec=spec,
        image_width_px=image_width_px,
        image_height_px=image_height_px,
        resized_width_px=width,
        resized_height_px=height,
        left_px=(spec.width_px - width) // 2 if centred else 0,
        top_px=(spec.height_px - height) // 2 if centred else 0,
    )
