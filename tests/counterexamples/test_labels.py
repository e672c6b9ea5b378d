"""Labels with one thing wrong: each is counted and told, or refused with what to do; none moves a box in silence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from facadelake.core.errors import InputDataError
from facadelake.detection.crosswalk import build_crosswalk
from facadelake.evaluation.detectors.labels.format import LabelFormat
from facadelake.evaluation.detectors.labels.labels import LabelledSet
from facadelake.evaluation.detectors.labels.open import open_labels

CROSSWALK = build_crosswalk({})
WIDTH, HEIGHT = 100, 80


def picture(path: Path, orientation: int = 1) -> None:
    """A grey photograph, stored as WIDTH x HEIGHT, that EXIF may turn."""
    path.parent.mkdir(parents=True, exist_ok=True)
    exif = Image.Exif()
    exif[274] = orientation
    Image.fromarray(np.full((HEIGHT, WIDTH, 3), 128, dtype=np.uint8)).save(path, exif=exif)


def yolo(folder: Path, *lines: str, orientation: int = 1, names: str = "names: [crack, spalling]\n") -> LabelledSet:
    picture(folder / "images" / "a.jpg", orientation)
    picture(folder / "images" / "sound.jpg")
    for name, text in (("a", "\n".join(lines)), ("sound", "")):
        file = folder / "labels" / f"{name}.txt"
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)
    (folder / "data.yaml").write_text(names)
    return open_labels(folder, CROSSWALK, label_format=LabelFormat.YOLO)


def coco(folder: Path, **changes: Any) -> Path:
    picture(folder / "a.jpg")
    content = {
        "images": [{"id": 1, "file_name": "a.jpg", "width": WIDTH, "height": HEIGHT}],
        "categories": [{"id": 1, "name": "crack"}],
        "annotations": [{"id": 1, "image_id": 1, "category_id": 1, "bbox": [10, 20, 30, 40]}],
        **changes,
    }
    file = folder / "labels.json"
    file.write_text(json.dumps({key: value for key, value in content.items() if value is not None}))
    return file


def voc(folder: Path, size: str, corners: str = "<xmin>11</xmin><ymin>21</ymin><xmax>40</xmax><ymax>60</ymax>") -> Path:
    picture(folder / "a.jpg")
    thing = f"<object><name>crack</name><bndbox>{corners}</bndbox></object>"
    (folder / "a.xml").write_text(f"<annotation><filename>a.jpg</filename>{size}{thing}</annotation>")
    return folder


def boxes(labelled: LabelledSet) -> list[tuple[float, float, float, float]]:
    return [
        (one.box.x_px, one.box.y_px, one.box.width_px, one.box.height_px)
        for image in labelled.images
        for one in image.boxes
    ]


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("0 0.5 0.5 0.2", "lines that are not a class and a box from 0 to 1"),
        ("0 250 150 40 30", "lines that are not a class and a box from 0 to 1"),
        ("0 0.5 0.5 nan 0.2", "lines that are not a class and a box from 0 to 1"),
        ("crack 0.5 0.5 0.2 0.2", "lines that are not a class and a box from 0 to 1"),
        ("0 0.5 0.5 0 0.2", "boxes without area"),
        ("0 0.5 0.5 -0.2 0.2", "boxes without area"),
        ("0 1.4 0.5 0.2 0.2", "boxes outside their photograph"),
        ("2 0.5 0.5 0.2 0.2", "boxes of class number 2 without a name (2 names)"),
        ("-1 0.5 0.5 0.2 0.2", "boxes of class number -1 without a name (2 names)"),
    ],
)
def test_a_yolo_line_out_of_range_is_counted_and_the_rest_counts(tmp_path: Path, line: str, why: str) -> None:
    labelled = yolo(tmp_path, line, "1 0.25 0.5 0.1 0.1")
    assert labelled.left_out == {why: 1}
    assert boxes(labelled) == [pytest.approx((20, 36, 10, 8))]


def test_a_yolo_box_beyond_the_border_is_cut_to_it(tmp_path: Path) -> None:
    assert boxes(yolo(tmp_path, "0 0.05 0.5 0.3 0.5")) == [pytest.approx((0, 20, 20, 40))]


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_yolo_labels_of_a_photograph_that_exif_turns_are_not_taken(tmp_path: Path, orientation: int) -> None:
    """Their shares are of the view that labelling tools show; nothing says whether this one turned it."""
    labelled = yolo(tmp_path, "0 0.2 0.2 0.2 0.2", orientation=orientation)
    assert [image.path.name for image in labelled.images] == ["sound.jpg"]
    assert labelled.left_out == {
        "photographs with an EXIF rotation (YOLO does not define the view of its coordinates; store them upright)": 1
    }


def test_names_that_skip_a_number_and_names_that_are_missing(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match=r"'names' has numbers \['0', '2'\]; they must be 0, 1, 2"):
        yolo(tmp_path, "0 0.5 0.5 0.2 0.2", names="names: {0: crack, 2: spalling}\n")
    with pytest.raises(InputDataError, match="no names of their class numbers"):
        yolo(tmp_path, "0 0.5 0.5 0.2 0.2", names="nc: 2\n")


@pytest.mark.parametrize("missing", ["categories", "images", "annotations"])
def test_a_coco_file_without_one_of_its_parts_names_it(tmp_path: Path, missing: str) -> None:
    file = coco(tmp_path, **{missing: None})
    with pytest.raises(InputDataError, match=missing):
        open_labels(file, CROSSWALK)


def test_coco_categories_that_none_of_the_boxes_has(tmp_path: Path) -> None:
    with_rust = coco(tmp_path, categories=[{"id": 1, "name": "rust"}])
    labelled = open_labels(with_rust, CROSSWALK)
    assert labelled.labelled == ()
    assert labelled.left_out == {"boxes of class 'rust', which has no defect class": 1}
    unnamed = open_labels(coco(tmp_path, categories=[]), CROSSWALK)
    assert unnamed.left_out == {"boxes of class 'category 1', which has no defect class": 1}


@pytest.mark.parametrize(
    "size",
    ["", "<size/>", "<size><width>0</width><height>0</height></size>", "<size><width>wide</width></size>"],
    ids=["none", "empty", "zero", "words"],
)
def test_voc_without_a_size_is_read_at_the_photographs(tmp_path: Path, size: str) -> None:
    labelled = open_labels(voc(tmp_path, size), CROSSWALK)
    assert boxes(labelled) == [(10, 20, 30, 40)]
    assert labelled.left_out == {}


def test_voc_of_the_turned_view_is_not_taken(tmp_path: Path) -> None:
    folder = voc(tmp_path, f"<size><width>{HEIGHT}</width><height>{WIDTH}</height></size>")
    with pytest.raises(InputDataError, match="1 photographs of another size than in the labels"):
        open_labels(folder, CROSSWALK)


def test_a_voc_file_that_would_blow_up_is_not_opened(tmp_path: Path) -> None:
    """Entities that stand for entities: a billion laughs."""
    voc(tmp_path, "")
    bomb = '<!DOCTYPE a [<!ENTITY b "ha"><!ENTITY c "&b;&b;&b;&b;">]><annotation><filename>&c;</filename></annotation>'
    (tmp_path / "bomb.xml").write_text(bomb)
    labelled = open_labels(tmp_path, CROSSWALK, label_format=LabelFormat.VOC)
    assert labelled.left_out == {"XML files that cannot be read": 1}


@pytest.mark.parametrize("mode", ["L", "RGBA", "CMYK", "I;16"])
def test_photographs_of_other_colours_keep_their_size(tmp_path: Path, mode: str) -> None:
    file = coco(tmp_path)
    values = np.full((HEIGHT, WIDTH), 40000, dtype=np.uint16)
    image = Image.fromarray(values) if mode == "I;16" else Image.new(mode, (WIDTH, HEIGHT))
    image.save(tmp_path / "a.tif")
    content = json.loads(file.read_text())
    content["images"][0]["file_name"] = "a.tif"
    file.write_text(json.dumps(content))
    labelled = open_labels(file, CROSSWALK)
    assert boxes(labelled) == [(10, 20, 30, 40)]
    decoded = cv2.imread(str(labelled.images[0].path), cv2.IMREAD_COLOR)
    assert decoded is not None and decoded.shape == (HEIGHT, WIDTH, 3)


def yolo_files(folder: Path, photographs: tuple[str, ...], labels: tuple[str, ...]) -> LabelledSet:
    """YOLO data with photographs and text files of these names, one box in each."""
    for name in photographs:
        picture(folder / name)
    for name in labels:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("0 0.5 0.5 0.2 0.2\n")
    (folder / "data.yaml").write_text("names: [crack]\n")
    return open_labels(folder, CROSSWALK, label_format=LabelFormat.YOLO)


@pytest.mark.parametrize(
    ("photograph", "label"),
    [
        ("images/IMG_1.JPG", "labels/img_1.txt"),
        ("Images/train/IMG_1.JPG", "labels/train/IMG_1.TXT"),
        ("train/images/a.b.jpg", "train/labels/a.b.txt"),
        ("a.jpg", "labels/a.txt"),
    ],
)
def test_yolo_labels_match_as_all_names_of_photographs_do(photograph: str, label: str, tmp_path: Path) -> None:
    """Paths were compared letter by letter: such a photograph counted as free of defects."""
    labelled = yolo_files(tmp_path, (photograph,), (label,))
    assert [len(image.boxes) for image in labelled.images] == [1]
    assert labelled.left_out == {}


def test_yolo_labels_that_several_photographs_match_are_not_taken_for_both(tmp_path: Path) -> None:
    labelled = yolo_files(tmp_path, ("images/a.jpg", "images/a.png", "images/b.jpg"), ("labels/a.txt", "labels/b.txt"))
    assert [image.key for image in labelled.images] == ["images/b.jpg"]
    assert labelled.left_out == {
        "photographs with several text files, or whose text file matches several photographs": 2
    }


def test_yolo_labels_beside_and_in_the_folder_of_labels_are_ambiguous(tmp_path: Path) -> None:
    labelled = yolo_files(tmp_path, ("images/a.jpg", "images/b.jpg"), ("labels/a.txt", "images/a.txt", "labels/b.txt"))
    assert [image.key for image in labelled.images] == ["images/b.jpg"]


def test_yolo_labels_of_no_photograph_are_counted(tmp_path: Path) -> None:
    labelled = yolo_files(tmp_path, ("images/a.jpg",), ("labels/a.txt", "labels/lost.txt"))
    (tmp_path / "README.txt").write_text("a data set\n")
    assert labelled.left_out == {"text files of labels whose photograph does not exist": 1}
