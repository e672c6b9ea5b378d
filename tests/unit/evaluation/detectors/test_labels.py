"""The same two photographs written as COCO, YOLO and VOC read the same; what is wrong is counted or refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from facadelake.core.errors import InputDataError
from facadelake.detection.crosswalk import build_crosswalk
from facadelake.evaluation.detectors.labels.format import LabelFormat
from facadelake.evaluation.detectors.labels.labels import (
    LabelledSet,
    combine_sets,
    open_sound_photographs,
    restrict_to_classes,
)
from facadelake.evaluation.detectors.labels.open import open_labels
from facadelake.evaluation.detectors.labels.sites import assign_scale, assign_sites
from tests.unit.evaluation.detectors.labelled import CRACK, MOISTURE, SPALLING, picture

CROSSWALK = build_crosswalk({})


def coco(folder: Path, annotations: list[dict[str, Any]] | None = None, images: str = "images", **more: Any) -> Path:
    """Two photographs: a crack at 10, 20 of 30 x 40 px, spalling at 50, 0 of 20 x 10 px; the other one is sound."""
    picture(folder / images / "a.jpg")
    picture(folder / images / "b.jpg")
    boxes = annotations or [
        {"id": 1, "image_id": 7, "category_id": 3, "bbox": [10, 20, 30, 40]},
        {"id": 2, "image_id": 7, "category_id": 5, "bbox": [50, 0, 20, 10]},
    ]
    content = {
        "images": [
            {"id": 7, "file_name": "a.jpg", "width": 100, "height": 80},
            {"id": 8, "file_name": "b.jpg", "width": 100, "height": 80},
        ],
        "categories": [{"id": 3, "name": "Crack"}, {"id": 5, "name": "spalling"}, {"id": 6, "name": "graffiti"}],
        "annotations": boxes,
        **more,
    }
    file = folder / "labels.json"
    file.write_text(json.dumps(content))
    return file


def yolo(folder: Path, lines: str = "0 0.25 0.5 0.3 0.5\n1 0.6 0.0625 0.2 0.125\n", beside: bool = False) -> Path:
    for name, text in (("a", lines), ("b", "")):
        picture(folder / ("" if beside else "images/test") / f"{name}.jpg")
        label = folder / ("" if beside else "labels/test") / f"{name}.txt"
        label.parent.mkdir(parents=True, exist_ok=True)
        label.write_text(text)
    (folder / "data.yaml").write_text("names: {0: crack, 1: spalling}\n")
    return folder


def voc(folder: Path, extra: str = "") -> Path:
    def thing(name: str, xmin: float, ymin: float, xmax: float, ymax: float, more: str = "") -> str:
        corners = f"<xmin>{xmin}</xmin><ymin>{ymin}</ymin><xmax>{xmax}</xmax><ymax>{ymax}</ymax>"
        return f"<object><name>{name}</name>{more}<bndbox>{corners}</bndbox></object>"

    # Pixels counted from 1, the last one included.
    both = thing("crack", 11, 21, 40, 60) + thing("spalling", 51, 1, 70, 10)
    for name, things in (("a", both + extra), ("b", "")):
        picture(folder / "JPEGImages" / f"{name}.jpg")
        file = folder / "Annotations" / f"{name}.xml"
        file.parent.mkdir(parents=True, exist_ok=True)
        size = "<size><width>100</width><height>80</height><depth>3</depth></size>"
        file.write_text(f"<annotation><filename>{name}.jpg</filename>{size}{things}</annotation>")
    return folder


def boxes_by_photograph(labelled: LabelledSet) -> list[tuple[str, list[tuple[str, float, float, float, float]]]]:
    return [
        (
            image.path.stem,
            [
                (str(one.defect_class), one.box.x_px, one.box.y_px, one.box.width_px, one.box.height_px)
                for one in image.boxes
            ],
        )
        for image in labelled.images
    ]


@pytest.mark.parametrize("form", ["coco", "yolo", "yolo beside", "voc"])
def test_every_form_reads_the_same(tmp_path: Path, form: str) -> None:
    folder = tmp_path / "walls"
    match form:
        case "coco":
            coco(folder)
        case "voc":
            voc(folder)
        case _:
            yolo(folder, beside=form == "yolo beside")
    labelled = open_labels(folder, CROSSWALK)
    (name_a, boxes), (name_b, none) = boxes_by_photograph(labelled)
    assert (labelled.name, labelled.label_format, name_a, name_b, none) == ("walls", form.split()[0], "a", "b", [])
    assert [one[0] for one in boxes] == ["crack", "spalling"]
    assert boxes[0][1:] == pytest.approx((10, 20, 30, 40), abs=1e-9)  # px
    assert boxes[1][1:] == pytest.approx((50, 0, 20, 10), abs=1e-9)
    assert labelled.labelled == (CRACK, SPALLING) and not labelled.left_out


def test_a_coco_file_in_annotations_finds_photographs_in_splits(tmp_path: Path) -> None:
    file = coco(tmp_path, images="images/test")
    (tmp_path / "annotations").mkdir()
    for split in ("train", "test"):
        (tmp_path / "annotations" / f"instances_{split}.json").write_text(file.read_text())
    file.unlink()
    with pytest.raises(InputDataError, match=r"has 2 COCO files .* --split"):
        open_labels(tmp_path, CROSSWALK)
    with pytest.raises(InputDataError, match=r"does not define the photographs of split 'val'"):
        open_labels(tmp_path / "annotations" / "instances_test.json", CROSSWALK, split="val")
    assert [image.key for image in open_labels(tmp_path, CROSSWALK, split="test").images] == [
        "images/test/a.jpg",
        "images/test/b.jpg",
    ]


def test_bad_annotations_are_counted(tmp_path: Path) -> None:
    (tmp_path / "broken.jpg").write_bytes(b"not a photograph")
    rest: dict[str, Any] = {"image_id": 7, "category_id": 3}
    file = coco(
        tmp_path,
        [
            {**rest, "id": 1, "bbox": [10, 20, 30]},
            {**rest, "id": 2, "bbox": [10, 20, 0, 5]},
            {**rest, "id": 3, "bbox": [200, 20, 10, 5]},
            {**rest, "id": 4, "bbox": [1, 2, 3, 4], "category_id": 6},
            {**rest, "id": 5, "bbox": [1, 2, 3, 4], "image_id": 99},
            {**rest, "id": 6, "bbox": [90, 70, 20, 20]},
            {**rest, "id": 7, "bbox": [5, 5, 20, 20], "iscrowd": 1},
            {**rest, "id": 8, "segmentation": [[10, 10, 20, 10, 20, 30]]},
        ],
        images="photographs",
    )
    content = json.loads(file.read_text())
    content["images"] += [
        {"id": 9, "file_name": "gone.jpg"},
        {"id": 10, "file_name": "broken.jpg"},
    ]
    content["images"][1]["width"] = 80  # b.jpg, turned
    file.write_text(json.dumps(content))
    labelled = open_labels(file, CROSSWALK)
    (image,) = labelled.images
    assert [(one.box.x_px, one.box.width_px, one.ignored) for one in image.boxes] == [
        (90, 10, False),  # cut to the photograph
        (5, 20, True),
        (10, 10, False),  # about its mask
    ]
    assert labelled.left_out == {
        "boxes that are not four numbers": 1,
        "boxes without area": 1,
        "boxes outside their photograph": 1,
        "boxes of class 'graffiti', which has no defect class": 1,
        "boxes of an image that is not in the file": 1,
        "photographs that do not exist, or whose name matches several": 1,
        "photographs that cannot be read": 1,
        "photographs of another size than in the labels (rotated or resized)": 1,
    }


def test_yolo_lines(tmp_path: Path) -> None:
    lines = (
        "0 0.1 0.1 0.9 0.1 0.5 0.6\n0 12 40 30 10\nx 0.5 0.5 0.1 0.1\n7 0.5 0.5 0.1 0.1\n1 0.5 0.5 0.1\n0 nan 0 0 0\n"
    )
    labelled = open_labels(yolo(tmp_path, lines), CROSSWALK)
    assert boxes_by_photograph(labelled)[0][1] == [
        ("crack", *(pytest.approx(v) for v in (10, 8, 80, 40)))
    ]  # a polygon's box
    assert labelled.left_out == {
        "lines that are not a class and a box from 0 to 1": 4,
        "boxes of class number 7 without a name (2 names)": 1,
    }


def test_yolo_needs_names_and_labels(tmp_path: Path) -> None:
    (yolo(tmp_path) / "data.yaml").unlink()
    with pytest.raises(InputDataError, match="--classes crack,spalling"):
        open_labels(tmp_path, CROSSWALK)
    renamed = open_labels(tmp_path, CROSSWALK, class_names=["damp", "rust"])
    assert renamed.labelled == (MOISTURE,)
    assert renamed.left_out == {"boxes of class 'rust', which has no defect class": 1}
    (tmp_path / "labels" / "test" / "b.txt").unlink()
    once = open_labels(tmp_path, CROSSWALK, class_names=["crack", "spalling"])
    assert len(once.images) == 2 and list(once.left_out.values()) == [1]
    (tmp_path / "labels" / "test" / "a.txt").unlink()
    with pytest.raises(InputDataError, match="no usable labelled photograph of format yolo"):
        open_labels(tmp_path, CROSSWALK, label_format=LabelFormat.YOLO, class_names=["crack"])


def test_voc_difficult_and_broken_files(tmp_path: Path) -> None:
    corners = "<bndbox><xmin>1</xmin><ymin>1</ymin><xmax>10</xmax><ymax>5</ymax></bndbox>"
    voc(
        tmp_path,
        f"<object><name>damp</name><difficult>1</difficult>{corners}</object><object><name>crack</name></object>",
    )
    (tmp_path / "Annotations" / "c.xml").write_text("<annotation><filename>a.jpg")
    (tmp_path / "Annotations" / "d.xml").write_text("<annotation><filename>gone.jpg</filename></annotation>")
    labelled = open_labels(tmp_path, CROSSWALK)
    assert [one.ignored for one in labelled.images[0].boxes] == [False, False, True]
    assert labelled.images[0].boxes[2].box.width_px == 10 and labelled.images[0].boxes[2].box.x_px == 0
    assert labelled.left_out == {
        "boxes that are not four numbers": 1,
        "XML files that cannot be read": 1,
        "photographs that do not exist, or whose name matches several": 1,
    }


def test_what_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match="does not exist"):
        open_labels(tmp_path / "none", CROSSWALK)
    picture(tmp_path / "walls" / "a.jpg")
    with pytest.raises(InputDataError, match="neither COCO nor YOLO nor VOC; choose with --format"):
        open_labels(tmp_path / "walls", CROSSWALK)
    with pytest.raises(InputDataError, match="only COCO labels"):
        open_labels(tmp_path / "walls" / "a.jpg", CROSSWALK)
    coco(tmp_path / "walls")
    voc(tmp_path / "walls")
    with pytest.raises(InputDataError, match="labels of coco and voc"):
        open_labels(tmp_path / "walls", CROSSWALK)
    assert open_labels(tmp_path / "walls", CROSSWALK, label_format=LabelFormat.VOC).label_format == "voc"


def test_the_hash_knows_boxes_and_sites(tmp_path: Path) -> None:
    file = coco(tmp_path)
    first = open_labels(file, CROSSWALK)
    assert first.sha256 == open_labels(file, CROSSWALK).sha256
    sites = tmp_path / "sites.csv"
    sites.write_text("image,site,split\na.jpg,north,test\n*,south,train\n")
    sited = assign_sites(first, sites)
    assert [image.site for image in sited.images] == ["north", "south"] and sited.sha256 != first.sha256
    coco(tmp_path, [{"id": 1, "image_id": 7, "category_id": 3, "bbox": [10, 20, 30, 41]}])
    assert open_labels(file, CROSSWALK).sha256 != first.sha256


def test_sites_and_splits(tmp_path: Path) -> None:
    labelled = open_labels(coco(tmp_path / "walls"), CROSSWALK)
    assert {image.site for image in assign_sites(labelled, None).images} == {None}
    sites = tmp_path / "sites.csv"
    sites.write_text("image,site,split\na.jpg,north,test\n")
    alone = assign_sites(labelled, sites, "test")
    assert [image.key for image in alone.images] == ["images/a.jpg"]
    assert alone.left_out == {"photographs that are not in the file of sites": 1}
    with pytest.raises(InputDataError, match="none of the 2 photographs of walls in split 'val'"):
        assign_sites(labelled, sites, "val")
    sites.write_text("image,place\na.jpg,north\n")
    with pytest.raises(InputDataError, match="no column site"):
        assign_sites(labelled, sites)
    by_yaml = tmp_path / "sites.yaml"
    by_yaml.write_text("walls:\n  north: {split: test, pictures: [a]}\n  south: {split: val, pictures: [images/b]}\n")
    assert [image.site for image in assign_sites(labelled, by_yaml, "val").images] == ["south"]
    by_yaml.write_text("roofs: {}\n")
    with pytest.raises(InputDataError, match="data folder 'walls'"):
        assign_sites(labelled, by_yaml)


def test_folders_are_sites_where_nobody_says(tmp_path: Path) -> None:
    for site in ("north", "south"):
        picture(tmp_path / site / "images" / "a.jpg")
        label = tmp_path / site / "labels" / "a.txt"
        label.parent.mkdir()
        label.write_text("0 0.5 0.5 0.1 0.1\n")
    (tmp_path / "classes.txt").write_text("crack\n")
    labelled = assign_sites(open_labels(tmp_path, CROSSWALK), None)
    assert [image.site for image in labelled.images] == ["north", "south"]


def test_sets_are_joined_under_their_names(tmp_path: Path) -> None:
    first = open_labels(coco(tmp_path / "one"), CROSSWALK)
    second = assign_sites(open_labels(voc(tmp_path / "two"), CROSSWALK), None)
    whole = combine_sets([first, second])
    assert whole.name == "one + two" and whole.label_format == "coco+voc"
    assert [image.key for image in whole.images] == [
        "one/images/a.jpg",
        "one/images/b.jpg",
        "two/JPEGImages/a.jpg",
        "two/JPEGImages/b.jpg",
    ]
    with pytest.raises(InputDataError, match="have the name 'one'"):
        combine_sets([first, first])


def test_scale(tmp_path: Path) -> None:
    labelled = open_labels(coco(tmp_path / "walls"), CROSSWALK)
    scale = tmp_path / "scale.csv"
    scale.write_text("image,gsd_mm,area_m2\na.jpg,5,\n*,,3.2\n")
    a, b = assign_scale(labelled.images, scale)
    assert a.area_m2 == pytest.approx(8000 * 25e-6) and a.gsd_mm == 5  # 100 x 80 px of 5 mm
    assert b.area_m2 == 3.2 and b.gsd_mm == pytest.approx(20.0)
    scale.write_text("image,gsd_mm\na.jpg,-5\n")
    with pytest.raises(InputDataError, match="'-5' is not a positive number"):
        assign_scale(labelled.images, scale)
    scale.write_text("image,gsd_mm\nz.jpg,5\n")
    with pytest.raises(InputDataError, match="lists none of the photographs"):
        assign_scale(labelled.images, scale)


def test_a_coco_file_that_lacks_a_key_is_refused(tmp_path: Path) -> None:
    file = coco(tmp_path / "walls")
    content = json.loads(file.read_text())
    del content["categories"]
    file.write_text(json.dumps(content))
    with pytest.raises(InputDataError, match=r"labels\.json has no key 'categories'"):
        open_labels(tmp_path / "walls", CROSSWALK)


def test_only_labelled_classes_are_evaluated(tmp_path: Path) -> None:
    alone = restrict_to_classes(open_labels(coco(tmp_path), CROSSWALK), frozenset({SPALLING}))
    assert alone.labelled == (SPALLING,)
    assert [one.defect_class for one in alone.images[0].boxes] == [SPALLING]


def test_patterns_fit_the_end_of_a_path_and_roboflow_names_their_photograph(tmp_path: Path) -> None:
    for name in ("a_png_jpg.rf.0a1b.jpg", "b_1_jpg.rf.0a1b.jpg"):
        picture(tmp_path / "walls" / "images" / name)
    found = open_sound_photographs(tmp_path / "walls")
    sites = tmp_path / "sites.csv"
    sites.write_text("image,site\na,north\nb_?_jpg*,south\n")
    assert [image.site for image in assign_sites(found, sites).images] == ["north", "south"]
