"""What a new model changes: each box of both models once, and reviews decide what is a loss."""

from collections import Counter
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pytest

from facadelake.core.errors import InputDataError
from facadelake.evaluation.model_comparison.box_changes import Change, compare_boxes, compute_covered_share
from facadelake.evaluation.model_comparison.contact_sheet import Crop, write_sheet
from facadelake.evaluation.model_comparison.defect_changes import compare_defects, join_detections
from facadelake.evaluation.model_comparison.promote import describe_evidence, list_objections
from facadelake.evaluation.model_comparison.report import (
    CampaignComparison,
    ComparedDetector,
    DetectorComparison,
    count_changes,
    list_lost_defects,
    read_comparison,
    write_comparison,
)
from facadelake.evaluation.model_comparison.review_comparison import ReviewComparison, compare_with_reviews
from facadelake.reviews.box_matching import corners_from_boxes
from facadelake.reviews.review_items import create_missed_review, create_review, list_review_items
from facadelake.reviews.review_matching import match_reviews, select_accepted_detections
from schemas.vocabulary import Verdict
from tests.unit.reviews.made_reviews import CRACK, NEW_MODEL, OLD_MODEL, PROVENANCE, box, rows, seen

OLD = rows(
    ("p0.jpg", "crack", box(100, 100)),  # stays, a little aside
    ("p0.jpg", "crack", box(100, 500, 900, 40)),  # in two parts by the new one
    ("p0.jpg", "spalling", box(600, 600)),  # called moisture by the new one
    ("p1.jpg", "crack", box(50, 50)),  # vanishes
)
NEW = rows(
    ("p0.jpg", "crack", box(110, 100)),
    ("p0.jpg", "crack", box(100, 500, 450, 40)),
    ("p0.jpg", "crack", box(560, 500, 440, 40)),
    ("p0.jpg", "moisture", box(600, 600)),
    ("p1.jpg", "crack", box(400, 400)),  # appears
    ("p2.jpg", "crack", box(50, 50)),  # appears, in another photograph
    model=NEW_MODEL,
)
CHANGES = compare_boxes(select_accepted_detections(OLD), select_accepted_detections(NEW))


def test_every_box_is_counted_once() -> None:
    assert Counter(one.change for one in CHANGES) == {
        Change.STAYS: 3, Change.RENAMED: 1, Change.VANISHES: 1, Change.APPEARS: 2,
    }  # fmt: skip
    for which, table in (("old", OLD), ("new", NEW)):
        ids = [getattr(one, which).detection_id for one in CHANGES if getattr(one, which) is not None]
        assert sorted(ids) == sorted(table.column("detection_id").to_pylist())
    assert count_changes(CHANGES) == {
        "crack": {"stays": 3, "renamed": 0, "appears": 2, "vanishes": 1},
        "spalling": {"stays": 0, "renamed": 1, "appears": 0, "vanishes": 0},
    }


def test_a_long_crack_in_many_short_parts_has_not_vanished() -> None:
    whole = seen(("p0.jpg", "crack", box(0, 0, 1000, 20)))
    parts = seen(*[("p0.jpg", "crack", box(100.0 * i, 0, 90, 20)) for i in range(10)], model=NEW_MODEL)
    for one, other in ((whole, parts), (parts, whole)):
        assert {change.change for change in compare_boxes(one, other)} == {Change.STAYS}
    few = parts[:4]
    there = Counter(change.change for change in compare_boxes(whole, few))
    assert there == {Change.VANISHES: 1, Change.STAYS: 4}  # 36 % of it is found


def test_share_that_others_cover_together_is_exact() -> None:
    place = corners_from_boxes([box(0, 0, 100, 10)])[0]
    others = corners_from_boxes([box(-5, -5, 25, 10), box(10, 0, 20, 10), box(90, 5, 50, 50), box(300, 0, 5, 5)])
    counted = np.zeros((10, 100), dtype=bool)  # pixel by pixel
    counted[0:5, 0:20] = counted[:, 10:30] = counted[5:, 90:] = True
    assert compute_covered_share(place, others) == pytest.approx(counted.mean(), abs=1e-12)


