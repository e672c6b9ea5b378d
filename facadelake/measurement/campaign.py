"""The cracks of a campaign measured: one photograph in memory at a time, and a piece of it about each crack."""

from __future__ import annotations

import logging
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import shapely

from facadelake.core.arrays import BoolArray, UInt8Image
from facadelake.core.progress import report_progress
from facadelake.core.tables import table_from_rows
from facadelake.detection.inference import read_photograph
from facadelake.measurement.blur import TYPICAL_BLUR, Blur, estimate_blur, grey_from_bgr, linearise_srgb
from facadelake.measurement.crack import CrackMeasurement, measure_crack
from schemas.vocabulary import CrackWidthOutcome, DefectClass, DetectionOutcome

_log = logging.getLogger(__name__)
_MARGIN_PX = 40  # of photograph about a box, so that the wall beside a crack at its edge is seen
_MASK_BUFFER_PX = 1.5  # a mask follows its crack this closely at best
_MAX_CROP_PIXELS = 12_000_000  # of one piece (half a gigabyte of work); a larger box holds more than one crack
_BLUR_PIECE_PX, _BLUR_PIECES = 512, 16  # a photograph's blur is the median of that of pieces across it
_LINE_TOLERANCE_PX = 0.3  # bends smaller than this are left out of a line that is stored

Row = dict[str, Any]


def measure_detections(detections: pa.Table, root: Path) -> pa.Table:
    """Table ``detections`` with the columns of accepted cracks' widths and lengths filled.

    ``photo_id`` is a path below ``root``. A width that the detections' file states is kept (outcome ``stated``); the
    length of such a crack is measured all the same. Coordinates are pixels as the boxes' are. A photograph that cannot
    be read leaves its cracks ``not_readable``.
    """
    rows = detections.to_pylist()
    cracks: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        accepted = row["detection_outcome"] == DetectionOutcome.ACCEPTED
        if accepted and row["defect_class"] == DefectClass.CRACK:
            cracks[row["photo_id"]].append(row)
    with report_progress("Measuring cracks", sum(map(len, cracks.values()))) as step:
        for photo_id in sorted(cracks):
            image = read_photograph(root / photo_id)
            if image is None:
                _log.warning("%s cannot be read: its %d cracks are not measured", photo_id, len(cracks[photo_id]))
            blur = TYPICAL_BLUR if image is None else estimate_photograph_blur(image)
            for row in cracks[photo_id]:
                row.update(_build_columns(row, None if image is None else measure_in_photograph(image, row, blur)))
                step.advance()
    counts = Counter(row["crack_width_outcome"] for row in rows if row["crack_width_outcome"] is not None)
    _log.info("%d cracks: %s", sum(counts.values()), ", ".join(f"{n} {name}" for name, n in sorted(counts.items())))
    return table_from_rows("detections", rows)


def measure_in_photograph(image: UInt8Image, row: Row, blur: Blur) -> CrackMeasurement:
    """The crack of a row of table ``detections`` in its photograph (h, w, 3: blue, green, red)."""
    left, top = row["box_x_px"], row["box_y_px"]
    right, bottom = left + row["box_width_px"], top + row["box_height_px"]
    x0, y0 = max(0, int(left) - _MARGIN_PX), max(0, int(top) - _MARGIN_PX)
    x1, y1 = (int(np.ceil(end)) + _MARGIN_PX for end in (right, bottom))
    crop = image[y0:y1, x0:x1]
    if min(crop.shape[:2], default=0) < 2 or crop.shape[0] * crop.shape[1] > _MAX_CROP_PIXELS:
        return CrackMeasurement(outcome=CrackWidthOutcome.NO_LINE)
    mask = _rasterise_mask(row["mask"], x0, y0, crop.shape[:2]) if row["mask"] else None
    inside = _rasterise_box(crop.shape[:2], left - x0, top - y0, right - x0, bottom - y0) if mask is None else mask
    found = measure_crack(crop, inside, is_mask=mask is not None, blur=blur)
    return found.shift(x0, y0)


def estimate_photograph_blur(image: UInt8Image) -> Blur:
    """Median blur of pieces spread over a photograph, of those that have edges to tell it."""
    height, width = image.shape[:2]
    side = int(np.sqrt(_BLUR_PIECES))
    known = []
    for top in np.linspace(0, max(0, height - _BLUR_PIECE_PX), side).astype(int):
        for left in np.linspace(0, max(0, width - _BLUR_PIECE_PX), side).astype(int):
            piece = image[top : top + _BLUR_PIECE_PX, left : left + _BLUR_PIECE_PX]
            blur = estimate_blur(linearise_srgb(grey_from_bgr(piece)))
            if blur is not TYPICAL_BLUR:
                known.append(blur)
    if not known:
        return TYPICAL_BLUR
    return Blur(sigma_px=float(np.median([blur.sigma_px for blur in known])), relative_sigma=known[0].relative_sigma)


def _build_columns(row: Row, found: CrackMeasurement | None) -> Row:
    """Columns of a crack; those of its width stay as stated where a person stated it."""
    stated = row["crack_width_px"] is not None
    if found is None:
        return {"crack_width_outcome": str(CrackWidthOutcome.STATED if stated else CrackWidthOutcome.NOT_READABLE)}
    columns: Row = {"crack_width_outcome": str(CrackWidthOutcome.STATED if stated else found.outcome)}
    if found.line_px is None or found.width is None:
        return columns
    line = shapely.simplify(shapely.linestrings(found.line_px), _LINE_TOLERANCE_PX)
    columns |= {"crack_line": shapely.to_wkt(line, rounding_precision=2), "crack_length_px": found.length_px}
    if stated:
        return columns
    columns["crack_width_limit_px"] = found.width.limit_px
    if found.outcome is CrackWidthOutcome.MEASURED:
        columns["crack_width_px"] = found.width.mean_px
        columns["crack_width_max_px"] = found.width.largest_px
        columns["crack_width_sigma_px"] = found.width.sigma_px
    return columns


def _rasterise_box(shape: tuple[int, ...], left: float, top: float, right: float, bottom: float) -> BoolArray:
    """The pixels (h, w) of a box, one wider all about: boxes cut cracks' rims."""
    out = np.zeros(shape, dtype=bool)
    out[max(0, int(top) - 1) : int(np.ceil(bottom)) + 1, max(0, int(left) - 1) : int(np.ceil(right)) + 1] = True
    return out


def _rasterise_mask(text: str, x0: int, y0: int, shape: tuple[int, ...]) -> BoolArray | None:
    """The pixels (h, w) of a mask with its rim; None where it holds none."""
    shape_px = shapely.buffer(shapely.make_valid(shapely.from_wkt(text)), _MASK_BUFFER_PX)
    out = np.zeros(shape, dtype=np.uint8)
    for part in shapely.get_parts(shape_px):
        if part.is_empty:
            continue
        rings = [part.exterior, *part.interiors]
        corners = [np.round((np.asarray(ring.coords) - [x0 + 0.5, y0 + 0.5]) * 256).astype(np.int32) for ring in rings]
        cv2.fillPoly(out, corners, 1, cv2.LINE_8, 8)
    inside: BoolArray = out > 0
    return inside if inside.any() else None
