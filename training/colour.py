"""Photometric augmentation: illumination, colour, blur, noise and compression."""

from __future__ import annotations

import cv2
import numpy as np

from facadelake.core.arrays import UInt8Image

_GREY_MIN = 35  # mean grey level


def augment_image(image: UInt8Image, rng: np.random.Generator) -> UInt8Image:
    """Change illumination, colour and camera of a picture (h, w, 3) at random."""
    if rng.random() < 0.25:
        image = _add_shadow(image, rng)
    image = _change_tone(image, rng)
    if rng.random() < 0.15:
        image = _blur(image, rng)
    if rng.random() < 0.25:
        image = _add_noise(image, rng)
    if rng.random() < 0.3:
        code = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(30, 95))])[1]
        image = np.asarray(cv2.imdecode(code, cv2.IMREAD_COLOR), dtype=np.uint8)
    return image


def _add_noise(image: UInt8Image, rng: np.random.Generator) -> UInt8Image:
    """Add sensor noise, coloured or grey."""
    channels = 1 if rng.random() < 0.5 else 3
    cv2.setRNGSeed(int(rng.integers(2**31 - 1)))
    noise = np.empty((*image.shape[:2], channels), np.int16)
    cv2.randn(noise, np.zeros(channels), np.full(channels, rng.uniform(1, 9)))
    noisy = cv2.add(image, np.broadcast_to(noise, image.shape).copy(), dtype=cv2.CV_8U)
    return np.asarray(noisy, dtype=np.uint8)


def _change_tone(image: UInt8Image, rng: np.random.Generator) -> UInt8Image:
    """Change exposure, contrast, gamma, white balance and saturation; sometimes convert to grey."""
    levels = np.arange(256, dtype=np.float64) / 255
    gamma = np.exp(rng.normal(0, 0.3))
    contrast, brightness = np.exp(rng.normal(0, 0.25)), rng.normal(0, 0.1)
    balance = np.exp(rng.normal(0, 0.06, 3))
    curve = (levels**gamma - 0.5) * contrast + 0.5 + brightness
    table = np.clip(curve[:, None] * balance, 0, 1) * 255
    toned = cv2.LUT(image, table.astype(np.uint8).reshape(1, 256, 3))
    if toned.mean() < _GREY_MIN:  # too dark to show defects
        toned = image
    strength = 0.0 if rng.random() < 0.1 else rng.uniform(0.4, 1.5)
    grey = cv2.cvtColor(toned, cv2.COLOR_BGR2GRAY)[..., None]
    return np.asarray(cv2.addWeighted(toned, strength, np.repeat(grey, 3, axis=2), 1 - strength, 0), dtype=np.uint8)


def _add_shadow(image: UInt8Image, rng: np.random.Generator) -> UInt8Image:
    """Darken one side of a straight edge, hard (a cast shadow) or soft (uneven illumination)."""
    height, width = image.shape[:2]
    angle = rng.uniform(0, 2 * np.pi)
    x = (np.arange(width, dtype=np.float32) - rng.uniform(0, width)) * np.float32(np.cos(angle))
    y = (np.arange(height, dtype=np.float32) - rng.uniform(0, height)) * np.float32(np.sin(angle))
    softness = np.float32(np.exp(rng.uniform(np.log(1.5), np.log(250))))
    depth = np.float32(rng.uniform(0.15, 0.6))
    steps = np.clip((x[None, :] + y[:, None]) / softness, -6, 6)
    factor = 1 - depth / (1 + np.exp(-steps))
    return np.asarray(cv2.multiply(image, cv2.merge([factor] * 3), dtype=cv2.CV_8U), dtype=np.uint8)


def _blur(image: UInt8Image, rng: np.random.Generator) -> UInt8Image:
    """Blur by a Gaussian, or by motion along a line."""
    if rng.random() < 0.6:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), rng.uniform(0.4, 1.4)), dtype=np.uint8)
    length = int(rng.integers(3, 7))
    kernel = np.zeros((length, length), np.float32)
    cv2.line(kernel, (0, int(rng.integers(0, length))), (length - 1, int(rng.integers(0, length))), 1.0)
    kernel = kernel if rng.random() < 0.5 else kernel.T
    return np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum()), dtype=np.uint8)
