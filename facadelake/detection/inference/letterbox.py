"""Resizing of a photograph to a detector's input, and the exact transform of boxes back to the photograph.

Coordinates are measured from the corner of the first pixel, so an image of width ``w`` resized to ``r`` maps x to
``x * r / w``. The gain of each axis is the ratio of the rounded sizes, not the ratio before rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from facadelake.core.arrays import Float32Array, Float32Nx4, Float64Nx2, Float64Nx4, UInt8Image
from facadelake.detection.card import CardInput, ResizeMode


@dataclass(frozen=True, kw_only=True)
class Letterbox:
    """Placement of a photograph in the model's input: ``x_input = x_img * gain_x + left_px``; y likewise."""

    spec: CardInput
    image_width_px: int
    image_height_px: int
    resized_width_px: int
    resized_height_px: int
    left_px: int
    top_px: int

    def input_from_image(self, image_bgr: UInt8Image) -> Float32Array:
        """The model's input (1, 3, height, width) from a photograph (h, w, 3: blue, green, red; 0..255)."""
        values = np.empty((1, 3, self.spec.height_px, self.spec.width_px), dtype=np.float32)
        self.write_input(image_bgr, values[0])
        return values

    def write_input(self, image_bgr: UInt8Image, planes: Float32Array) -> None:
        """Write the model's input from a photograph to ``planes`` (3, height, width), one image of a batch."""
        spec = self.spec
        channels = cv2.split(self._resize_and_pad(image_bgr))
        ordered = channels if spec.colour == "bgr" else channels[::-1]
        for plane, channel, mean, std in zip(planes, ordered, spec.mean, spec.std, strict=True):
            np.multiply(channel, np.float32(spec.scale / std), out=plane)
            if mean:
                plane -= np.float32(mean / std)

    def image_from_input(self, corners_input: Float64Nx4 | Float32Nx4) -> Float64Nx4:
        """Corners (n, 4: left, top, right, bottom), from pixels of the input to pixels of the photograph."""
        return self.points_from_input(corners_input.reshape(-1, 2)).reshape(-1, 4)

    def points_from_input(self, points_input: Float64Nx2 | Float32Array) -> Float64Nx2:
        """Points (n, 2: x, y), from pixels of the input to pixels of the photograph."""
        gain = np.array([self.resized_width_px / self.image_width_px, self.resized_height_px / self.image_height_px])
        points: Float64Nx2 = (np.asarray(points_input, dtype=np.float64) - (self.left_px, self.top_px)) / gain
        return points

    def _resize_and_pad(self, image_bgr: UInt8Image) -> UInt8Image:
        """The photograph at its size in the input, with padding."""
        spec, resized = self.spec, image_bgr
        # Area averaging keeps thin lines that point sampling would miss; it applies to reduction only.
        shrunk = (min(self.resized_width_px, self.image_width_px), min(self.resized_height_px, self.image_height_px))
        if shrunk != (self.image_width_px, self.image_height_px):
            resized = np.asarray(cv2.resize(resized, shrunk, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        if shrunk != (self.resized_width_px, self.resized_height_px):
            size = (self.resized_width_px, self.resized_height_px)
            resized = np.asarray(cv2.resize(resized, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
        if resized.shape[:2] == (spec.height_px, spec.width_px):
            return resized
        canvas = np.full((spec.height_px, spec.width_px, 3), spec.pad_value, dtype=np.uint8)
        rows = slice(self.top_px, self.top_px + self.resized_height_px)
        canvas[rows, self.left_px : self.left_px + self.resized_width_px] = resized
        return canvas


def fit_letterbox(spec: CardInput, *, image_width_px: int, image_height_px: int) -> Letterbox:
    """The letterbox of a photograph of the given size for the input ``spec``."""
    width, height = spec.width_px, spec.height_px
    if spec.resize is not ResizeMode.STRETCH:
        gain = min(width / image_width_px, height / image_height_px)
        width = min(width, max(1, round(image_width_px * gain)))
        height = min(height, max(1, round(image_height_px * gain)))
    centred = spec.resize is ResizeMode.CENTRE
    return Letterbox(
        spec=spec,
        image_width_px=image_width_px,
        image_height_px=image_height_px,
        resized_width_px=width,
        resized_height_px=height,
        left_px=(spec.width_px - width) // 2 if centred else 0,
        top_px=(spec.height_px - height) // 2 if centred else 0,
    )
