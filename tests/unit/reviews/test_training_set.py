"""A training set reads back with every reader as it was reviewed, pixel by pixel, split by building."""

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from PIL import Image
from pycocotools.coco import COCO

from facadelake.core.errors import InputDataError
from facadelake.core.tables import table_from_rows
from facadelake.detection.boxes import Box
from facadelake.detection.coco.import_detections import import_coco
from facadelake.detection.crosswalk import build_crosswalk
from facadelake.evaluation.detectors.labels.open import open_labels
from facadelake.evaluation.detectors.labels.sites import assign_sites
from facadelake.reviews.review_items import create_missed_review, create_review, list_review_items
from facadelake.reviews.review_matching import match_reviews
from facadelake.reviews.training.options import PictureMode, Split, TrainingLabelFormat, choose_split, parse_splits
from facadelake.reviews.training.training_set import TrainingSource, write_training_set
from schemas.vocabulary import Verdict
from tests.unit.reviews.made_reviews import CRACK, MOISTURE, PROVENANCE, box, seen

# Each place is painted in a colour of its own, on grey 200.
CONFIRMED, REJECTED, CORRECTED, UNKNOWN, MISSED = (
    box(300, 300, 80, 40), box(1200, 200, 60, 60), box(1200, 900, 100, 50), box(384, 320, 20, 20),
    box(1500, 1100, 90, 80),
)  # fmt: skip
COLOURS = {CONFIRMED: (0, 0, 255), REJECTED: (0, 255, 0), CORRECTED: (255, 0, 0), UNKNOWN: (255, 255, 0),
           MISSED: (0, 255, 255)}  # fmt: skip
GREY = 114


def photograph(path: Path) -> None:
    image = np.full((1200, 1600, 3), 200, dtype=np.uint8)
    for where, colour in COLOURS.items():
        x, y = int(where.x_px), int(where.y_px)
        image[y : y + int(where.height_px), x : x + int(where.width_px)] = colour
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), image)


def source(root: Path, building: str, split: Split, photo: str = "a/p0.png") -> TrainingSource:
    photograph(root / photo)
    moved = Box(x_px=CORRECTED.x_px - 9, y_px=CORRECTED.y_px, width_px=70, height_px=50)
    found = seen(
        (photo, "crack", CONFIRMED), (photo, "crack", REJECTED), (photo, "crack", moved), (photo, "crack", UNKNOWN)
    )
    places = {place.box: place for place in list_review_items(match_reviews((), found), {})}
    reviews = (
        create_review(places[CONFIRMED], Verdict.CONFIRMED, PROVENANCE),
        create_review(places[REJECTED], Verdict.REJECTED, PROVENANCE),
        create_review(places[moved], Verdict.CORRECTED, PROVENANCE, box=CORRECTED, defect_class=MOISTURE),
        create_missed_review(
            photo, MISSED, CRACK, PROVENANCE, mask="POLYGON ((1500 1100, 1590 1100, 1590 1180, 1500 1100))"
        ),
    )
    return TrainingSource(
        building_id=building, campaign_id="2026-04", run_id="run-1", version=3, root=root, split=split,
        status=match_reviews(reviews, found), detectors={"onnx:m": "a" * 64},
    )  # fmt: skip


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("sets")
    sources = [source(root / "one", "one", Split.TRAIN), source(root / "two", "two", Split.TEST)]
    for form in TrainingLabelFormat:
        write_training_set(sources, root / form, label_format=form, pictures=PictureMode.TILES, side_px=256)
    return root


def coloured(picture: np.ndarray, colour: tuple[int, int, int]) -> list[int]:
    """Left, top, width, height of what has nearly a colour (JPEG changes values a little)."""
    near = (np.abs(picture.astype(int) - colour).max(axis=2) < 60).astype(np.uint8)
    ys, xs = np.nonzero(near)
    return [] if not len(xs) else [xs.min(), ys.min(), xs.max() + 1 - xs.min(), ys.max() + 1 - ys.min()]


