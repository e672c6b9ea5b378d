"""Sheets of pictures with captions, as PNG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from facadelake.core.arrays import UInt8Image
from facadelake.core.errors import StoreError

_CAPTION_PX, _GAP_PX, _HEAD_PX = 34, 8, 34
_BACKGROUND, _INK, _TITLE_SIZE = 255, (40, 40, 40), 0.6


@dataclass(frozen=True, kw_only=True, eq=False)
class SheetCell:
    """A picture (h, w, 3) and its two lines of caption."""

    image: UInt8Image
    title: str
    below: str


def write_picture_sheet(path: Path, cells: Sequence[SheetCell], *, title: str, columns_max: int) -> Path:
    """Write one or more cells in their order as one PNG.

    Args:
        path: the file.
        cells: the pictures; cells are as large as the largest.
        title: of the sheet.
        columns_max: the largest number of cells side by side.

    Returns:
        The path.

    Raises:
        StoreError: The file cannot be written.
    """
    columns = min(columns_max, len(cells))
    rows = -(-len(cells) // columns)
    height, width = (max(cell.image.shape[axis] for cell in cells) for axis in (0, 1))
    step_x, step_y = width + _GAP_PX, height + _CAPTION_PX + _GAP_PX
    (title_px, _), _ = cv2.getTextSize(title, cv2.FONT_HERSHEY_SIMPLEX, _TITLE_SIZE, 1)
    size = (_HEAD_PX + rows * step_y, max(columns * step_x + _GAP_PX, title_px + 20), 3)
    sheet = np.full(size, _BACKGROUND, dtype=np.uint8)
    _draw_text(sheet, title, 10, 23, _TITLE_SIZE)
    for i, cell in enumerate(cells):
        x, y = _GAP_PX + (i % columns) * step_x, _HEAD_PX + (i // columns) * step_y
        sheet[y : y + cell.image.shape[0], x : x + cell.image.shape[1]] = cell.image
        _draw_text(sheet, cell.title, x, y + height + 13, 0.42)
        _draw_text(sheet, cell.below, x, y + height + 28, 0.36)
    encoded, data = cv2.imencode(".png", sheet)
    try:
        if not encoded:
            raise OSError("the PNG cannot be encoded")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data.tobytes())
    except OSError as error:
        raise StoreError(f"the sheet {path} cannot be written: {error}; check permissions and free space") from error
    return path


def _draw_text(sheet: UInt8Image, text: str, x: int, y: int, size: float) -> None:
    plain = text.encode("ascii", "replace").decode()
    cv2.putText(sheet, plain, (x, y), cv2.FONT_HERSHEY_SIMPLEX, size, _INK, 1, cv2.LINE_AA)
