"""Canvas of a generated picture: linear light, direction of the light, noise and the random generator."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from facadelake.core.arrays import Float32Array, Float64Array, UInt8Image

Field = Float32Array
"""(h, w) or (h, w, 3); colours are blue, green, red in linear light, 0 to 1 (1: white in sunlight)."""

TILE_PX = 512
TILES = 4
SLOPE_STEP = 0.25  # resolution of slopes, because noise is cached by slope
LUMA = np.array([0.114, 0.587, 0.299], dtype=np.float32)


@cache
def _generate_noise_tile(slope: float, number: int) -> Field:
    """Periodic field (2 * TILE_PX, 2 * TILE_PX) of 1/f^slope noise, mean 0, standard deviation 1."""
    rng = np.random.default_rng((int(slope * 100), number))
    frequency = np.hypot(np.fft.fftfreq(TILE_PX)[:, None], np.fft.rfftfreq(TILE_PX)[None, :])
    frequency[0, 0] = 1.0
    spectrum = np.fft.rfft2(rng.standard_normal((TILE_PX, TILE_PX))) / frequency**slope
    spectrum[0, 0] = 0.0
    field = np.fft.irfft2(spectrum, s=(TILE_PX, TILE_PX))
    return np.asarray(np.tile(field / field.std(), (2, 2)), dtype=np.float32)


@dataclass(frozen=True, kw_only=True)
class Place:
    """Location of a patch: its visible part (y, x, height, width) in pixels of the picture.

    `window` (y0, y1, x0, x1): the visible part in coordinates of the patch, which extends from -1 to 1 and may be cut
    by the border of the picture.
    """

    y: int
    x: int
    height: int
    width: int
    window: tuple[float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class Canvas:
    """A picture in linear light; `image` (side, side, 3) is changed in place.

    `free`: (side, side), 1 on walls, where defects may be, 0 elsewhere (windows, sky). `light`: unit vector (2,; x
    right, y down) from the surface to the light.
    """

    image: Field
    free: Field
    rng: np.random.Generator
    light: Float64Array

    @property
    def side_px(self) -> int:
        """Height and width of the picture."""
        return int(self.image.shape[0])

    def sample_noise(self, height: int, width: int, *, slope: float, coarse: float = 1.0) -> Field:
        """1/f^slope noise (height, width), mean about 0, standard deviation about 1; `coarse` > 1 enlarges it."""
        tile = _generate_noise_tile(round(slope / SLOPE_STEP) * SLOPE_STEP, int(self.rng.integers(TILES)))
        need_y, need_x = max(2, round(height / coarse)), max(2, round(width / coarse))
        if max(need_y, need_x) > TILE_PX:
            return self.sample_noise(height, width, slope=slope, coarse=coarse * max(need_y, need_x) / TILE_PX * 1.01)
        y, x = (int(self.rng.integers(TILE_PX)) for _ in range(2))
        part = tile[y : y + need_y, x : x + need_x][:: self.rng.choice([-1, 1]), :: self.rng.choice([-1, 1])]
        if (need_y, need_x) != (height, width):
            resized = cv2.resize(np.ascontiguousarray(part), (width, height), interpolation=cv2.INTER_CUBIC)
            return np.asarray(resized, dtype=np.float32)
        return np.ascontiguousarray(part, dtype=np.float32)

    def multiply(self, factor: Field, y: int = 0, x: int = 0) -> None:
        """Multiply the picture from (y, x) on by `factor` (h, w) or (h, w, 3); the texture of the surface remains."""
        height, width = factor.shape[:2]
        self.image[y : y + height, x : x + width] *= factor if factor.ndim == 3 else factor[..., None]

    def cover(self, colour: Field | Float64Array, alpha: Field, y: int = 0, x: int = 0) -> None:
        """Blend `colour` over the picture from (y, x) on; `alpha` (h, w), 0 to 1."""
        height, width = alpha.shape
        part = self.image[y : y + height, x : x + width]
        part += alpha[..., None] * (np.asarray(colour, dtype=np.float32) - part)

    def draw_bernoulli(self, probability: float) -> bool:
        """True with this probability."""
        return bool(self.rng.random() < probability)

    def draw_uniform(self, low: float, high: float) -> float:
        """Sample of the uniform distribution from `low` to `high`."""
        return float(self.rng.uniform(low, high))


def blur_mask(mask: UInt8Image | Field, sigma_px: float) -> Field:
    """Mask (h, w) blurred by a Gaussian, 0 to 1."""
    field = mask.astype(np.float32) / (255 if mask.dtype == np.uint8 else 1)
    return np.asarray(cv2.GaussianBlur(field, (0, 0), sigma_px) if sigma_px > 0.2 else field, dtype=np.float32)


def compute_ramp(field: Field, at: float, width: float) -> Field:
    """0 below and 1 above `at`, linear over `width`."""
    return np.asarray(np.clip((field - at) / width + 0.5, 0, 1), dtype=np.float32)


def linear_from_stored(image: UInt8Image) -> Field:
    """Linear light of 8 bit colours, with a gamma of 2: a fast approximation of sRGB."""
    field = image.astype(np.float32) * np.float32(1 / 255)
    return np.asarray(field * field, dtype=np.float32)


def stored_from_linear(image: Field) -> UInt8Image:
    """8 bit colours of linear light, the inverse of `linear_from_stored`."""
    return np.asarray(np.sqrt(np.clip(image, 0, 1)) * 255 + 0.5, dtype=np.uint8)
