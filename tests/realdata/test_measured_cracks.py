"""Real cracks in masonry that people have painted: the line follows them and the width is about the paint's."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import shapely
from skimage.morphology import medial_axis

from benchmarks.crack_width import list_mask_pairs, measure_crack
from schemas.vocabulary import CrackWidthOutcome

pytestmark = pytest.mark.realdata
EVERY = 14


def test_lines_and_widths_of_painted_cracks(shared_data: Path) -> None:
    pairs = list_mask_pairs(shared_data / "defects" / "masonry_crack_240" / "dataset")[::EVERY]
    if len(pairs) < 10:
        pytest.skip("no masonry_crack_240 among the data sets")
    off, beside = [], []
    for image_path, mask_path in pairs:
        mask = (cv2.imread(str(mask_path), cv2.IMREAD_GRAYSCALE) > 127).astype(np.uint8)
        _, parts, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
        part = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
        left, top, wide, high = (float(value) for value in stats[part, :4])
        skeleton, reach = medial_axis(parts == part, return_distance=True)
        found = measure_crack(cv2.imread(str(image_path)), (left, top, wide, high))
        if found.outcome is not CrackWidthOutcome.MEASURED or found.width is None:
            continue
        of_mask = 2 * float(reach[skeleton].mean())
        off.append((found.width.mean_px - of_mask) / of_mask)
        far = cv2.distanceTransform(1 - mask, cv2.DIST_L2, 5)
        column, row = (
            np.clip(np.floor(shapely.get_coordinates(shapely.linestrings(found.line_px))), 0, 223).astype(int).T
        )
        beside.append(float(np.mean(far[row, column] > 2.0)))
    assert len(off) >= 0.6 * len(pairs)  # the others are openings, shadows, pairs of cracks
    assert np.median(np.abs(off)) < 0.35  # of the painted width, which is good to a pixel or two
    assert np.median(beside) < 0.1  # of a line's points, more than 2 px off the paint
