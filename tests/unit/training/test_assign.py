"""Assignment of cells to boxes."""

from __future__ import annotations

import numpy as np

from training.assign import CENTRE_RADIUS, assign, compute_iou_matrix, decode, list_cells

CELLS = list_cells(416, 416)


def _assign_uniform(
    boxes_px: list[list[float]], predicted_px: np.ndarray, classes: list[int]
) -> tuple[np.ndarray, np.ndarray]:
    probability = np.full((len(predicted_px), 3), 0.5, dtype=np.float32)
    boxes = np.array(boxes_px, dtype=np.float32).reshape(-1, 4)
    found = assign(boxes, np.array(classes, dtype=np.int64), predicted_px, probability, CELLS)
    return found.cell, found.box


def _squares(half_px: float) -> np.ndarray:
    return np.hstack([CELLS.centre_px - half_px, CELLS.centre_px + half_px]).astype(np.float32)


def test_cells_are_those_of_yolox() -> None:
    assert len(CELLS.stride_px) == 52 * 52 + 26 * 26 + 13 * 13
    assert CELLS.corner_px[53].tolist() == [8.0, 8.0]  # the second of the second row
    assert CELLS.centre_px[-1].tolist() == [400.0, 400.0]


def test_decode_gives_corners_in_pixels() -> None:
    raw = np.zeros((len(CELLS.stride_px), 4), dtype=np.float32)
    raw[52] = [1.5, 0.25, np.log(4.0), np.log(0.5)]  # first cell of the second row: corner 0, 8, stride 8
    np.testing.assert_allclose(decode(raw, CELLS)[52], [-4.0, 8.0, 28.0, 12.0], rtol=0, atol=1e-5)  # px


def test_iou_of_equal_overlapping_and_separate_boxes() -> None:
    box = np.array([[0, 0, 10, 10]], dtype=np.float32)
    others = np.array([[0, 0, 10, 10], [5, 0, 15, 10], [20, 20, 30, 30]], dtype=np.float32)
    np.testing.assert_allclose(compute_iou_matrix(box, others)[0], [1, 1 / 3, 0], rtol=0, atol=1e-6)


def test_no_boxes_no_cells() -> None:
    cell, box = _assign_uniform([], _squares(20), [])
    assert len(cell) == len(box) == 0


def test_cells_that_predict_the_box_are_assigned_to_it() -> None:
    truth = [100.0, 180.0, 140.0, 220.0]
    cell, box = _assign_uniform([truth], _squares(20), [0])
    assert 1 <= len(cell) <= 10 and set(box) == {0}
    centre = CELLS.centre_px[cell]
    assert (np.abs(centre - [120, 200]) <= CENTRE_RADIUS * CELLS.stride_px[cell][:, None]).all()


def test_a_cell_is_assigned_to_one_box_only() -> None:
    boxes = [[100.0, 100.0, 180.0, 180.0], [104.0, 104.0, 184.0, 184.0]]
    cell, box = _assign_uniform(boxes, _squares(40), [0, 1])
    assert len(np.unique(cell)) == len(cell)
    assert set(box) == {0, 1}


def test_a_box_without_any_overlap_still_gets_a_cell() -> None:
    far = np.tile(np.array([[0, 0, 1, 1]], dtype=np.float32), (len(CELLS.stride_px), 1))
    cell, box = _assign_uniform([[200.0, 300.0, 400.0, 312.0]], far, [0])
    assert len(cell) == 1 and box.tolist() == [0]
    x, y = CELLS.centre_px[cell[0]]
    assert 200 < x < 400 and 280 < y < 332


def test_the_class_decides_between_boxes_of_one_place() -> None:
    predicted = _squares(20)
    probability = np.full((len(predicted), 3), 0.02, dtype=np.float32)
    probability[:, 2] = 0.9
    boxes = np.array([[180, 180, 220, 220]] * 2, dtype=np.float32)
    found = assign(boxes, np.array([0, 2], dtype=np.int64), predicted, probability, CELLS)
    assert (found.box == 1).all()
