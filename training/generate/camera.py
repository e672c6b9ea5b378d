"""Image formation in the camera: exposure, colour, blur, noise, compression."""

from __future__ import annotations

import cv2
import numpy as np

from facadelake.core.arrays import UInt8Image
from training.generate.canvas import LUMA, Canvas, stored_from_linear


def render_photograph(canvas: Canvas, *, noise: float) -> UInt8Image:
    """Render the picture (side, side, 3: blue, green, red; 8 bit); `noise` scales the sensor noise (1: usual)."""
    rng, side = canvas.rng, canvas.side_px
    image = canvas.image
    if canvas.draw_bernoulli(0.6):
        _apply_illumination(canvas)
    level = float(np.mean(image @ LUMA))
    wanted = (
        rng.lognormal(np.log(0.28), 0.4) * (max(level, 1e-3) / 0.28) ** 0.5
    )  # a white wall remains brighter than average
    image *= np.float32(np.clip(wanted, 0.06, 0.65) / max(level, 1e-3))
    image *= rng.normal(1, 0.035, 3).astype(np.float32)
    if canvas.draw_bernoulli(0.12):
        grey = (image @ LUMA)[..., None]
        image += np.float32(rng.uniform(0.6, 1)) * (grey - image)
    sigma = rng.choice([0.0, 0.4, 0.6, 0.9, 1.4], p=[0.3, 0.25, 0.2, 0.17, 0.08])
    if sigma:
        cv2.GaussianBlur(image, (0, 0), float(sigma), dst=image)
    stored = stored_from_linear(image)
    if noise > 0:
        grain = canvas.sample_noise(side, side, slope=0.0) * np.float32(noise * rng.uniform(0, 6))
        stored = np.clip(stored + grain[..., None], 0, 255).astype(np.uint8)
    if canvas.draw_bernoulli(0.2):
        sharp = cv2.GaussianBlur(stored, (0, 0), 1.2)
        stored = np.asarray(cv2.addWeighted(stored, 1.7, sharp, -0.7, 0), dtype=np.uint8)
    quality = int(rng.integers(45, 97))
    _, packed = cv2.imencode(".jpg", stored, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), dtype=np.uint8)


def _apply_illumination(canvas: Canvas) -> None:
    """Apply uneven illumination: a gradient, or a vignette."""
    rng, side = canvas.rng, canvas.side_px
    axis = np.linspace(-1, 1, side, dtype=np.float32)
    if canvas.draw_bernoulli(0.5):
        angle, strength = rng.uniform(0, 2 * np.pi), rng.uniform(0.05, 0.4)
        slope = axis[None, :] * np.float32(np.cos(angle)) + axis[:, None] * np.float32(np.sin(angle))
        canvas.multiply(1 + np.float32(strength) * slope * np.float32(0.7))
    else:
        centre = rng.uniform(-0.4, 0.4, 2).astype(np.float32)
        radius2 = (axis[None, :] - centre[0]) ** 2 + (axis[:, None] - centre[1]) ** 2
        canvas.multiply(1 / (1 + np.float32(rng.uniform(0.1, 0.7)) * radius2))
