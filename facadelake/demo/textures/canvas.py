"""The texture image of a chart: conversion of metres to texels, noise, spots and fills."""

from __future__ import annotations

import cv2
import numpy as np

from facadelake.core.arrays import Float32Array, UInt8Array
from facadelake.demo.building.charts import Chart

Colour = tuple[float, float, float]


class TextureCanvas:
    """The colour image of a chart: gamma-coded 0 to 255, float32, first row at the top (largest v)."""

    def __init__(self, chart: Chart, rng: np.random.Generator, colour: Colour) -> None:
        self.chart, self.rng = chart, rng
        rows, columns = chart.shape_px
        self.image: Float32Array = np.empty((rows, columns, 3), dtype=np.float32)
        self.image[:] = colour
        self.per_u, self.per_v = chart.compute_texels_per_m()

    def texel_from_uv(self, u_m: float, v_m: float) -> tuple[float, float]:
        """Column and row of a point; 0 is the outer edge of the first texel."""
        return u_m * self.per_u, self.image.shape[0] - v_m * self.per_v

    def find_region(self, u0: float, v0: float, u1: float, v1: float) -> tuple[slice, slice]:
        """Rows and columns of an upright rectangle, cut at the edge of the texture.

        Args:
            u0: left edge, metres.
            v0: lower edge, metres.
            u1: right edge, metres.
            v1: upper edge, metres.
        """
        (c0, r1), (c1, r0) = self.texel_from_uv(u0, v0), self.texel_from_uv(u1, v1)
        rows, columns = self.image.shape[:2]
        return slice(max(0, round(r0)), min(rows, round(r1))), slice(max(0, round(c0)), min(columns, round(c1)))

    def fill(self, u0: float, v0: float, u1: float, v1: float, colour: Colour) -> None:
        """Fill a rectangle with a colour.

        Args:
            u0: left edge, metres.
            v0: lower edge, metres.
            u1: right edge, metres.
            v1: upper edge, metres.
            colour: red, green, blue, 0 to 255.
        """
        self.image[self.find_region(u0, v0, u1, v1)] = colour

    def sample_noise(self, wavelength_m: float, region: tuple[slice, slice] | None = None) -> Float32Array:
        """Smooth noise of unit strength and the given wavelength, of the size of the texture or of a region of it."""
        rows, columns = self.image[region].shape[:2] if region else self.image.shape[:2]
        step = max(1.0, wavelength_m * self.per_u / 2)
        coarse = self.rng.standard_normal((int(rows / step) + 3, int(columns / step) + 3), dtype=np.float32)
        return np.asarray(cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_CUBIC), dtype=np.float32)

    def add(self, tone: Float32Array, region: tuple[slice, slice] | None = None) -> None:
        """Add a tone image to all three channels."""
        if region is None:
            self.image += tone[..., None]
        else:
            self.image[region] += tone[..., None]

    def blend(self, region: tuple[slice, slice], colour: Colour | Float32Array, alpha: Float32Array) -> None:
        """Blend a colour into a region, with a weight of 0 to 1 for each texel."""
        current = self.image[region]
        self.image[region] = current + alpha[..., None] * (np.asarray(colour, dtype=np.float32) - current)

    def add_speckles(self, per_m2: float, radius_m: tuple[float, float], strength: float) -> None:
        """Spots of random size and tone, sharp enough to be matched between photographs."""
        rows, columns = self.image.shape[:2]
        count = int(per_m2 * self.chart.size_m[0] * self.chart.size_m[1])
        tone = np.zeros((rows, columns), dtype=np.float32)
        centre = self.rng.uniform((0, 0), (columns, rows), (count, 2))
        radius = np.exp(self.rng.uniform(np.log(radius_m[0]), np.log(radius_m[1]), (count, 1))) * self.per_u
        axes = radius * self.rng.uniform(0.5, 1.5, (count, 2))
        angles, levels = self.rng.uniform(0, 180, count), self.rng.normal(scale=strength, size=count)
        axes_px = np.maximum(axes, 1).astype(int).tolist()
        for c, a, angle, value in zip(
            centre.astype(int).tolist(), axes_px, angles.tolist(), levels.tolist(), strict=True
        ):
            cv2.ellipse(tone, c, a, angle, 0, 360, value, -1)
        self.add(tone)

    def encode_uint8(self) -> UInt8Array:
        """The texture as 8 bit."""
        return np.clip(self.image, 0, 255).astype(np.uint8)
