"""Measure the cracks of a campaign: one photograph in memory at a time, and a crop of it around each crack."""

from __future__ import annotations

import logging
from collections import Counter, defaultdict
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import shapely

from facadelake.core.arrays import BoolArray, UInt8Image
from facadelake.core.progress import report_progress
from facadelake.core.tables import Row, table_from_rows
from facadelake.detection.inference import read_photograph
from facadelake.measurement.blur import TYPICAL_BLUR, Blur, estimate_blur, grey_from_bgr, linearise_srgb
from facadelake.measurement.crack import CrackMeasurement, measure_crack
from schemas.vocabulary import CrackWidthOutcome, DefectClass, DetectionOutcome

_log = logging.getLogger(__name__)
_MARGIN_PX = 40  # around a box, so that the crop shows the wall beside a crack at the border of its box
_MASK_BUFFER_PX = 1.5  # accuracy at which a mask follows its crack
_MAX_CROP_PIXELS = 12_000_000  # half a gigabyte of memory; a larger box holds more than one crack
_BLUR_PIECE_PX, _BLUR_PIECES = 512, 16  # size and number of the pieces whose median blur is that of the photograph
_LINE_TOLERANCE_PX = 0.3  # of the simplification of stored centrelines


def measure_detections(detections: pa.Table, root: Path) -> pa.Table:
    """Table ``detections`` with width and length of its accepted cracks.

    ``photo_id`` is a path below ``root``. A width stated in the file of detections is kept (outcome ``stated``), and
    only the length is measured. Coordinates are pixels, as those of the boxes. Cracks in a photograph that cannot be
    read have the outcome ``not_readable``.
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
    """Measure the crack of a row of table ``detections`` in its photograph (h, w, 3: blue, green, red)."""
    left, top = row["box_x_px"], row["box_y_px"]
    right, bottom = left + row["box_width_px"], top + row["box_height_px"]
    x0, y0 = max(0, int(left) - _MARGIN_PX), max(0, int(top) - _MARGIN_PX)
    x1, y1 = (int(np.ceil(end)) + _MARGIN_PX for end in (right, bottom))
    crop = image[y0:y1, x0:x1]
    if min(crop.shape[:2], default=0) < 2 or crop.shape[0] * crop.shape[1] > _MAX_CROP_PIXELS:
        return CrackMeasurement(outcome=CrackWidthOutcome.NO_LINE)
    mask = _rasterise_mask(row["mask"], x0, y0, crop.shape[:2]) if row["mask"] else None
    inside = _rasterise_box(crop.shape[:2], left - x0, top - y0, right - x0, bottom - y0) if mask is None else mask
    return measure_crack(crop, inside, is_mask=mask is not None, blur=blur).shift(x0, y0)


def estimate_photograph_blur(image: UInt8Image) -> Blur:
    """Median blur of pieces distributed over a photograph (h, w, 3), without those that have too few edges."""
    height, width = image.shape[:2]
    side = int(np.sqrt(_BLUR_PIECES))
    estimates = []
    for top in np.linspace(0, max(0, height - _BLUR_PIECE_PX), side).astype(int):
        for left in np.linspace(0, max(0, width - _BLUR_PIECE_PX), side).astype(int):
            piece = image[top : top + _BLUR_PIECE_PX, left : left + _BLUR_PIECE_PX]
            blur = estimate_blur(linearise_srgb(grey_from_bgr(piece)))
            if blur is not TYPICAL_BLUR:
                estimates.append(blur)
    if not estimates:
        return TYPICAL_BLUR
    sigma_px = float(np.median([blur.sigma_px for blur in estimates]))
    return Blur(sigma_px=sigma_px, relative_sigma=estimates[0].relative_sigma)


def _build_columns(row: Row, measurement: CrackMeasurement | None) -> Row:
    """Columns of a crack; a stated width is not changed. No measurement means that the photograph is unreadable."""
    stated = row["crack_width_px"] is not None
    if measurement is None:
        return {"crack_width_outcome": str(CrackWidthOutcome.STATED if stated else CrackWidthOutcome.NOT_READABLE)}
    columns: Row = {"crack_width_outcome": str(CrackWidthOutcome.STATED if stated else measurement.outcome)}
    if measurement.line_px is None or measurement.width is None:
        return columns
    line = shapely.simplify(shapely.linestrings(measurement.line_px), _LINE_TOLERANCE_PX)
    columns |= {"crack_line": shapely.to_wkt(line, rounding_precision=2), "crack_length_px": measurement.length_px}
    if stated:
        return columns
    columns["crack_width_limit_px"] = measurement.width.limit_px
    if measurement.outcome is CrackWidthOutcome.MEASURED:
        columns["crack_width_px"] = measurement.width.mean_px
        columns["crack_width_max_px"] = measurement.width.largest_px
        columns["crack_width_sigma_px"] = measurement.width.sigma_px
    return columns


def _rasterise_box(shape: tuple[int, ...], left: float, top: float, right: float, bottom: float) -> BoolArray:
    """The pixels (h, w) of a box, enlarged by one pixel on each side: boxes cut off the edges of cracks."""
    out = np.zeros(shape, dtype=bool)
    out[max(0, int(top) - 1) : int(np.ceil(bottom)) + 1, max(0, int(left) - 1) : int(np.ceil(right)) + 1] = True
    return out


def _rasterise_mask(text: str, x0: int, y0: int, shape: tuple[int, ...]) -> BoolArray | None:
    """The pixels (h, w) of a mask, enlarged by its accuracy; None where it contains none."""
    polygon = shapely.buffer(shapely.make_valid(shapely.from_wkt(text)), _MASK_BUFFER_PX)
    out = np.zeros(shape, dtype=np.uint8)
    for part in shapely.get_parts(polygon):
        if part.is_empty:
            continue
        rings = [part.exterior, *part.interiors]
        corners = [np.round((np.asarray(ring.coords) - [x0 + 0.5, y0 + 0.5]) * 256).astype(np.int32) for ring in rings]
        cv2.fillPoly(out, corners, 1, cv2.LINE_8, 8)
    inside: BoolArray = out > 0
    return inside if inside.any() else None
