from __future__ import annotations

import numpy as np

from facadelake.reporting.drawing.labels import place_labels
from facadelake.reporting.drawing.photograph import name_photograph_files


def test_labels_of_a_crowd_do_not_overlap_and_stay_inside() -> None:
    rng = np.random.default_rng(3)
    corners = rng.uniform([20, 20], [380, 280], size=(60, 2))
    boxes = np.hstack([corners, corners + rng.uniform(5, 25, size=(60, 2))])
    sizes = np.tile([24.0, 14.0], (60, 1))
    centres = place_labels(boxes, sizes, np.array([0.0, 0.0, 420.0, 320.0]))
    apart = np.abs(centres[:, None] - centres[None])
    overlap = (apart[..., 0] < 23.9) & (apart[..., 1] < 13.9) & ~np.eye(60, dtype=bool)
    assert overlap.sum() == 0
    assert (centres - sizes / 2 >= 0).all()
    assert (centres + sizes / 2 <= [420.0, 320.0]).all()


def test_a_lone_label_touches_its_box() -> None:
    (centre,) = place_labels(np.array([[100.0, 100, 120, 110]]), np.array([[20.0, 10]]), np.array([0.0, 0, 400, 400]))
    gap = np.maximum(np.abs(centre - [110, 105]) - [20, 10], 0)
    assert gap.max() < 5.0


def test_no_labels_are_placed_for_no_boxes() -> None:
    assert place_labels(np.zeros((0, 4)), np.zeros((0, 2)), np.array([0.0, 0, 1, 1])).shape == (0, 2)


def test_photographs_of_equal_names_have_pictures_of_different_names() -> None:
    ids = ["a/b_c.jpg", "a_b/c.jpg", "flight/IMG_1.jpg", "flight/img_1.JPG", "x/one.jpg", "x/one.png", "y/two.jpg"]
    names = name_photograph_files(ids)
    assert len({name.lower() for name in names.values()}) == len(ids)  # also where upper and lower case are one
    assert names["y/two.jpg"] == "y_two"
    assert names == name_photograph_files(reversed(ids))
