"""A reviewer's changes to the boxes of a task become reviews, whatever the tool kept of ids and attributes."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from facadelake.core.errors import InputDataError
from facadelake.detection.coco import StoredImage
from facadelake.detection.crosswalk import build_crosswalk
from facadelake.reviews.coco_import import read_coco_reviews
from facadelake.reviews.csv_import import read_csv_reviews
from facadelake.reviews.review import reviews_from_table, select_current_reviews, table_from_reviews
from facadelake.reviews.review_items import ReviewItem, create_review, list_review_items
from facadelake.reviews.review_matching import match_reviews
from facadelake.reviews.task_files import ReviewTask, build_coco_task, format_defects_csv, read_task, write_task
from facadelake.reviews.training.reviewed_photographs import collect_reviewed_photographs
from facadelake.reviews.training.tiles import place_tiles
from schemas.vocabulary import Verdict
from tests.unit.reviews.made_reviews import CRACK, MOISTURE, PROVENANCE, SIZES, SPALLING, box, seen, unreviewed

FOUND = (
    ("p0.jpg", "crack", box(100, 100)),
    ("p0.jpg", "spalling", box(400, 100)),
    ("p0.jpg", "crack", box(100, 500)),
    ("p1.jpg", "moisture", box(50, 50, 300, 300)),
)
SHOWN = unreviewed(*FOUND)
NAMES = build_crosswalk({})
PHOTOGRAPHS = {name: StoredImage(width_px=width, height_px=height) for name, (width, height) in SIZES.items()}


def task() -> ReviewTask:
    return ReviewTask(building_id="tower", campaign_id="2026-04", run_id="run-1", photographs=tuple(SIZES), items=SHOWN)


def exported() -> dict[str, Any]:
    content: dict[str, Any] = json.loads(json.dumps(build_coco_task(task(), SIZES, photographs_uri="photos")))
    return content


def as_cvat(content: dict[str, Any]) -> dict[str, Any]:
    """What CVAT writes of a file: new numbers, no attributes of ours, no info, a segmentation that is the box."""
    for number, entry in enumerate(reversed(content["annotations"]), start=1000):
        entry |= {"id": number, "attributes": {"occluded": False, "rotation": 0.0}}
        del entry["score"]
    return {name: content[name] for name in ("images", "categories", "annotations")}


def save(path: Path, content: dict[str, Any]) -> Path:
    path.write_text(json.dumps(content))
    return path


@pytest.fixture
def corrected(tmp_path: Path) -> Path:
    """The first box left, the second made moisture and widened, the third deleted, one drawn; p1 not reviewed."""
    content = exported()
    entries = content["annotations"]
    second = next(entry for entry in entries if entry["bbox"][0] == 400.0)
    second |= {"category_id": 3, "bbox": [390.0, 95.0, 130.0, 60.0]}
    entries.remove(next(entry for entry in entries if entry["bbox"][1] == 500.0))
    entries.append({"id": 99, "image_id": 1, "category_id": 1, "bbox": [900.0, 900.0, 50.0, 20.0], "score": 1.0})
    content["images"] = content["images"][:1]
    content["annotations"] = [entry for entry in entries if entry["image_id"] == 1]
    return save(tmp_path / "corrected.json", as_cvat(content))


def test_kept_moved_deleted_and_drawn_boxes(corrected: Path) -> None:
    parsed = read_coco_reviews(corrected, SHOWN, PHOTOGRAPHS, NAMES, PROVENANCE, deletions_count=True)
    assert parsed.remarks == ()
    by_verdict = {review.verdict: review for review in parsed.reviews}
    assert len(by_verdict) == len(parsed.reviews) == 4
    assert (by_verdict[Verdict.CONFIRMED].box, by_verdict[Verdict.CONFIRMED].defect_class) == (box(100, 100), CRACK)
    changed = by_verdict[Verdict.CORRECTED]
    assert (changed.box, changed.defect_class) == (box(390, 95, 130, 60), MOISTURE)
    assert (changed.reviewed_box, changed.reviewed_class, changed.detection_id) == (box(400, 100), SPALLING, "p0.jpg#2")
    gone = by_verdict[Verdict.REJECTED]
    assert (gone.box, gone.defect_class, gone.reviewed_box, gone.reviewed_class) == (None, None, box(100, 500), CRACK)
    new = by_verdict[Verdict.MISSED]
    assert (new.box, new.defect_class, new.reviewed_box, new.detection_id) == (box(900, 900, 50, 20), CRACK, None, None)
    assert {review.photo_id for review in parsed.reviews} == {"p0.jpg"}


def test_without_the_task_a_missing_box_says_nothing(corrected: Path) -> None:
    parsed = read_coco_reviews(corrected, SHOWN, PHOTOGRAPHS, NAMES, PROVENANCE, deletions_count=False)
    assert Counter(review.verdict for review in parsed.reviews) == {
        Verdict.CONFIRMED: 1, Verdict.CORRECTED: 1, Verdict.MISSED: 1,
    }  # fmt: skip


def test_attribute_that_came_back_decides_where_boxes_do_not(tmp_path: Path) -> None:
    content = exported()
    one = next(entry for entry in content["annotations"] if entry["bbox"][1] == 500.0)
    one["bbox"] = [1000.0, 500.0, 100.0, 40.0]  # dragged far away
    kept = read_coco_reviews(
        save(tmp_path / "a.json", content), SHOWN, PHOTOGRAPHS, NAMES, PROVENANCE, deletions_count=True
    )
    assert Counter(review.verdict for review in kept.reviews) == {Verdict.CONFIRMED: 3, Verdict.CORRECTED: 1}
    bare = read_coco_reviews(
        save(tmp_path / "b.json", as_cvat(content)), SHOWN, PHOTOGRAPHS, NAMES, PROVENANCE, deletions_count=True
    )
    assert Counter(review.verdict for review in bare.reviews) == {
        Verdict.CONFIRMED: 3, Verdict.REJECTED: 1, Verdict.MISSED: 1,
    }  # fmt: skip


def test_mask_drawn_into_a_box_is_a_correction_and_comes_back_as_it_was(tmp_path: Path) -> None:
    content = exported()
    one = next(entry for entry in content["annotations"] if entry["bbox"][0] == 50.0)
    one["segmentation"] = [[50.0, 50.0, 350.0, 50.0, 50.0, 350.0]]
    parsed = read_coco_reviews(
        save(tmp_path / "a.json", content), SHOWN, PHOTOGRAPHS, NAMES, PROVENANCE, deletions_count=True
    )
    (changed,) = [review for review in parsed.reviews if review.verdict is Verdict.CORRECTED]
    assert changed.mask is not None
    assert changed.mask.startswith("POLYGON")
    shown = list_review_items(match_reviews(parsed.reviews, seen(*FOUND)), {})
    again = ReviewTask(
        building_id="tower", campaign_id="2026-04", run_id="run-1", photographs=tuple(SIZES), items=shown
    )
    path = save(tmp_path / "b.json", build_coco_task(again, SIZES, photographs_uri="photos"))
    assert read_task(path).items == shown
    same = read_coco_reviews(path, shown, PHOTOGRAPHS, NAMES, PROVENANCE, deletions_count=True)
    assert {review.verdict for review in same.reviews} == {Verdict.CONFIRMED}


def test_mask_whose_rings_cross_stops_neither_reviews_nor_tiles(tmp_path: Path) -> None:
    """Masks are kept to a hundredth of a pixel, which can make thin ones cross themselves."""
    crossing = "POLYGON ((50 50, 350 350, 350 50, 50 350, 50 50))"
    found = tuple(replace(one, mask=crossing) if one.photo_id == "p1.jpg" else one for one in seen(*FOUND))
    shown = list_review_items(match_reviews((), found), {})
    given = ReviewTask(
        building_id="tower", campaign_id="2026-04", run_id="run-1", photographs=tuple(SIZES), items=shown
    )
    path = save(tmp_path / "a.json", build_coco_task(given, SIZES, photographs_uri="photos"))
    parsed = read_coco_reviews(path, shown, PHOTOGRAPHS, NAMES, PROVENANCE, deletions_count=True)
    assert {review.verdict for review in parsed.reviews} == {Verdict.CONFIRMED}
    (material,) = (
        one for one in collect_reviewed_photographs(match_reviews(parsed.reviews, found)) if one.photo_id == "p1.jpg"
    )
    (tile,) = place_tiles(material, image_width_px=1600, image_height_px=1200, side_px=512)
    assert tile.defects[0].mask is not None
    assert tile.defects[0].mask.area == pytest.approx(45000.0, rel=0, abs=1.0)  # px2: two triangles


def test_what_cannot_be_used_is_a_remark_and_the_rest_counts(tmp_path: Path) -> None:
    content = exported()
    content["categories"].append({"id": 9, "name": "graffiti"})
    bad = [
        {"id": 90, "image_id": 1, "category_id": 9, "bbox": [1, 1, 5, 5]},
        {"id": 91, "image_id": 1, "category_id": 1, "bbox": [1, 1, 5]},
        {"id": 92, "image_id": 1, "category_id": 1, "bbox": [2000, 1, 5, 5]},
        {"id": 93, "image_id": 7, "category_id": 1, "bbox": [1, 1, 5, 5]},
    ]
    content["annotations"] += bad
    parsed = read_coco_reviews(
        save(tmp_path / "a.json", content), SHOWN, PHOTOGRAPHS, NAMES, PROVENANCE, deletions_count=True
    )
    assert Counter(review.verdict for review in parsed.reviews) == {Verdict.CONFIRMED: 4}
    wanted = ("graffiti", "must be [x, y, width, height]", "outside the photograph", "none of the campaign's")
    assert len(parsed.remarks) == 4
    for remark, part in zip(parsed.remarks, wanted, strict=True):
        assert part in remark


def test_file_of_another_campaign_is_refused(tmp_path: Path, corrected: Path) -> None:
    with pytest.raises(InputDataError, match=r"none of its 1 images is a photograph of this campaign in its size"):
        read_coco_reviews(
            corrected, (), {"q.jpg": StoredImage(width_px=10, height_px=10)}, NAMES, PROVENANCE, deletions_count=True
        )
    with pytest.raises(InputDataError, match=r"is not a task of 'facadelake review export-task'"):
        read_task(corrected)


def test_photograph_of_another_size_was_not_reviewed(tmp_path: Path) -> None:
    content = exported()
    content["images"][0] |= {"width": 800, "height": 600}
    for entry in content["annotations"]:
        if entry["image_id"] == 1:
            entry["bbox"] = [value / 2 for value in entry["bbox"]]
    path = save(tmp_path / "a.json", as_cvat(content))
    parsed = read_coco_reviews(path, SHOWN, PHOTOGRAPHS, NAMES, PROVENANCE, deletions_count=True)
    assert [review.photo_id for review in parsed.reviews] == ["p1.jpg"]
    (remark,) = parsed.remarks
    assert (
        "p0.jpg counts as not reviewed: the file states an image of 800 x 600 px, the photograph has 1600 x 1200 px"
        in remark
    )
    content["images"].pop()
    with pytest.raises(InputDataError, match=r"in its size \(p0\.jpg counts as not reviewed: .* 800 x 600 px"):
        read_coco_reviews(save(path, content), SHOWN, PHOTOGRAPHS, NAMES, PROVENANCE, deletions_count=True)


def test_rejected_place_drawn_again_is_confirmed_and_left_away_stays(tmp_path: Path) -> None:
    rejected = [create_review(place, Verdict.REJECTED, PROVENANCE) for place in SHOWN]
    places = list_review_items(match_reviews(rejected, seen(*FOUND)), {})
    content = exported()
    content["annotations"] = content["annotations"][:1]
    path = save(tmp_path / "a.json", as_cvat(content))
    (review,) = read_coco_reviews(path, places, PHOTOGRAPHS, NAMES, PROVENANCE, deletions_count=True).reviews
    assert (review.subject, review.verdict, review.box) == (SHOWN[0].subject, Verdict.CONFIRMED, SHOWN[0].box)


def test_filled_in_table(tmp_path: Path) -> None:
    defects = [
        {"defect_id": place.defect_id, "defect_class": place.defect_class, "severity": "minor", "facade": "S",
         "storey": None, "element_name": None, "photo_count": 1, "score": 0.9, "best_photo_id": place.photo_id}
        for place in SHOWN
    ]  # fmt: skip
    text = format_defects_csv(task(), defects, {place.defect_id or "": [place] for place in SHOWN})
    write_task(tmp_path / "task", exported(), text, [])
    lines = (tmp_path / "task" / "defects.csv").read_text("utf-8-sig").splitlines()
    assert len(lines) == 5
    said = {"D0": ("yes", "", ""), "D1": ("corrected", "efflorescence", "see card"), "D2": ("Rejected", "", "")}
    head, *rest = [line.split(",") for line in lines]
    for cells in rest:
        cells[-3:] = said.get(cells[2], ("", "", ""))
    rest.append(
        ["", "", "", "", "crack", "", "", "", "", "", "", "p1.jpg", "10", "20", "30", "40", "", "missed", "", ""]
    )
    rest.append(["", "", "D9", *[""] * 14, "confirmed", "", ""])
    rest.append(["", "", "D3", *[""] * 14, "maybe", "", ""])
    rest.append(["", "run-0", "D3", *[""] * 14, "confirmed", "", ""])
    file = tmp_path / "filled.csv"
    file.write_text("\n".join(";".join(cells) for cells in [head, *rest]), encoding="utf-8-sig")  # Excel, Europe
    parsed = read_csv_reviews(file, SHOWN, SIZES, NAMES, PROVENANCE)
    assert {(review.defect_id, review.verdict, review.defect_class) for review in parsed.reviews} == {
        ("D0", Verdict.CONFIRMED, CRACK),
        ("D1", Verdict.CORRECTED, MOISTURE),
        ("D2", Verdict.REJECTED, None),
        (None, Verdict.MISSED, CRACK),
    }
    assert [review.note for review in parsed.reviews if review.defect_id == "D1"] == ["see card"]
    assert [remark.split(":")[0] for remark in parsed.remarks] == ["line 7", "line 8", "line 9"]
    assert "there is no defect 'D9'" in parsed.remarks[0]
    assert "use confirmed, rejected, corrected, missed" in parsed.remarks[1]
    assert "it reviews the run run-0" in parsed.remarks[2]
    with pytest.raises(InputDataError, match="holds a task already"):
        write_task(tmp_path / "task", exported(), text, [])
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputDataError, match=r"has the columns a, b; it needs 'verdict'"):
        read_csv_reviews(tmp_path / "other.csv", SHOWN, PHOTOGRAPHS, NAMES, PROVENANCE)


def test_review_of_a_defect_leaves_its_rejected_observations_unless_all_are(tmp_path: Path) -> None:
    found = (("p0.jpg", "crack", box(100, 100)), ("p1.jpg", "crack", box(100, 100)))
    first, second = list_review_items(match_reviews((), seen(*found)), {"p0.jpg#1": "D1", "p1.jpg#2": "D1"})
    (tmp_path / "a.csv").write_text("defect_id,verdict\nD1,confirmed\n")

    def confirmed(*rejected: ReviewItem) -> list[str]:
        parsed = [create_review(place, Verdict.REJECTED, PROVENANCE) for place in rejected]
        places = list_review_items(match_reviews(parsed, seen(*found)), {"p0.jpg#1": "D1", "p1.jpg#2": "D1"})
        return [
            review.photo_id for review in read_csv_reviews(tmp_path / "a.csv", places, SIZES, NAMES, PROVENANCE).reviews
        ]

    assert confirmed() == ["p0.jpg", "p1.jpg"]
    assert confirmed(first) == ["p1.jpg"]
    assert confirmed(first, second) == ["p0.jpg", "p1.jpg"]


def test_missed_defect_that_is_confirmed_stays_missed_and_can_be_taken_back(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        "verdict,photo_id,corrected_class,box_x_px,box_y_px,box_width_px,box_height_px\nmissed,p0.jpg,crack,9,9,50,20\n"
    )
    (missed,) = read_csv_reviews(tmp_path / "a.csv", (), SIZES, NAMES, PROVENANCE).reviews
    (place,) = list_review_items(match_reviews((missed,), ()), {})
    assert create_review(place, Verdict.CONFIRMED, PROVENANCE).verdict is Verdict.MISSED
    back = create_review(place, Verdict.REJECTED, PROVENANCE)
    assert (back.subject, back.box, back.reviewed_box) == (missed.subject, None, box(9, 9, 50, 20))
    assert select_current_reviews((missed, back)) == (back,)
    (rejected,) = list_review_items(match_reviews((missed, back), ()), {})
    assert not rejected.is_defect
    assert create_review(rejected, Verdict.CONFIRMED, PROVENANCE).box == box(9, 9, 50, 20)


def test_reviews_survive_the_table(corrected: Path) -> None:
    parsed = read_coco_reviews(corrected, SHOWN, PHOTOGRAPHS, NAMES, PROVENANCE, deletions_count=True).reviews
    table = table_from_reviews(parsed, building_id="tower", campaign_id="2026-04")
    assert sorted(reviews_from_table(table), key=lambda review: review.subject) == sorted(
        parsed, key=lambda review: review.subject
    )
