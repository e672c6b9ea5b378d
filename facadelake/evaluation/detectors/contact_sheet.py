"""Contact sheets of the worst results: false alarms of the highest scores and the largest missed defects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import cv2
import numpy as np

from facadelake.core.arrays import UInt8Image
from facadelake.core.errors import StoreError
from facadelake.detection import Box
from facadelake.evaluation.detectors.average_precision import PredictionMatches
from facadelake.evaluation.detectors.figures import BoxEvaluation
from facadelake.evaluation.detectors.labels.labels import LabelledImage
from facadelake.evaluation.detectors.predictions import CollectedPredictions, read_pixels
from schemas.vocabulary import DefectClass

_SIDE_PX = 260
_CAPTION_PX = 34
_COLUMNS = 6
_MARGIN_SHARE = 0.6  # margin on each side over the longer side of the box
_SIDE_MIN_PX = 64.0
_TRUTH_BGR, _PREDICTION_BGR, _FAULT_BGR = (80, 175, 0), (200, 120, 0), (0, 0, 220)  # blue, green, red
_FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A false alarm (with ``score``) or a missed defect (None) in a photograph; ``box`` in px."""

    image: LabelledImage
    box: Box
    defect_class: DefectClass
    score: float | None


def select_faults(
    matches_by_class: Sequence[PredictionMatches], collected: CollectedPredictions, faults_max: int = 18
) -> list[Fault]:
    """The false alarms of the highest scores, then the missed defects of the largest share of their photograph, at most
    ``faults_max`` of each, over all classes."""
    alarms, misses = [], []
    for matches in matches_by_class:
        defect_class = matches.defect_class
        for i in np.flatnonzero(~(matches.hit[0] | matches.ignored[0])).tolist():
            image = matches.images[matches.image[i]]
            one = collected.above_threshold[image.key][matches.rank[i]]
            alarms.append(Fault(image=image, box=one.box, defect_class=defect_class, score=one.score))
        for i in np.flatnonzero(~matches.found[0]).tolist():
            image = matches.images[matches.truth_image[i]]
            box = image.boxes[matches.truth_rank[i]].box
            misses.append(Fault(image=image, box=box, defect_class=defect_class, score=None))
    alarms.sort(key=lambda one: -(one.score or 0.0))
    misses.sort(key=lambda one: -one.box.width_px * one.box.height_px / (one.image.width_px * one.image.height_px))
    return [*alarms[:faults_max], *misses[:faults_max]]


def select_false_alarms(collected: CollectedPredictions, faults_max: int = 36) -> list[Fault]:
    """The predictions of the highest scores in photographs without defects, at most ``faults_max``."""
    alarms = [
        Fault(image=image, box=one.box, defect_class=one.defect_class, score=one.score)
        for image in collected.images
        for one in collected.above_threshold[image.key]
    ]
    return sorted(alarms, key=lambda one: -(one.score or 0.0))[:faults_max]


def write_sheets(
    evaluation: BoxEvaluation,
    collected: CollectedPredictions,
    collected_negatives: CollectedPredictions | None,
    folder: Path,
) -> list[Path]:
    """Write ``worst.png`` and ``worst_without_defects.png``; a sheet without faults is not written.

    Args:
        evaluation: The evaluation on labelled photographs.
        collected: Its predictions.
        collected_negatives: Predictions on photographs without defects, if any.
        folder: Folder to write to.

    Returns:
        Paths of the sheets.

    Raises:
        StoreError: A sheet cannot be written.
    """
    faults = select_faults(list(evaluation.matches_above_threshold.values()), collected)
    written = [write_contact_sheet(faults, collected, folder / "worst.png")]
    if collected_negatives is not None:
        alarms = select_false_alarms(collected_negatives)
        written.append(write_contact_sheet(alarms, collected_negatives, folder / "worst_without_defects.png"))
    return [path for path in written if path is not None]


