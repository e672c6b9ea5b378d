"""Generated pictures: they depend on the seed alone, boxes contain the defects, sound surfaces have no boxes."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from training.generate import cracks, moisture
from training.generate.backgrounds import Backgrounds
from training.generate.bars import Bars
from training.generate.brickwork import Brick, lay_wall
from training.generate.canvas import Canvas, Place
from training.generate.folder import read_pictures
from training.generate.picture import find_place, make_picture
from training.generate.spalling import paint_spalling
from training.generate.surfaces import Background, generate_bricks, generate_plaster

SIDE = 192


@pytest.fixture(scope="module")
def backgrounds() -> Backgrounds:
    rng = np.random.default_rng(5)
    return Backgrounds(close=(), facades=(), synthetic=(generate_plaster(rng), generate_bricks(rng)), bricks=())


def _canvas(seed: int = 0, level: float = 0.3) -> Canvas:
    return Canvas(
        image=np.full((SIDE, SIDE, 3), level, dtype=np.float32),
        free=np.ones((SIDE, SIDE), dtype=np.float32),
        rng=np.random.default_rng(seed),
        light=np.array([0.6, -0.8]),
    )


def test_a_patch_larger_than_the_picture_has_no_place_in_it() -> None:
    canvas = _canvas()
    assert find_place(canvas, (SIDE // 2, SIDE + 1), [], outside=0) is None
    place = find_place(canvas, (SIDE // 2, SIDE + 20), [], outside=0.4)
    assert place is not None
    shown = (place.window[3] - place.window[2]) / 2 * (SIDE + 20)
    assert abs(shown - place.width) < 2  # px: the window is the visible part


def test_the_picture_depends_on_the_seed_alone(backgrounds: Backgrounds) -> None:
    first, again, other = (make_picture(backgrounds, seed, side_px=SIDE) for seed in (11, 11, 12))
    assert np.array_equal(first.image, again.image)
    assert np.array_equal(first.boxes_px, again.boxes_px)
    assert not np.array_equal(first.image, other.image)


def test_all_classes_occur_and_boxes_are_inside_the_picture(backgrounds: Backgrounds) -> None:
    pictures = [make_picture(backgrounds, seed, side_px=SIDE) for seed in range(60)]
    boxes = np.concatenate([picture.boxes_px for picture in pictures])
    counts = np.bincount(np.concatenate([picture.classes for picture in pictures]), minlength=3)
    assert (counts >= 4).all()
    assert any(len(picture.classes) == 0 for picture in pictures)
    assert boxes.min() >= 0
    assert boxes.max() <= SIDE
    assert (boxes[:, 2:] - boxes[:, :2] >= 8).all()  # px


def test_a_crack_in_a_picture_lies_in_its_box() -> None:
    smooth = np.full((640, 640, 3), 170, dtype=np.uint8)
    background = Background(image=smooth, free=np.full((640, 640), 255, dtype=np.uint8), kind="plaster")
    only = Backgrounds(close=(), facades=(), synthetic=(background,), bricks=())
    seen = 0
    for seed in range(200):
        picture = make_picture(only, seed, side_px=SIDE)
        if picture.classes.tolist() != [0] or seen == 8:
            continue
        grey = cv2.cvtColor(picture.image, cv2.COLOR_BGR2GRAY)
        dark = cv2.morphologyEx(grey, cv2.MORPH_BLACKHAT, np.ones((15, 15), np.uint8))
        x0, y0, x1, y1 = picture.boxes_px[0].round().astype(int)
        seen += int(np.percentile(dark[y0:y1, x0:x1], 99.5) > 15)  # grey levels
    assert seen == 8


def test_fractal_lines_keep_their_ends() -> None:
    start, end = np.array([5.0, 10.0]), np.array([180.0, 90.0])
    path = cracks.generate_fractal_line(np.random.default_rng(1), start, end, 0.05)
    assert path[0].tolist() == start.tolist()
    assert path[-1].tolist() == end.tolist()
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() < 12  # px: dense enough for a continuous line


def test_stepped_cracks_run_along_joints() -> None:
    width, height, corner = 40.0, 15.0, (7.0, 4.0)
    path = cracks.generate_stepped_line(np.random.default_rng(3), corner, (width, height), SIDE)
    row = (path[:, 1] - corner[1]) / height
    to_bed = np.abs(row - np.round(row)) * height
    to_head = np.array(
        [
            min(abs((x - corner[0]) / width + 0.5 * parity - round((x - corner[0]) / width + 0.5 * parity)) * width
                for parity in (0, 1))
            for x in path[:, 0]
        ]
    )  # fmt: skip
    assert np.minimum(to_bed, to_head).max() < 3  # px off any joint


def test_spalling_changes_little_outside_the_hole() -> None:
    canvas = _canvas(4)
    before = canvas.image.copy()
    place = Place(y=30, x=20, height=120, width=140, window=(-1, 1, -1, 1))
    lost = paint_spalling(
        canvas, place, bars=(Bars(upright=True, count=2, thick_px=6, apart_px=30, lean=0.0),), beneath=None
    )
    change = np.abs(canvas.image - before).mean(axis=2)
    inside = np.zeros((SIDE, SIDE), dtype=bool)
    inside[30:150, 20:160] = lost
    assert 0.05 < lost.mean() < 0.8
    assert change[inside].mean() > 4 * change[~inside].mean()
    assert (change[:30].max(), change[150:].max()) == (0, 0)


@pytest.mark.parametrize("paint", [moisture.paint_damp_patch, moisture.paint_rising_damp])
def test_damp_keeps_the_texture(paint: object) -> None:
    canvas = _canvas(6)
    canvas.image[:] *= (1 + 0.2 * np.sin(np.arange(SIDE) * 1.3))[None, :, None].astype(np.float32)
    before = canvas.image.copy()
    place = Place(y=20, x=20, height=150, width=150, window=(-1, 1, -1, 1))
    wet = paint(canvas, place)  # type: ignore[operator]
    assert wet.any()
    rows, columns = np.nonzero(wet)
    was = before[20:170, 20:170][rows, columns].mean(axis=1)
    now = canvas.image[20:170, 20:170][rows, columns].mean(axis=1)
    assert now.mean() < 0.9 * was.mean()
    assert np.corrcoef(was, now)[0, 1] > 0.3


def test_a_composed_wall_boxes_only_damaged_bricks() -> None:
    sound = Brick(image=np.full((50, 100, 3), 90, dtype=np.uint8), index=None)
    spalled = Brick(image=np.full((50, 100, 3), 230, dtype=np.uint8), index=1)
    found = 0
    for seed in range(12):
        wall, boxes, classes = lay_wall(np.random.default_rng(seed), (sound, spalled), SIDE)
        assert set(classes) <= {1}
        bright = (wall.mean(axis=2) > 180).astype(np.uint8)
        for x0, y0, x1, y1 in np.array(boxes).astype(int).reshape(-1, 4):
            assert bright[y0:y1, x0:x1].mean() > 0.95
            found += 1
    assert found >= 5


def test_a_folder_of_pictures_is_read(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    cv2.imwrite(str(tmp_path / "images" / "a.jpg"), np.zeros((20, 20, 3), np.uint8))
    coco = {
        "images": [{"id": 3, "file_name": "a.jpg", "width": 20, "height": 20}],
        "annotations": [{"id": 0, "image_id": 3, "category_id": 2, "bbox": [1, 2, 5, 6], "area": 30, "iscrowd": 0}],
        "categories": [],
    }
    (tmp_path / "coco.json").write_text(json.dumps(coco))
    (sample,) = read_pictures(tmp_path)
    assert sample.boxes_px.tolist() == [[1, 2, 6, 8]]
    assert sample.classes.tolist() == [2]
    assert sample.read().shape == (20, 20, 3)
