"""A photograph's pixels as linear light, and how blurred it is by its own sharpest edges."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from facadelake.core.arrays import BoolArray, Float32Array, Int64Array, UInt8Array


def grey_from_bgr(image_bgr: UInt8Array) -> Float32Array:
    """Brightness (h, w), 0 to 1, as the file codes it: JPEG keeps this one channel at full resolution."""
    return np.asarray(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2GRAY) / np.float32(255), dtype=np.float32)


def linearise_srgb(coded: Float32Array) -> Float32Array:
    """The light behind coded values, by sRGB's curve (IEC 61966-2-1); a camera's own tone curve is not known."""
    low = coded / np.float32(12.92)
    high = ((coded + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    return np.asarray(np.where(coded <= 0.04045, low, high), dtype=np.float32)


_REBLUR_SIGMA_PX = 1.0  # the blur added, by which the photograph's own is told
_MIN_EDGES = 30
_EDGE_PIXEL_SHARE = 0.003  # share of a piece's pixels that are looked at as edges
_BLUR_PERCENTILE = 30  # percentile of the edges' blurs taken for the lens's: most edges are soft themselves
_EDGE_HALF_LENGTH_PX = 4  # of an edge, to either side
_MIN_STEP_SHARE = 0.85
_MIN_SIGMA_PX, _MAX_SIGMA_PX = 0.45, 4.0


@dataclass(frozen=True, kw_only=True)
class Blur:
    """One sigma of a photograph's blur (lens, mosaic and pixel together), px, and how well it is known (share)."""

    sigma_px: float
    relative_sigma: float


TYPICAL_BLUR = Blur(sigma_px=0.95, relative_sigma=0.25)  # what photographs of drones have


def estimate_blur(light: Float32Array) -> Blur:
    """Blur of a piece (h, w) of linear light, by blurring its strongest edges again and seeing what they lose.

    An edge of blur s whose gradient falls by a ratio r under a further blur of a has s = a / sqrt(r**2 - 1). Source:
    Zhuo and Sim, "Defocus map estimation from a single image", Pattern Recognition 2011. Where there are too few
    edges, what is usual.
    """
    again = np.asarray(cv2.GaussianBlur(light, (0, 0), sigmaX=_REBLUR_SIGMA_PX), dtype=np.float32)
    steep, flat, edge = *(_compute_gradient(one)[0] for one in (light, again)), _compute_gradient(light)[1]
    wanted = max(_MIN_EDGES, int(_EDGE_PIXEL_SHARE * steep.size))
    edges = np.flatnonzero(edge & (steep > 6 * np.median(steep)))
    edges = edges[_select_step_edges(light, edges)]
    if len(edges) < _MIN_EDGES:
        return TYPICAL_BLUR
    edges = edges[np.argsort(steep.ravel()[edges])[-wanted:]]
    ratio = steep.ravel()[edges] / np.maximum(flat.ravel()[edges], 1e-9)
    sigma = _REBLUR_SIGMA_PX / np.sqrt(np.maximum(ratio**2 - 1, 1e-3))
    return Blur(
        sigma_px=float(np.clip(np.percentile(sigma, _BLUR_PERCENTILE), _MIN_SIGMA_PX, _MAX_SIGMA_PX)),
        relative_sigma=0.2,
    )


def _select_step_edges(light: Float32Array, edges: Int64Array) -> BoolArray:
    """Which of the edges part two levels: a thin line has two edges that take light from one another."""
    row, column = np.divmod(edges, light.shape[1])
    dx, dy = cv2.Scharr(light, cv2.CV_32F, 1, 0)[row, column], cv2.Scharr(light, cv2.CV_32F, 0, 1)[row, column]
    length = np.maximum(np.hypot(dx, dy), 1e-12)
    reach = np.arange(-_EDGE_HALF_LENGTH_PX, _EDGE_HALF_LENGTH_PX + 1)
    rows = np.clip(np.round(row[:, None] + reach * (dy / length)[:, None]).astype(np.int64), 0, light.shape[0] - 1)
    columns = np.clip(
        np.round(column[:, None] + reach * (dx / length)[:, None]).astype(np.int64), 0, light.shape[1] - 1
    )
    profile = light[rows, columns]
    return np.asarray(np.abs(profile[:, -1] - profile[:, 0]) >= _MIN_STEP_SHARE * np.ptp(profile, axis=1))


def _compute_gradient(light: Float32Array) -> tuple[Float32Array, BoolArray]:
    """Steepness (h, w), and where it is larger than before and behind."""
    dx, dy = cv2.Scharr(light, cv2.CV_32F, 1, 0), cv2.Scharr(light, cv2.CV_32F, 0, 1)
    steep = np.asarray(cv2.magnitude(dx, dy), dtype=np.float32)
    beside = cv2.dilate(steep, np.ones((1, 3), dtype=np.uint8)), cv2.dilate(steep, np.ones((3, 1), dtype=np.uint8))
    upright = np.abs(dx) >= np.abs(dy)
    return steep, np.asarray(steep >= np.where(upright, *beside))