def test_both_models_are_merged_as_one_and_separated_by_observations() -> None:
    joint = join_detections(CHANGES, OLD, NEW)
    assert joint.schema.equals(OLD.schema)
    ids = joint.column("detection_id").to_pylist()
    assert len(set(ids)) == len(ids) == 8
    assert Counter(key.split(":")[0] for key in ids) == {"both": 3, "old": 2, "new": 3}
    merged = {
        "D1": ["old:p1.jpg#4", "new:p2.jpg#6"],
        "D2": ["new:p1.jpg#5"],
        "D3": ["old:p0.jpg#3"],
        "D4": ["both:p0.jpg#1"],
    }
    observations = pa.table(
        {
            "defect_id": [name for name, keys in merged.items() for _ in keys] + [None],
            "photo_id": [key.split(":")[1].split("#")[0] for keys in merged.values() for key in keys] + ["p0.jpg"],
            "detection_id": [key for keys in merged.values() for key in keys] + ["both:p0.jpg#2"],
        }
    )
    defects = pa.table(
        {"defect_id": list(merged), "defect_class": ["crack"] * 4, "facade": ["S"] * 4, "storey": [None] * 4}
    )
    fates = {one.defect_id: one.change for one in compare_defects(observations, defects)}
    assert fates == {"D1": Change.STAYS, "D2": Change.APPEARS, "D3": Change.VANISHES, "D4": Change.STAYS}


def compared(photographs: tuple[str, ...] = ("p0.jpg", "p1.jpg", "p2.jpg")) -> ReviewComparison:
    """Both confirmed cracks are defects D1 and D4, the spalling is rejected, and one in p1 had been missed."""
    places = list_review_items(
        match_reviews((), select_accepted_detections(OLD)),
        {f"{photo}#{i}": f"D{i}" for photo, i in (("p0.jpg", 1), ("p1.jpg", 4))},
    )
    by_id = {place.detection_id: place for place in places}
    reviews = (
        create_review(by_id["p0.jpg#1"], Verdict.CONFIRMED, PROVENANCE),
        create_review(by_id["p1.jpg#4"], Verdict.CONFIRMED, PROVENANCE),
        create_review(by_id["p0.jpg#3"], Verdict.REJECTED, PROVENANCE),
        create_missed_review("p1.jpg", box(400, 405), CRACK, PROVENANCE),
    )
    return compare_with_reviews(
        match_reviews(reviews, select_accepted_detections(OLD)),
        select_accepted_detections(OLD),
        select_accepted_detections(NEW),
        photographs,
    )


def test_reviews_distinguish_losses_from_gains() -> None:
    assert compared().count_outcomes() == {
        "confirmed": 3, "confirmed_by_old": 2, "confirmed_by_new": 2, "confirmed_lost": 1, "confirmed_gained": 1,
        "rejected": 1, "rejected_by_old": 1, "rejected_by_new": 0, "rejected_lost": 1, "rejected_gained": 0,
    }  # fmt: skip
    (lost,) = list_lost_defects(compared())
    assert (lost.defect, lost.photo_id, lost.box_px) == ("D4", "p1.jpg", (50.0, 50.0, 100.0, 40.0))
    assert compared(("p0.jpg",)).count_outcomes()["confirmed"] == 1


LATER = replace(PROVENANCE, run_id="run-2")


def test_a_defect_seen_in_another_of_its_photographs_is_not_lost() -> None:
    found = (("p1.jpg", "crack", box(50, 50)), ("p2.jpg", "crack", box(50, 50)))
    places = list_review_items(match_reviews((), seen(*found)), {"p1.jpg#1": "D1", "p2.jpg#2": "D1"})
    status = match_reviews([create_review(place, Verdict.CONFIRMED, PROVENANCE) for place in places], seen(*found))
    one = compare_with_reviews(status, seen(*found), select_accepted_detections(NEW), ("p1.jpg", "p2.jpg"))
    assert (len(one.defects), one.lost) == (1, ())
    # Another run's D1 is another defect: it does not hide that this one is lost.
    reviews = [
        create_review(place, Verdict.CONFIRMED, provenance)
        for place, provenance in zip(places, (PROVENANCE, LATER), strict=True)
    ]
    status = match_reviews(reviews, seen(*found))
    two = compare_with_reviews(status, seen(*found), select_accepted_detections(NEW), ("p1.jpg", "p2.jpg"))
    assert (len(two.defects), len(two.lost)) == (2, 1)


