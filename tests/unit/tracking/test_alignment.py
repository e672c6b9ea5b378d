from __future__ import annotations

import cv2
import numpy as np
import pytest

from facadelake.tracking import align_patch
from facadelake.tracking.second_look.alignment import move_patch, shift_patch

SIDE = 160


def make_wall(seed: int = 0) -> np.ndarray:
    texture = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=(SIDE, SIDE)), (0, 0), 2.0)
    return np.asarray(texture / texture.std(), dtype=np.float32)


def turn(patch: np.ndarray, degrees: float, shift: tuple[float, float]) -> np.ndarray:
    """The patch as another pose shows it: turned about its centre and shifted, cells."""
    warp = cv2.getRotationMatrix2D((SIDE / 2, SIDE / 2), degrees, 1.0)
    warp[:, 2] += shift
    return np.asarray(cv2.warpAffine(patch, warp, (SIDE, SIDE), borderMode=cv2.BORDER_REFLECT))


@pytest.mark.parametrize("visible_share", [1.0, 0.6])
def test_a_patch_that_another_pose_shows_is_moved_back(visible_share: float) -> None:
    wall = make_wall()
    moved = turn(wall, 0.8, (6.3, -4.6))
    visible = np.ones(moved.shape, dtype=bool)
    visible[:, round(visible_share * SIDE) :] = False
    found = align_patch(wall, np.where(visible, moved, 0).astype(np.float32), 12.0, visible)
    part = np.s_[20:-20, 20 : round(visible_share * SIDE) - 20]
    assert np.corrcoef(move_patch(moved, found.warp)[part].ravel(), wall[part].ravel())[0, 1] > 0.97
    assert found.correlation > 0.2


@pytest.mark.parametrize("degrees", [8.0, 20.0, 30.0])
def test_no_corner_goes_further_than_a_pose_leaves(degrees: float) -> None:
    """A corner may go 3 cells and 5 % of the side beyond the translation: a turn of 20 degrees would be 39 cells."""
    wall = make_wall()
    turned = turn(wall, degrees, (0.0, 0.0))
    corners = np.array([[0, 0, 1], [SIDE, 0, 1], [0, SIDE, 1], [SIDE, SIDE, 1]]).T
    beyond = (align_patch(wall, turned, 12.0).warp - shift_patch(wall, turned, 12.0).warp) @ corners
    assert np.abs(beyond).max() <= 3 + 0.05 * SIDE


def test_patches_of_two_walls_do_not_correlate() -> None:
    assert align_patch(make_wall(0), make_wall(1), 6.0).correlation < 0.2