def test_boxes_lie_on_what_was_painted_there(sets: Path) -> None:
    """Read by pycocotools and OpenCV, none of our readers."""
    labels = COCO(str(sets / "coco" / "annotations" / "instances_train.json"))
    found = []
    for image in labels.loadImgs(labels.getImgIds()):
        picture = cv2.imread(str(sets / "coco" / "images" / image["file_name"]))
        assert picture.shape[:2] == (image["height"], image["width"])
        for one in labels.loadAnns(labels.getAnnIds(imgIds=[image["id"]])):
            name = labels.loadCats([one["category_id"]])[0]["name"]
            (where,) = [
                w
                for w in COLOURS
                if np.allclose(
                    [w.x_px - image["left_px"], w.y_px - image["top_px"], w.width_px, w.height_px],
                    one["bbox"],
                    rtol=0,
                    atol=0.01,
                )
            ]  # px
            np.testing.assert_allclose(coloured(picture, COLOURS[where]), one["bbox"], rtol=0, atol=2)  # px, JPEG
            found.append((name, where, bool(one["segmentation"])))
    assert sorted(found, key=str) == sorted(
        [("crack", CONFIRMED, False), ("moisture", CORRECTED, False), ("crack", MISSED, True)], key=str
    )


def test_rejected_place_is_a_picture_without_box_and_the_unreviewed_is_grey(sets: Path) -> None:
    content = json.loads((sets / "coco" / "annotations" / "instances_train.json").read_text())
    with_boxes = {one["image_id"] for one in content["annotations"]}
    (negative,) = [image for image in content["images"] if image["id"] not in with_boxes]
    picture = cv2.imread(str(sets / "coco" / "images" / negative["file_name"]))
    assert coloured(picture, COLOURS[REJECTED])[2:] == pytest.approx([60, 60], abs=2)  # px
    everything = [
        (image, cv2.imread(str(sets / "coco" / "images" / image["file_name"]))) for image in content["images"]
    ]
    assert all(not coloured(one, COLOURS[UNKNOWN]) for _, one in everything)
    at, hidden = next((image, one) for image, one in everything if coloured(one, COLOURS[CONFIRMED]))
    x, y = 394 - at["left_px"], 330 - at["top_px"]  # the centre of the unreviewed box
    assert 0 < x < at["width"]
    assert hidden[y, x] == pytest.approx(GREY, abs=6)


@pytest.mark.parametrize("form", list(TrainingLabelFormat))
def test_evaluation_reads_the_same_boxes_and_sites(sets: Path, form: TrainingLabelFormat) -> None:
    labelled = open_labels(sets / form, build_crosswalk({}), split="test")
    assert not labelled.left_out
    sited = assign_sites(labelled, sets / form / "sites.csv", "test")
    assert {image.site for image in sited.images} == {"two"}
    boxes = sorted((one.defect_class, *vars(one.box).values()) for image in sited.images for one in image.boxes)
    assert [name for name, *_ in boxes] == ["crack", "crack", "moisture"]
    sizes = sorted((round(b[3]), round(b[4])) for b in boxes)
    assert sizes == [(80, 40), (90, 80), (100, 50)]
    assert sum(not image.boxes for image in sited.images) == 1


def test_import_takes_it_as_detections(sets: Path) -> None:
    file = sets / "coco" / "annotations" / "instances_test.json"
    images = json.loads(file.read_text())["images"]
    photos = table_from_rows(
        "photos",
        [
            {"photo_id": image["file_name"], "sha256": "0" * 64, "bytes": 1, "photo_outcome": "accepted",
             "prior_source": "none", "prior_height_datum": "unknown", "image_width_px": image["width"],
             "image_height_px": image["height"]}
            for image in images
        ],
    )  # fmt: skip
    rows = import_coco(file, photos, class_names={}).to_pylist()
    assert [(row["detection_outcome"], row["reason"]) for row in rows] == [("accepted", None)] * 3
    masked = [row for row in rows if row["mask"]]
    assert [row["defect_class"] for row in masked] == ["crack"]


def test_yolo_lines_by_hand(sets: Path) -> None:
    content = yaml.safe_load((sets / "yolo" / "data.yaml").read_text())
    assert "path" not in content  # '.' would be a folder of the trainer's, not this one
    names = content["names"]
    assert names == {0: "crack", 1: "spalling", 2: "moisture"}
    lines = [
        (path, line.split())
        for path in (sets / "yolo" / "labels" / "train").glob("*.txt")
        for line in path.read_text().splitlines()
    ]
    found = []
    for path, (number, x, y, width, height) in lines:
        left, top, w, h = (int(word) for word in path.stem.split("_")[-4:])
        found.append((int(number), left + (float(x) - float(width) / 2) * w, top + (float(y) - float(height) / 2) * h,
                      float(width) * w, float(height) * h))  # fmt: skip
    wanted = [(0, *vars(CONFIRMED).values()), (0, *vars(MISSED).values()), (2, *vars(CORRECTED).values())]
    np.testing.assert_allclose(sorted(found), sorted(wanted), rtol=0, atol=0.001)  # px
    assert len(list((sets / "yolo" / "labels" / "train").glob("*.txt"))) == 4


