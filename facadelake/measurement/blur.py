"""Linear light of a photograph, and its blur estimated from its sharpest edges."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from facadelake.core.arrays import BoolArray, Float32Array, Int64Array, UInt8Array

_REBLUR_SIGMA_PX = 1.0  # the known blur that is added
_MIN_EDGES = 30
_EDGE_PIXEL_SHARE = 0.003  # share of the pixels that are used as edges
_BLUR_PERCENTILE = 30  # percentile of the blurs of edges that is the blur of the lens: most edges are soft in reality
_EDGE_HALF_LENGTH_PX = 4  # of the profile across an edge, to either side
_MIN_STEP_SHARE = 0.85
_MIN_SIGMA_PX, _MAX_SIGMA_PX = 0.45, 4.0


def grey_from_bgr(image_bgr: UInt8Array) -> Float32Array:
    """Luma (h, w), 0 to 1, in the transfer function of the file: JPEG stores this channel at full resolution."""
    return np.asarray(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2GRAY) / np.float32(255), dtype=np.float32)


def linearise_srgb(grey: Float32Array) -> Float32Array:
    """Linear light (h, w) of luma by the sRGB transfer function (IEC 61966-2-1); the camera's tone curve is unknown."""
    low = grey / np.float32(12.92)
    high = ((grey + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    return np.asarray(np.where(grey <= 0.04045, low, high), dtype=np.float32)


@dataclass(frozen=True, kw_only=True)
class Blur:
    """Gaussian point spread of a photograph (lens, demosaicing and pixel): ``sigma_px`` and its relative error."""

    sigma_px: float
    relative_sigma: float


TYPICAL_BLUR = Blur(sigma_px=0.95, relative_sigma=0.25)  # typical of drone photographs


def estimate_blur(light: Float32Array) -> Blur:
    """Estimate the blur of an image (h, w) of linear light from the gradients of its strongest edges after reblurring.

    An edge of blur s whose gradient decreases by the ratio r under an additional blur a has s = a / sqrt(r**2 - 1).
    Returns ``TYPICAL_BLUR`` where there are too few edges.
    Source: Zhuo and Sim, "Defocus map estimation from a single image", Pattern Recognition 2011.
    """
    reblurred = np.asarray(cv2.GaussianBlur(light, (0, 0), sigmaX=_REBLUR_SIGMA_PX), dtype=np.float32)
    gradient, is_edge = _compute_gradient(light)
    reblurred_gradient, _ = _compute_gradient(reblurred)
    count = max(_MIN_EDGES, int(_EDGE_PIXEL_SHARE * gradient.size))
    edges = np.flatnonzero(is_edge & (gradient > 6 * np.median(gradient)))
    edges = edges[_select_step_edges(light, edges)]
    if len(edges) < _MIN_EDGES:
        return TYPICAL_BLUR
    edges = edges[np.argsort(gradient.ravel()[edges])[-count:]]
    ratio = gradient.ravel()[edges] / np.maximum(reblurred_gradient.ravel()[edges], 1e-9)
    sigma = _REBLUR_SIGMA_PX / np.sqrt(np.maximum(ratio**2 - 1, 1e-3))
    return Blur(
        sigma_px=float(np.clip(np.percentile(sigma, _BLUR_PERCENTILE), _MIN_SIGMA_PX, _MAX_SIGMA_PX)),
        relative_sigma=0.2,
    )


def _select_step_edges(light: Float32Array, edges: Int64Array) -> BoolArray:
    """Whether each edge (k,) is a step between two levels; the two edges of a thin line are not."""
    row, column = np.divmod(edges, light.shape[1])
    dx, dy = cv2.Scharr(light, cv2.CV_32F, 1, 0)[row, column], cv2.Scharr(light, cv2.CV_32F, 0, 1)[row, column]
    norm = np.maximum(np.hypot(dx, dy), 1e-12)
    offset = np.arange(-_EDGE_HALF_LENGTH_PX, _EDGE_HALF_LENGTH_PX + 1)
    rows = np.clip(np.round(row[:, None] + offset * (dy / norm)[:, None]).astype(np.int64), 0, light.shape[0] - 1)
    columns = np.clip(np.round(column[:, None] + offset * (dx / norm)[:, None]).astype(np.int64), 0, light.shape[1] - 1)
    profile = light[rows, columns]
    return np.asarray(np.abs(profile[:, -1] - profile[:, 0]) >= _MIN_STEP_SHARE * np.ptp(profile, axis=1))


def _compute_gradient(light: Float32Array) -> tuple[Float32Array, BoolArray]:
    """Gradient magnitude (h, w), and its local maxima (h, w) across the edge."""
    dx, dy = cv2.Scharr(light, cv2.CV_32F, 1, 0), cv2.Scharr(light, cv2.CV_32F, 0, 1)
    magnitude = np.asarray(cv2.magnitude(dx, dy), dtype=np.float32)
    along_rows = cv2.dilate(magnitude, np.ones((1, 3), dtype=np.uint8))
    along_columns = cv2.dilate(magnitude, np.ones((3, 1), dtype=np.uint8))
    is_vertical_edge = np.abs(dx) >= np.abs(dy)
    return magnitude, np.asarray(magnitude >= np.where(is_vertical_edge, along_rows, along_columns))