def write_contact_sheet(faults: Sequence[Fault], collected: CollectedPredictions, path: Path) -> Path | None:
    """Write a sheet as PNG: red the fault, green the labels, blue the other predictions; None without faults."""
    if not faults:
        return None
    cell_by_index: dict[int, UInt8Image] = {}
    order = sorted(range(len(faults)), key=lambda i: faults[i].image.key)
    for _, group in groupby(order, key=lambda i: faults[i].image.key):  # each photograph is read once
        indices = list(group)
        pixels = read_pixels(faults[indices[0]].image.path)
        for i in indices:
            cell_by_index[i] = _draw_cell(faults[i], pixels, collected)
    blank = np.full_like(cell_by_index[0], 255)
    cells = [cell_by_index[i] for i in range(len(faults))]
    cells += [blank] * (-len(cells) % min(_COLUMNS, len(cells)))
    columns = min(_COLUMNS, len(faults))
    rows = [np.hstack(cells[i : i + columns]) for i in range(0, len(cells), columns)]
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), np.vstack(rows)):
        raise StoreError(f"{path} cannot be written; check permissions and free space")
    return path


def _draw_cell(fault: Fault, pixels: UInt8Image | None, collected: CollectedPredictions) -> UInt8Image:
    """A square crop around the box, with a caption below."""
    cell = np.full((_SIDE_PX + _CAPTION_PX, _SIDE_PX + 4, 3), 255, dtype=np.uint8)
    box, image = fault.box, fault.image
    side = max((1 + 2 * _MARGIN_SHARE) * max(box.width_px, box.height_px), _SIDE_MIN_PX)
    side = min(side, float(max(image.width_px, image.height_px)))
    left = _shift_into_image(box.x_px + box.width_px / 2 - side / 2, side, image.width_px)
    top = _shift_into_image(box.y_px + box.height_px / 2 - side / 2, side, image.height_px)
    scale = _SIDE_PX / side
    if pixels is not None:
        cell_from_img = np.array([[scale, 0, -scale * left], [0, scale, -scale * top]])
        interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        shrunk: UInt8Image = pixels
        if scale < 0.5:  # warpAffine does not average
            shrunk = np.asarray(
                cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=interpolation), dtype=np.uint8
            )
            cell_from_img = np.array([[1.0, 0, -scale * left], [0, 1.0, -scale * top]])
        part = cv2.warpAffine(shrunk, cell_from_img, (_SIDE_PX, _SIDE_PX), borderValue=(225, 225, 225))
        cell[:_SIDE_PX, :_SIDE_PX] = part
    inner = cell[:_SIDE_PX, :_SIDE_PX]
    for other in collected.above_threshold.get(image.key, ()):
        _draw_box(inner, other.box, left, top, scale, _PREDICTION_BGR, 1)
    for truth in image.boxes:
        _draw_box(inner, truth.box, left, top, scale, _TRUTH_BGR, 2)
    _draw_box(inner, box, left, top, scale, _FAULT_BGR, 2)
    label = "missed" if fault.score is None else f"false alarm {fault.score:.2f}"
    for i, text in enumerate((f"{label} {fault.defect_class}", image.key[-40:])):
        cv2.putText(cell, text, (3, _SIDE_PX + 13 + 14 * i), _FONT, 0.38, (0, 0, 0), 1, cv2.LINE_AA)
    return cell


def _shift_into_image(start: float, side: float, length_px: int) -> float:
    """Start of the square, shifted so that it shows as much of the photograph as possible."""
    return (length_px - side) / 2 if side >= length_px else min(max(start, 0.0), length_px - side)


def _draw_box(
    tile: UInt8Image, box: Box, left: float, top: float, scale: float, colour: tuple[int, int, int], thickness: int
) -> None:
    corners = np.array([[box.x_px, box.y_px], [box.x_px + box.width_px, box.y_px + box.height_px]])
    (x0, y0), (x1, y1) = np.round((corners - [left, top]) * scale).astype(int).clip(-9999, 9999).tolist()
    cv2.rectangle(tile, (x0, y0), (x1, y1), colour, thickness)
