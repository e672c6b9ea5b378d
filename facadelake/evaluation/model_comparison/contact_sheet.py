"""Contact sheets: crops of photographs around boxes, with captions."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from facadelake.core.arrays import UInt8Image
from facadelake.core.errors import StoreError
from facadelake.core.progress import track
from facadelake.detection import Box
from facadelake.detection.inference import read_photograph

_CELL_PX, _CAPTION_PX, _COLUMNS = 220, 34, 6
_CONTEXT_FACTOR = 2.2  # side of a crop over the longer side of its box
_SIDE_MIN_PX = 96
_BACKGROUND, _INK, _TITLE_SIZE = 255, (40, 40, 40), 0.6
_FRAME_BGR = (30, 30, 220)


@dataclass(frozen=True, kw_only=True)
class Crop:
    """A box in a photograph (px) and its two lines of caption."""

    photograph: Path
    box: Box
    title: str
    below: str


def write_sheet(path: Path, crops: Sequence[Crop], *, title: str) -> Path | None:
    """Write ``crops`` in their order as one PNG. Without crops an earlier sheet is removed and None returned.

    The cells of a photograph that cannot be read are grey. Raises StoreError where the file cannot be written.
    """
    path.unlink(missing_ok=True)
    if not crops:
        return None
    by_photograph: dict[Path, list[int]] = defaultdict(list)
    for i, crop in enumerate(crops):
        by_photograph[crop.photograph].append(i)
    cells: dict[int, UInt8Image] = {}
    for photograph, indices in track(by_photograph.items(), label="Drawing"):
        image = read_photograph(photograph)
        for i in indices:
            cells[i] = _draw_cell(image, crops[i])
    sheet = _arrange_cells(cells, crops, title)
    encoded, data = cv2.imencode(".png", sheet)
    try:
        if not encoded:
            raise OSError("the PNG cannot be encoded")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data.tobytes())
    except OSError as error:
        raise StoreError(f"the sheet {path} cannot be written: {error}; check permissions and free space") from error
    return path


def _draw_cell(image: UInt8Image | None, crop: Crop) -> UInt8Image:
    cell = np.full((_CELL_PX, _CELL_PX, 3), 200, dtype=np.uint8)
    if image is None:
        return cell
    height, width = image.shape[:2]
    box = crop.box
    side = round(min(max(_CONTEXT_FACTOR * max(box.width_px, box.height_px), _SIDE_MIN_PX), width, height))
    left = int(np.clip(round(box.x_px + box.width_px / 2 - side / 2), 0, width - side))
    top = int(np.clip(round(box.y_px + box.height_px / 2 - side / 2), 0, height - side))
    part = image[top : top + side, left : left + side]
    scale = _CELL_PX / side
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    cell = np.asarray(cv2.resize(part, (_CELL_PX, _CELL_PX), interpolation=method), dtype=np.uint8)
    corners = np.array(
        [box.x_px - left, box.y_px - top, box.x_px - left + box.width_px, box.y_px - top + box.height_px]
    )
    x0, y0, x1, y1 = (round(float(value)) for value in corners * scale)
    cv2.rectangle(cell, (x0 - 2, y0 - 2), (x1 + 1, y1 + 1), _FRAME_BGR, 2)
    return cell


def _arrange_cells(cells: Mapping[int, UInt8Image], crops: Sequence[Crop], title: str) -> UInt8Image:
    columns = min(_COLUMNS, len(crops))
    rows = -(-len(crops) // columns)
    step_x, step_y, head = _CELL_PX + 8, _CELL_PX + _CAPTION_PX + 8, 34
    (title_px, _), _ = cv2.getTextSize(title, cv2.FONT_HERSHEY_SIMPLEX, _TITLE_SIZE, 1)
    width = max(columns * step_x + 8, title_px + 20)
    sheet = np.full((head + rows * step_y, width, 3), _BACKGROUND, dtype=np.uint8)
    _draw_text(sheet, title, 10, 23, _TITLE_SIZE)
    for i, crop in enumerate(crops):
        x, y = 8 + (i % columns) * step_x, head + (i // columns) * step_y
        sheet[y : y + _CELL_PX, x : x + _CELL_PX] = cells[i]
        _draw_text(sheet, crop.title, x, y + _CELL_PX + 13, 0.42)
        _draw_text(sheet, crop.below, x, y + _CELL_PX + 28, 0.36)
    return sheet


def _draw_text(sheet: UInt8Image, text: str, x: int, y: int, size: float) -> None:
    plain = text.encode("ascii", "replace").decode()
    cv2.putText(sheet, plain, (x, y), cv2.FONT_HERSHEY_SIMPLEX, size, _INK, 1, cv2.LINE_AA)
