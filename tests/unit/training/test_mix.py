"""Random examples: boxes lie on their defects after placement and augmentation."""

from __future__ import annotations

import cv2
import numpy as np

from training.colour import _add_noise, augment_image
from training.crackpath import trace_crack
from training.mix import Example, Mix, Pool, draw_placement
from training.transplant import transplant_cracks
from training.view import View

SIDE = 320


def _wall(seed: int, level: float = 180.0) -> np.ndarray:
    grain = np.random.default_rng(seed).normal(0, 3, (400, 400, 1))
    return np.clip(np.full((400, 400, 3), level) + grain, 0, 255).astype(np.uint8)


def _crack(seed: int) -> View:
    image = _wall(seed)
    rng = np.random.default_rng(seed)
    y = 200 + np.cumsum(rng.normal(0, 6, 21))
    points = np.column_stack([np.linspace(20, 380, 21), y]).round().astype(np.int32)
    cv2.polylines(image, [points], False, (40, 40, 40), 3)
    box = np.array([20, points[:, 1].min() - 5, 380, points[:, 1].max() + 5], dtype=np.float64)
    return View(image=image, boxes_px=box[None], classes=np.array([0]), paths=(trace_crack(image, box),))


def _pool(name: str, share: float, views: list[View]) -> Pool:
    return Pool(name=name, share=share, views=views, weights=np.full(len(views), 1 / len(views)))


def _empty(seed: int, level: float = 180.0) -> View:
    return View(image=_wall(seed, level), boxes_px=np.zeros((0, 4)), classes=np.zeros(0, np.int64), paths=())


WALLS = _pool("negatives", 0.3, [_empty(seed) for seed in range(20, 23)])
MIX = Mix(
    pools=[_pool("cracks", 0.7, [_crack(seed) for seed in range(4)]), WALLS],
    walls=WALLS,
    side_px=SIDE,
    transplant_share=0.2,
    mosaic_share=0.4,
)


def _darkest_inside(example: Example) -> list[bool]:
    """Whether the darkest line of each box is darker than the wall beside it: box by box."""
    grey = cv2.cvtColor(example.image, cv2.COLOR_BGR2GRAY)
    dark = cv2.morphologyEx(cv2.GaussianBlur(grey, (0, 0), 1), cv2.MORPH_BLACKHAT, np.ones((13, 13), np.uint8))
    verdicts = []
    for box in example.boxes_px.round().astype(int):
        inside = dark[box[1] : box[3], box[0] : box[2]]
        verdicts.append(bool(np.percentile(inside, 98) > 1.5 * np.percentile(dark, 50) + 2))
    return verdicts


def test_boxes_are_inside_and_on_cracks() -> None:
    rng = np.random.default_rng(1)
    verdicts: list[bool] = []
    for _ in range(60):
        example = MIX.draw_example(rng)
        assert example.image.shape == (SIDE, SIDE, 3) and example.image.dtype == np.uint8
        assert ((example.boxes_px >= 0) & (example.boxes_px <= SIDE)).all()
        assert len(example.boxes_px) == len(example.classes)
        verdicts += _darkest_inside(example)
    assert len(verdicts) > 40
    assert np.mean(verdicts) > 0.9  # the rest is lost in darkness, blur and noise


def test_examples_without_mosaic_hold_one_picture() -> None:
    rng = np.random.default_rng(2)
    assert max(len(MIX.draw_example(rng, mosaic_share=0.0).classes) for _ in range(40)) == 1
    assert max(len(MIX.draw_example(rng, mosaic_share=1.0).classes) for _ in range(40)) > 1


def test_moisture_is_never_rotated() -> None:
    view = View(image=_wall(0), boxes_px=np.array([[10.0, 20, 200, 300]]), classes=np.array([2]), paths=(None,))
    rng = np.random.default_rng(3)
    for _ in range(40):
        matrix = draw_placement(view, SIDE, SIDE, rng).input_from_image
        assert matrix[1, 1] > 0 and matrix[0, 1] == matrix[1, 0] == 0


def test_a_transplanted_crack_is_visible_on_the_other_wall() -> None:
    view = transplant_cracks(_crack(1), _wall(9, 120.0), np.random.default_rng(4))
    (path,) = view.paths
    assert path is not None
    columns, rows = path.points_px.round().astype(int).T
    grey = cv2.cvtColor(view.image, cv2.COLOR_BGR2GRAY).astype(float)
    assert np.median(grey) < 135  # the other wall
    assert np.median(grey[rows, columns]) < 0.75 * np.median(grey)  # its crack


def test_no_crack_is_transplanted_where_it_would_be_invisible() -> None:
    view = _crack(1)
    assert transplant_cracks(view, _wall(9, 8.0), np.random.default_rng(4)) is view


def test_augmentation_keeps_the_size_and_never_repeats() -> None:
    rng = np.random.default_rng(5)
    wall = _wall(0)
    made = [augment_image(wall, rng) for _ in range(30)]
    assert {image.shape for image in made} == {wall.shape} and {image.dtype for image in made} == {wall.dtype}
    assert len({image.tobytes() for image in made}) == 30


def test_noise_is_in_every_channel() -> None:
    grey = np.full((200, 200, 3), 128, np.uint8)
    rng = np.random.default_rng(6)
    for _ in range(8):
        assert (_add_noise(grey, rng).std(axis=(0, 1)) > 0.6).all()  # grey levels; 1 to 9 are put in
