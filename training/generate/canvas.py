"""What a generated picture is painted on: linear light, a light's direction, noise and a generator of chance."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float32]
"""(h, w) or (h, w, 3) of float32; colours are BGR in linear light, 0 to 1 (1 = white in the sun)."""

TILE_PX = 512
TILES = 4
SLOPE_STEP = 0.25  # a tile is kept for each
LUMA = np.array([0.114, 0.587, 0.299], dtype=np.float32)


@cache
def _noise_tile(slope: float, number: int) -> Field:
    """A periodic field of 1/f^slope noise, mean 0, standard deviation 1."""
    rng = np.random.default_rng((int(slope * 100), number))
    frequency = np.hypot(np.fft.fftfreq(TILE_PX)[:, None], np.fft.rfftfreq(TILE_PX)[None, :])
    frequency[0, 0] = 1.0
    spectrum = np.fft.rfft2(rng.standard_normal((TILE_PX, TILE_PX))) / frequency**slope
    spectrum[0, 0] = 0.0
    field = np.fft.irfft2(spectrum, s=(TILE_PX, TILE_PX))
    return np.asarray(np.tile(field / field.std(), (2, 2)), dtype=np.float32)


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where a patch goes: its visible part (y, x, height, width) in pixels of the picture.

    `window` (y0, y1, x0, x1) is what is visible of a patch that spans -1 to 1: less than all at the picture's border.
    """

    y: int
    x: int
    height: int
    width: int
    window: tuple[float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class Canvas:
    """One picture while it is painted; `image` (side, side, 3) is changed in place.

    `light` points from the surface to the lamp in the picture (unit, x right, y down). `free` is 1 where a wall is, 0
    where something stands before it (windows, sky): defects belong on walls.
    """

    image: Field
    free: Field
    rng: np.random.Generator
    light: NDArray[np.float64]

    @property
    def side_px(self) -> int:
        """Height and width of the picture."""
        return int(self.image.shape[0])

    def noise(self, height: int, width: int, *, slope: float, coarse: float = 1.0) -> Field:
        """(height, width) of 1/f^slope noise, mean about 0, deviation about 1; `coarse` > 1 stretches it."""
        tile = _noise_tile(round(slope / SLOPE_STEP) * SLOPE_STEP, int(self.rng.integers(TILES)))
        need_y, need_x = max(2, round(height / coarse)), max(2, round(width / coarse))
        if max(need_y, need_x) > TILE_PX:
            return self.noise(height, width, slope=slope, coarse=coarse * max(need_y, need_x) / TILE_PX * 1.01)
        y, x = (int(self.rng.integers(TILE_PX)) for _ in range(2))
        part = tile[y : y + need_y, x : x + need_x][:: self.rng.choice([-1, 1]), :: self.rng.choice([-1, 1])]
        if (need_y, need_x) != (height, width):
            resized = cv2.resize(np.ascontiguousarray(part), (width, height), interpolation=cv2.INTER_CUBIC)
            return np.asarray(resized, dtype=np.float32)
        return np.ascontiguousarray(part, dtype=np.float32)

    def multiply(self, factor: Field, y: int = 0, x: int = 0) -> None:
        """Darken (or lighten) the picture from (y, x) on; the surface's own texture stays."""
        height, width = factor.shape[:2]
        self.image[y : y + height, x : x + width] *= factor if factor.ndim == 3 else factor[..., None]

    def cover(self, colour: Field | NDArray[np.float64], alpha: Field, y: int = 0, x: int = 0) -> None:
        """Paint over the picture from (y, x) on; `alpha` (h, w) 0 to 1."""
        height, width = alpha.shape
        part = self.image[y : y + height, x : x + width]
        part += alpha[..., None] * (np.asarray(colour, dtype=np.float32) - part)

    def chance(self, probability: float) -> bool:
        """True with this probability."""
        return bool(self.rng.random() < probability)

    def between(self, low: float, high: float) -> float:
        """Uniform between the two."""
        return float(self.rng.uniform(low, high))


def soft(mask: NDArray[np.uint8] | Field, sigma_px: float) -> Field:
    """Blurred mask, 0 to 1."""
    field = mask.astype(np.float32) / (255 if mask.dtype == np.uint8 else 1)
    return np.asarray(cv2.GaussianBlur(field, (0, 0), sigma_px) if sigma_px > 0.2 else field, dtype=np.float32)


def step(field: Field, at: float, width: float) -> Field:
    """0 below, 1 above `at`, straight over `width`."""
    return np.asarray(np.clip((field - at) / width + 0.5, 0, 1), dtype=np.float32)


def to_linear(image: NDArray[np.uint8]) -> Field:
    """Stored BGR to linear light, with a gamma of 2: near enough to sRGB's, and fast."""
    field = image.astype(np.float32) * np.float32(1 / 255)
    return np.asarray(field * field, dtype=np.float32)


def to_stored(image: Field) -> NDArray[np.uint8]:
    """Linear light to 8 bit, the inverse of `to_linear`."""
    return np.asarray(np.sqrt(np.clip(image, 0, 1)) * 255 + 0.5, dtype=np.uint8)
