from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from facadelake.reporting.elevations.marks import DefectMark
from facadelake.reporting.history.draw import create_track_marks
from facadelake.reporting.history.pairs import Pair, PairRequest, PosedPhotographs, write_pairs
from tests.unit.reporting.history.painted_history import ORIGIN, make_table, make_wall_defect
from tests.unit.reporting.painted_wall import PAINT_PX_PER_M, PaintedWall, render_photograph

PLACE = (4.3, 2.0)  # m along the wall and up
SHIFT_M = np.array([0.03, 0.0, 0.02])  # of the later campaign's frame


def add_texture(paint: np.ndarray) -> np.ndarray:
    """The painting with plaster, by which pictures can be aligned."""
    noise = cv2.GaussianBlur(np.random.default_rng(1).normal(size=paint.shape[:2]), (0, 0), 1.5)
    return np.asarray(paint + 80 * noise[..., None])


@pytest.fixture(scope="module")
def campaigns(
    painted: PaintedWall, tmp_path_factory: pytest.TempPathFactory
) -> tuple[PosedPhotographs, PosedPhotographs]:
    """Two campaigns of the wall: the later one darker, with a black spot of 20 cm at PLACE, poses off by SHIFT_M."""
    sources = []
    for campaign, gain in (("2025", 1.0), ("2026", 0.7)):
        root = tmp_path_factory.mktemp(campaign)
        paint = add_texture(painted.paint)
        if campaign == "2026":
            centre = (round(PLACE[0] * PAINT_PX_PER_M), round((4.0 - PLACE[1]) * PAINT_PX_PER_M))
            cv2.circle(paint, centre, 10, (10, 10, 10), cv2.FILLED)
        for name, pose in painted.posed.items():
            shot = np.clip(gain * render_photograph(pose, paint) + 0.5, 0, 255).astype(np.uint8)
            cv2.imwrite(str(root / name), shot[..., ::-1])
        shift = SHIFT_M if campaign == "2026" else np.zeros(3)
        posed = {
            name: replace(
                pose, site_from_cam=replace(pose.site_from_cam, translation=pose.site_from_cam.translation + shift)
            )
            for name, pose in painted.posed.items()
        }
        sources.append(PosedPhotographs(campaign_id=campaign, posed=posed, root=root))
    return sources[0], sources[1]


def make_mark() -> DefectMark:
    table = make_table("defects", [make_wall_defect("D1", PLACE, width_m=0.25, height_m=0.25)])
    return create_track_marks(table.to_pylist(), ["wall-0001"], ORIGIN)["wall-0001"]


def draw(
    painted: PaintedWall, sources: tuple[PosedPhotographs, PosedPhotographs], folder: Path, offset_m: np.ndarray
) -> Pair:
    request = PairRequest(
        track_id="wall-0001", mark=make_mark(), photo_ids=("a.png", "b.png"), in_later=False, offset_m=offset_m
    )
    return write_pairs([request], sources[0], sources[1], painted.surface, folder, cells_max=300)["wall-0001"]


def find_colour(path: Path | None, colour: str) -> np.ndarray:
    """Mask of the pixels that are nearly of a colour."""
    picture = cv2.imread(str(path))[..., ::-1].astype(int)
    wanted = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    return np.asarray(np.abs(picture - wanted).max(axis=2) < 60)


@pytest.mark.parametrize("left_m", [0.0, 0.01])  # what the offset of the frames leaves at this place
def test_a_pair_has_one_size_is_aligned_and_shows_what_changed(
    painted: PaintedWall, campaigns: tuple[PosedPhotographs, PosedPhotographs], tmp_path: Path, left_m: float
) -> None:
    pair = draw(painted, campaigns, tmp_path, SHIFT_M + left_m * np.array([1.0, 0.0, -1.0]))
    pictures = [cv2.imread(str(path)) for path in (pair.before, pair.after, pair.difference)]
    assert len({picture.shape for picture in pictures}) == 1
    cells = pictures[0].shape[0]
    assert pair.cell_m * cells == pytest.approx(pair.side_m, rel=0, abs=1e-9)  # m
    before, after = (cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY).astype(float) for picture in pictures[:2])
    y, x = np.mgrid[0:cells, 0:cells]
    radius_m = np.hypot(x - cells / 2, y - cells / 2) * pair.cell_m
    around = (radius_m > 0.14) & (np.maximum(abs(x - cells / 2), abs(y - cells / 2)) * pair.cell_m < 0.18)
    assert np.corrcoef(before[around], after[around])[0, 1] > 0.95
    darker = find_colour(pair.difference, "#d55e00")
    assert darker[radius_m < 0.08].mean() > 0.15
    assert darker[around].mean() < 0.02  # the darker light of the later campaign is no difference
    assert pair.remarks == ()
    assert pair.photo_ids[0] in ("a.png", "b.png")


def test_missing_photographs_are_told_for_the_pair(
    painted: PaintedWall, campaigns: tuple[PosedPhotographs, PosedPhotographs], tmp_path: Path
) -> None:
    (tmp_path / "empty").mkdir()
    gone = replace(campaigns[1], root=tmp_path / "empty")
    pair = draw(painted, (campaigns[0], gone), tmp_path, SHIFT_M)
    assert pair.before is not None
    assert (pair.after, pair.difference) == (None, None)
    assert pair.remarks == (
        "no picture of 2026: the photographs that show the place are not there or cannot be read "
        f"(b.png, a.png in {gone.root})",
    )
    away = replace(campaigns[1], root=tmp_path / "away")
    pair = draw(painted, (campaigns[0], away), tmp_path, SHIFT_M)
    assert (pair.after, pair.difference) == (None, None)
    assert pair.remarks == (f"no picture of 2026: the folder of its photographs, {away.root}, is not there",)


def test_a_place_that_no_photograph_shows_is_told(
    painted: PaintedWall, campaigns: tuple[PosedPhotographs, PosedPhotographs], tmp_path: Path
) -> None:
    blind = replace(campaigns[1], posed={})
    pair = draw(painted, (campaigns[0], blind), tmp_path, SHIFT_M)
    assert pair.remarks == ("no photograph of 2026 shows the place",)
    assert pair.photo_ids[1] is None


def test_pictures_of_different_things_have_no_difference(
    painted: PaintedWall, campaigns: tuple[PosedPhotographs, PosedPhotographs], tmp_path: Path
) -> None:
    for name in painted.posed:
        curtain = np.zeros((700, 1000, 3), dtype=np.uint8)
        curtain[:, ::40] = 255
        cv2.imwrite(str(tmp_path / name), curtain)
    pair = draw(painted, (campaigns[0], replace(campaigns[1], root=tmp_path)), tmp_path, SHIFT_M)
    assert pair.after is not None
    assert pair.difference is None
    assert pair.remarks == (
        "the two pictures do not resemble each other, so they are not aligned and have no difference",
    )
