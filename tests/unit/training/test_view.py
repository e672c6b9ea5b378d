"""Placement of pictures, boxes and paths of cracks on the input of the network."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from training.crackpath import CrackPath, trace_crack
from training.view import PAD_VALUE, Placement, View, place_boxes, place_image

SIDE = 416


def _diagonal() -> View:
    """A dark line from (40, 60) to (360, 300) on a light wall with grain; its box is drawn 10 px too large."""
    grain = np.random.default_rng(0).normal(0, 4, (400, 400, 1))
    image = np.clip(np.full((400, 400, 3), 170) + grain, 0, 255).astype(np.uint8)
    cv2.line(image, (40, 60), (360, 300), (60, 60, 60), 3)
    box = np.array([30.0, 50.0, 370.0, 310.0])
    return View(image=image, boxes_px=box[None], classes=np.array([0]), paths=(trace_crack(image, box),))


VIEW = _diagonal()


def _create_placement(matrix: list[list[float]], side: int = SIDE) -> Placement:
    return Placement(input_from_image=np.array(matrix, dtype=np.float64), width_px=side, height_px=side)


def test_the_path_follows_the_crack() -> None:
    (path,) = VIEW.paths
    assert path is not None
    x, y = path.points_px.T
    off = np.abs((y - 60) - (x - 40) * 240 / 320) * 320 / 400
    inner = (x > 50) & (x < 350)
    assert inner.sum() > 50 and np.quantile(off[inner], 0.95) < 6  # px


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_whole_box_is_moved_exactly(mirrored: bool) -> None:
    matrix = [[-0.5, 0.0, 300.0], [0.0, 0.5, 20.0]] if mirrored else [[0.5, 0.0, 100.0], [0.0, 0.5, 20.0]]
    boxes, classes = place_boxes(VIEW, _create_placement(matrix))
    expected = [115.0, 45.0, 285.0, 175.0]
    assert classes.tolist() == [0]
    np.testing.assert_allclose(boxes, [expected], rtol=0, atol=1e-9)  # px


def test_a_cut_crack_has_the_box_of_its_visible_part() -> None:
    """The left half of the picture alone: the crack leaves it at (200, 180), its box would reach down to 310."""
    boxes, _ = place_boxes(VIEW, _create_placement([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], side=200))
    left, top, right, bottom = boxes[0]
    assert left == pytest.approx(30, abs=6) and top == pytest.approx(50, abs=6)
    assert right == pytest.approx(200, abs=1)
    assert 170 < bottom < 196


def test_a_cut_that_shows_none_of_the_crack_shows_no_box() -> None:
    """The lower left corner of the box, in which the crack does not run."""
    boxes, _ = place_boxes(VIEW, _create_placement([[1.0, 0.0, -30.0], [0.0, 1.0, -230.0]], side=80))
    assert len(boxes) == 0


def test_a_rotated_crack_has_a_new_box() -> None:
    """Rotated by the angle of the line it is horizontal; the box of the rotated box would be 400 px high."""
    angle = -np.arctan2(240, 320)
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, -sin], [sin, cos]])
    shift = np.array([SIDE / 2, SIDE / 2]) - turn @ [200, 180]
    boxes, _ = place_boxes(VIEW, _create_placement(np.column_stack([turn, shift]).tolist()))
    left, top, right, bottom = boxes[0]
    assert bottom - top < 60 and right - left > 380
    assert (top + bottom) / 2 == pytest.approx(SIDE / 2, abs=8)  # px


def test_areas_are_cut_and_slivers_dropped() -> None:
    image = VIEW.image
    view = View(image=image, boxes_px=np.array([[0.0, 0.0, 100.0, 100.0]]), classes=np.array([1]), paths=(None,))
    half, _ = place_boxes(view, _create_placement([[1.0, 0.0, -50.0], [0.0, 1.0, 0.0]]))
    np.testing.assert_allclose(half, [[0, 0, 50, 100]], rtol=0, atol=1e-9)
    sliver, _ = place_boxes(view, _create_placement([[1.0, 0.0, -80.0], [0.0, 1.0, 0.0]]))
    assert len(sliver) == 0


@settings(max_examples=25, deadline=None)
@given(gain=st.floats(0.2, 2.0), x=st.floats(-10, 60), y=st.floats(-10, 60))
def test_picture_and_boxes_move_alike(gain: float, x: float, y: float) -> None:
    """A white square on black: its position on the input agrees with its box."""
    image = np.zeros((300, 300, 3), np.uint8)
    image[100:180, 120:220] = 255
    box = np.array([[120.0, 100.0, 220.0, 180.0]])
    view = View(image=image, boxes_px=box, classes=np.array([1]), paths=(None,))
    placement = _create_placement([[gain, 0.0, x], [0.0, gain, y]])
    boxes, _ = place_boxes(view, placement)
    rows, columns = np.nonzero(place_image(image, placement)[..., 0] > 128)
    seen = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
    np.testing.assert_allclose(boxes[0], seen, rtol=0, atol=1.01)  # px


def test_what_the_picture_does_not_reach_is_grey() -> None:
    placed = place_image(np.zeros((50, 50, 3), np.uint8), _create_placement([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    assert (placed[60:, 60:] == PAD_VALUE).all() and (placed[:49, :49] == 0).all()


def test_a_path_keeps_the_margins_of_the_box() -> None:
    (path,) = VIEW.paths
    assert isinstance(path, CrackPath)
    assert (path.margin_px >= 0).all() and path.margin_px.max() < 25  # px; 10 were drawn