def report(compared: ReviewComparison) -> DetectorComparison:
    return DetectorComparison(
        old=ComparedDetector(name="old", sha256=OLD_MODEL),
        new=ComparedDetector(name="new", sha256=NEW_MODEL),
        made_at=datetime(2026, 5, 1, tzinfo=UTC),
        facadelake="0",
        campaigns=(
            CampaignComparison(
                building_id="tower", campaign_id="2026-04", run_id="run-1", photographs_total=5,
                photographs=("p0.jpg", "p1.jpg", "p2.jpg"), boxes=count_changes(CHANGES), wall=None,
                wall_remark="no model", reviews=compared.count_outcomes(), lost=list_lost_defects(compared),
            ),
        ),
    )  # fmt: skip


def test_report_reads_back(tmp_path: Path) -> None:
    made = report(compared())
    assert read_comparison(write_comparison(made, tmp_path / "a")) == made
    earlier = made.model_dump_json().replace('"reviews"', '"words"').replace('"observations"', '"sightings"')
    (tmp_path / "earlier.json").write_text(earlier)
    assert read_comparison(tmp_path / "earlier.json") == made
    (tmp_path / "b.json").write_text("{}")
    with pytest.raises(InputDataError, match="is not a comparison of two models"):
        read_comparison(tmp_path / "b.json")
    with pytest.raises(InputDataError, match="does not exist; run 'facadelake compare-models'"):
        read_comparison(tmp_path / "c.json")


JUDGED = [{"model_sha256": NEW_MODEL, "ap50": 0.8}]


def test_promotion_is_refused_for_each_reason_and_for_no_other() -> None:
    made = report(compared())
    good = {"old_sha256": OLD_MODEL, "new_sha256": NEW_MODEL, "evaluations": JUDGED, "lost_max": 1, "confirmed_min": 3}
    assert list_objections(made, **good) == ()
    (lost,) = list_objections(made, **{**good, "lost_max": 0})
    assert "it loses 1 of the 2 confirmed defects that the old one finds, at most 0 allowed: D4 (crack)" in lost
    (few,) = list_objections(made, **{**good, "confirmed_min": 4})
    assert "show 3 confirmed defects, at least 4 are needed" in few
    (other,) = list_objections(made, **{**good, "old_sha256": "c" * 64})
    assert "the comparison is of aaaaaaaaaaaa with bbbbbbbbbbbb, not of the default cccccccccccc" in other
    (bare,) = list_objections(made, **{**good, "evaluations": [{"model_sha256": OLD_MODEL}]})
    assert "its card holds no evaluation of this file (it has 1 of files with another hash)" in bare
    assert list_objections(made, **{**good, "old_sha256": None}) == ()
    assert len(list_objections(made, **{**good, "old_sha256": "c" * 64, "lost_max": 0, "confirmed_min": 9})) == 3


def test_what_a_promotion_rests_on() -> None:
    assert describe_evidence(report(compared()), lost_max=1) == (
        "compared with aaaaaaaaaaaa on 3 photographs of tower/2026-04: 1 of 3 confirmed defects lost (allowed 1), "
        "1 gained, 1 of 1 rejected ones gone"
    )


def test_sheet_shows_each_place_in_its_frame(tmp_path: Path) -> None:
    picture = np.full((600, 800, 3), 180, dtype=np.uint8)
    picture[290:310, 380:420] = (0, 200, 0)
    cv2.imwrite(str(tmp_path / "p.png"), picture)
    crops = [
        Crop(photograph=tmp_path / "p.png", box=box(380, 290, 40, 20), title="crack 0.90", below="p.png"),
        Crop(photograph=tmp_path / "gone.png", box=box(0, 0), title="crack 0.10", below="gone.png"),
    ]
    path = write_sheet(tmp_path / "sheet.png", crops, title="vanishes")
    sheet = cv2.imread(str(path)).astype(int)
    green = (sheet[:, :, 1] - sheet[:, :, 0] > 100) & (sheet[:, :, 1] - sheet[:, :, 2] > 100)
    ys, xs = np.nonzero(green)
    scale = 220 / 96  # a cell over the least crop, px
    assert (xs.max() - xs.min()) / scale == pytest.approx(40, abs=2)  # px of the photograph
    assert (ys.max() - ys.min()) / scale == pytest.approx(20, abs=2)
    assert (xs.min() + xs.max()) / 2 == pytest.approx(8 + 110, abs=3)
    assert write_sheet(tmp_path / "sheet.png", [], title="none") is None
    assert not (tmp_path / "sheet.png").exists()