def test_manifest_states_the_origin(sets: Path) -> None:
    manifest = json.loads((sets / "yolo" / "manifest.json").read_text())
    assert manifest["splits"]["train"] == {"pictures": 4, "negatives": 1, "crack": 2, "spalling": 0, "moisture": 1}
    assert manifest["splits"]["val"]["pictures"] == 0
    assert manifest["campaigns"][0]["detectors"] == {"onnx:m": "a" * 64}
    assert manifest["campaigns"][0]["reviews"] == {"confirmed": 1, "rejected": 1, "corrected": 1, "missed": 1}
    assert (manifest["campaigns"][1]["split"], manifest["campaigns"][1]["lake_version"]) == ("test", 3)
    assert "state its terms" in manifest["terms"]
    rows = list(csv.DictReader((sets / "yolo" / "sites.csv").open()))
    assert {(row["site"], row["split"]) for row in rows} == {("one", "train"), ("two", "test")}


def test_whole_photographs_only_where_everything_was_reviewed(tmp_path: Path) -> None:
    half = source(tmp_path / "p", "one", Split.TRAIN)
    with pytest.raises(InputDataError, match=r"1 photographs with detections without a review"):
        write_training_set(
            [half], tmp_path / "set", label_format=TrainingLabelFormat.COCO, pictures=PictureMode.COPY, side_px=256
        )
    assert not (tmp_path / "set").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["p"]
    found = seen(("a/p0.png", "crack", CONFIRMED))
    reviews = [
        create_review(place, Verdict.CONFIRMED, PROVENANCE) for place in list_review_items(match_reviews((), found), {})
    ]
    whole = TrainingSource(**{**vars(half), "status": match_reviews(reviews, found)})
    for kind in (PictureMode.COPY, PictureMode.LINK):
        folder = tmp_path / kind
        made = write_training_set([whole], folder, label_format=TrainingLabelFormat.YOLO, pictures=kind, side_px=256)
        (picture,) = made.pictures
        path = folder / "images" / picture.name
        assert path.is_symlink() == (kind is PictureMode.LINK)
        assert path.read_bytes() == (tmp_path / "p" / "a" / "p0.png").read_bytes()
    with pytest.raises(InputDataError, match="is not overwritten: give another folder"):
        write_training_set(
            [whole], tmp_path / "copy", label_format=TrainingLabelFormat.YOLO, pictures=PictureMode.COPY, side_px=256
        )


def test_whole_photographs_that_readers_would_rotate_are_left_out(tmp_path: Path) -> None:
    given = source(tmp_path / "p", "one", Split.TRAIN, photo="p0.jpg")
    found = seen(("p0.jpg", "crack", CONFIRMED))
    reviews = [
        create_review(place, Verdict.CONFIRMED, PROVENANCE) for place in list_review_items(match_reviews((), found), {})
    ]
    whole = TrainingSource(**{**vars(given), "status": match_reviews(reviews, found)})
    path = tmp_path / "p" / "p0.jpg"
    exif = Image.Exif()
    exif[0x0112] = 3  # upside down
    with Image.open(path) as image:
        image.save(path, exif=exif)
    with pytest.raises(InputDataError, match=r"1 photographs with an EXIF rotation"):
        write_training_set(
            [whole], tmp_path / "set", label_format=TrainingLabelFormat.YOLO, pictures=PictureMode.COPY, side_px=256
        )
    tiles = write_training_set(
        [whole], tmp_path / "set", label_format=TrainingLabelFormat.YOLO, pictures=PictureMode.TILES, side_px=256
    )
    assert len(tiles.pictures) == 1


def test_splits_are_the_buildings_own_and_near_their_shares() -> None:
    splits = [choose_split(f"building-{i}", {}) for i in range(2000)]
    assert splits == [choose_split(f"building-{i}", {}) for i in range(2000)]
    for split, share in ((Split.TRAIN, 0.70), (Split.VAL, 0.15), (Split.TEST, 0.15)):
        assert abs(splits.count(split) / 2000 - share) < 0.03
    assert choose_split("castle", parse_splits(("castle=test", "demo=val"))) is Split.TEST
    with pytest.raises(InputDataError, match=r"'castle=tset' is not BUILDING=SPLIT with a split of train, val, test"):
        parse_splits(("castle=tset",))
    with pytest.raises(InputDataError, match=r"assigns 'castle' to val and test; choose one"):
        parse_splits(("castle=val", "castle=test"))
