"""Text in pictures drawn with OpenCV: labels on a dark background, and a strip with title and legend."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from facadelake.core.arrays import Float64Array, UInt8Image

Bgr = tuple[int, int, int]
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_LINE_PX, _GAP_PX, _SWATCH_PX = 24, 20, 14
_SIZE, _TITLE_SIZE = 0.45, 0.5
_PAPER, _INK = (250, 250, 250), (30, 30, 30)


@dataclass(frozen=True, kw_only=True)
class LegendEntry:
    """A colour and its meaning."""

    colour_bgr: Bgr
    text: str


def add_legend(picture: UInt8Image, title: str, entries: Sequence[LegendEntry]) -> UInt8Image:
    """The picture (BGR) below a light strip with title and legend, which has as many lines as they need."""
    width = picture.shape[1]
    title = _encode_ascii(title)
    x = 8 + _measure_width(title, _TITLE_SIZE) + _GAP_PX
    layout: list[tuple[int, int, LegendEntry]] = []
    line = 0
    for entry in entries:
        needed = _SWATCH_PX + 6 + _measure_width(_encode_ascii(entry.text), _SIZE)
        if x + needed > width - 8 and x > 8:
            x, line = 8, line + 1
        layout.append((x, line, entry))
        x += needed + _GAP_PX
    strip = np.full((_LINE_PX * (line + 1), width, 3), _PAPER, dtype=np.uint8)
    cv2.putText(strip, title, (8, 17), _FONT, _TITLE_SIZE, _INK, 1, cv2.LINE_AA)
    for left, row, entry in layout:
        top = row * _LINE_PX + 6
        corner = (left + _SWATCH_PX, top + _SWATCH_PX - 3)
        cv2.rectangle(strip, (left, top), corner, entry.colour_bgr, cv2.FILLED)
        cv2.rectangle(strip, (left, top), corner, _INK, 1)
        baseline = (left + _SWATCH_PX + 6, top + 11)
        cv2.putText(strip, _encode_ascii(entry.text), baseline, _FONT, _SIZE, _INK, 1, cv2.LINE_AA)
    return np.vstack([strip, picture])


def measure_text(text: str, size: float) -> tuple[int, int]:
    """Width and height of a text with its darkened background, pixels; ``size``: scale of OpenCV's font."""
    (width, height), below = cv2.getTextSize(_encode_ascii(text), _FONT, size, 1)
    return width + 4, height + below + 4


def write_text(picture: UInt8Image, text: str, centre_px: Float64Array, colour: Bgr, size: float) -> None:
    """Write a text on a darkened background into a picture.

    Args:
        picture: picture (h, w, 3), BGR; changed in place.
        text: text; characters outside ASCII become question marks.
        centre_px: centre (2,) of the text, pixels.
        colour: colour of the text, BGR.
        size: scale of OpenCV's font.
    """
    wide, high = measure_text(text, size)
    left, top = np.round(centre_px - np.array([wide, high]) / 2).astype(int).tolist()
    background = picture[max(0, top) : max(0, top + high), max(0, left) : max(0, left + wide)]
    background[:] = (0.3 * background).astype(np.uint8)
    below = cv2.getTextSize(_encode_ascii(text), _FONT, size, 1)[1]
    cv2.putText(picture, _encode_ascii(text), (left + 2, top + high - below - 2), _FONT, size, colour, 1, cv2.LINE_AA)


def _encode_ascii(text: str) -> str:
    """The text in ASCII, the only characters of OpenCV's fonts."""
    return text.encode("ascii", "replace").decode()


def _measure_width(text: str, size: float) -> int:
    return int(cv2.getTextSize(text, _FONT, size, 1)[0][0])
