"""Contact sheets: crops of photographs around boxes, with captions."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from facadelake.core.arrays import UInt8Image
from facadelake.core.progress import track
from facadelake.detection import Box
from facadelake.detection.inference import read_photograph
from facadelake.evaluation.picture_sheet import SheetCell, write_picture_sheet

_CELL_PX, _COLUMNS = 220, 6
_CONTEXT_FACTOR = 2.2  # side of a crop over the longer side of its box
_SIDE_MIN_PX = 96
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
    drawn = [SheetCell(image=cells[i], title=crop.title, below=crop.below) for i, crop in enumerate(crops)]
    return write_picture_sheet(path, drawn, title=title, columns_max=_COLUMNS)


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
