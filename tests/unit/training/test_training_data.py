"""The real sets: boxes in pixels, one site and one split per picture, evaluation pictures with complete boxes only."""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest

from facadelake.core.errors import FacadelakeError
from facadelake.reviews.training import Split
from training.data import evaluation_sets
from training.data.copies import COPY_MIN, find_similar_pairs
from training.data.cracks import read_omu_quays
from training.data.sample import CLASSES, Sample
from training.data.sites import SITES_PATH, read_sites

SETS = ("crack_boxes_640", "omu_quay_crack_yolo", "facade_negatives", "lund_street")


def test_every_set_has_sites_for_learning_and_for_judging() -> None:
    counts = {name: Counter(site.split for site in read_sites(name).values()) for name in SETS}
    assert sum(counts["crack_boxes_640"].values()) == 655
    assert 0.2 < counts["crack_boxes_640"][Split.TEST] / 655 < 0.3
    assert sum(counts["facade_negatives"].values()) == 70
    assert all({Split.TRAIN, Split.TEST} <= set(count) for count in counts.values())


def test_a_picture_in_two_sites_is_refused(tmp_path: Path) -> None:
    entry = "{split: %s, surface: wall, pictures: [a, b%s]}"
    path = tmp_path / "sites.yaml"
    path.write_text(f"some:\n  one: {entry % ('train', '')}\n  two: {entry % ('test', '2')}\n")
    with pytest.raises(FacadelakeError, match="a of some is in some/one and in some/two"):
        read_sites("some", path)


def test_an_unknown_set_is_named() -> None:
    with pytest.raises(FacadelakeError, match="no set 'nowhere'"):
        read_sites("nowhere", SITES_PATH)


def test_yolo_shares_become_pixels(tmp_path: Path) -> None:
    folder = tmp_path / "omu_quay_crack_yolo" / "BOX" / "k1"
    folder.mkdir(parents=True)
    stem = next(iter(read_sites("omu_quay_crack_yolo"))).removeprefix("k1/")
    (folder / f"{stem}.txt").write_text("0 0.5 0.25 0.5 0.125\n0 0.75 0.75 0.25 0.25\n")
    cv2.imwrite(str(folder / f"{stem}.JPG"), np.zeros((256, 256, 3), np.uint8))
    (sample,) = read_omu_quays(tmp_path)
    np.testing.assert_allclose(sample.boxes_px, [[64, 48, 192, 80], [160, 160, 224, 224]], rtol=0, atol=1e-9)  # px
    assert sample.site == "omu_quay_crack_yolo/k1"
    assert sample.split is Split.TRAIN


def test_holes_judge_only_where_every_bar_lies_in_one(tmp_path: Path) -> None:
    for folder in ("images", "labels"):
        (tmp_path / folder).mkdir()
    hole = "1 0.1 0.1 0.6 0.1 0.6 0.6 0.1 0.6"
    inside, outside = "0 0.2 0.2 0.3 0.2 0.3 0.5", "0 0.8 0.8 0.9 0.8 0.9 0.95"
    for name, lines in {"both": [hole, inside], "apart": [hole, outside], "bars": [inside]}.items():
        (tmp_path / "labels" / f"{name}.txt").write_text("\n".join(lines))
        cv2.imwrite(str(tmp_path / "images" / f"{name}.jpg"), np.zeros((100, 200, 3), np.uint8))
    (only,) = evaluation_sets.read_spalling_polygons(tmp_path)
    assert only.path.stem == "both"
    ((kind, box),) = only.boxes_px
    assert kind == CLASSES[1]
    np.testing.assert_allclose(box, [20, 10, 120, 60], rtol=0, atol=1e-9)  # px


def test_scales_agree_with_their_areas() -> None:
    rows = list(csv.DictReader(Path(evaluation_sets.__file__).with_name("facade_scale.csv").open()))
    held_out = {stem for stem, site in read_sites("facade_negatives").items() if site.split is Split.TEST}
    assert {row["image"].rstrip("*") for row in rows} == held_out
    for row in rows:
        metres = 1024 * float(row["gsd_mm"]) / 1000
        assert float(row["area_m2"]) == pytest.approx(float(row["facade_share"]) * metres**2, rel=0.02)


def test_a_changed_copy_across_splits_is_found(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    samples = []
    for number in range(6):
        image = np.full((300, 300), 150, dtype=np.uint8)
        for _ in range(3):
            cv2.polylines(image, [rng.integers(0, 300, (6, 2)).astype(np.int32)], False, 60, 4)
        if number == 5:  # a copy of the first one: mirrored, rotated, darker, noisy
            image = np.rot90(cv2.imread(str(tmp_path / "0.png"), cv2.IMREAD_GRAYSCALE)[:, ::-1])
            image = np.clip(image * 0.6 + rng.normal(0, 12, image.shape), 0, 255).astype(np.uint8)
        path = tmp_path / f"{number}.png"
        cv2.imwrite(str(path), image)
        split = Split.TEST if number == 5 else Split.TRAIN
        empty = np.zeros((0, 4)), np.zeros(0, dtype=np.int64)
        samples.append(Sample(path=path, boxes_px=empty[0], classes=empty[1], site=f"s/{number}", split=split))
    first, second = find_similar_pairs(samples, 2)
    assert (first.first.path.stem, first.second.path.stem) == ("0", "5")
    assert first.correlation > COPY_MIN
    assert second.correlation < 0.4
