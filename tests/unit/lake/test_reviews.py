"""Persons' words are added in a version of their own, outlive inspections, and are never written twice."""

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from facadelake.core.errors import InputDataError, SchemaError, StoreError
from facadelake.lake import transaction as transaction_module
from facadelake.lake.commit import CommitResult
from facadelake.lake.connect import hold_lock
from facadelake.lake.questions import answer_question
from facadelake.lake.read import list_versions, query, read_table, read_tables
from facadelake.lake.reviews import AppendResult, append_reviews
from schemas.tables import LAKE_TABLES, TABLES
from tests.unit.lake.small_campaign import BUILDING, CAMPAIGN, commit

HERE = {"building_id": BUILDING, "campaign_id": CAMPAIGN}
THEN = datetime(2026, 5, 1, 9, 0, tzinfo=UTC)


def word(subject: str, verdict: str = "confirmed", *, hours: int = 0, **changes: Any) -> dict[str, Any]:
    photo = subject.split("#")[0]
    return {
        **HERE, "run_id": "run-1", "review_id": "", "subject": subject, "photo_id": photo, "detection_id": subject,
        "verdict": verdict, "defect_class": "crack", "reviewed_class": "crack", "detector_sha256": "d" * 64,
        "reviewed_box_x_px": 10.0, "reviewed_box_y_px": 20.0, "reviewed_box_width_px": 300.0,
        "reviewed_box_height_px": 150.0,
        "reviewer": "A. Mason", "reviewed_at": THEN + timedelta(hours=hours), **changes,
    }  # fmt: skip


def words(*rows: dict[str, Any]) -> pa.Table:
    return pa.Table.from_pylist(list(rows), schema=LAKE_TABLES["reviews"].arrow)


TWO = words(word("closerange/p0.jpg#0"), word("closerange/p1.jpg#0", "rejected", defect_class=None))


def test_words_are_a_version_of_their_own_and_change_no_other_table(tmp_path: Path, first: CommitResult) -> None:
    added = append_reviews(tmp_path, TWO, **HERE)
    assert (added.added, added.unchanged) == (2, 0)
    assert added.version == first.version + 1
    held = read_table(tmp_path, "reviews").to_pylist()
    assert [row["review_id"] for row in held] == ["tower-2026-04-R00001", "tower-2026-04-R00002"]
    assert [row["verdict"] for row in held] == ["confirmed", "rejected"]
    now, then = (read_tables(tmp_path, list(TABLES), as_of=version) for version in (None, first.version))
    for name in TABLES:
        key = [(column, "ascending") for column in TABLES[name].key]
        assert now[name].sort_by(key).equals(then[name].sort_by(key)), name
    assert len(read_table(tmp_path, "reviews", as_of=first.version)) == 0
    told = list_versions(tmp_path).to_pylist()[-1]
    assert (told["reviewed_by"], told["run_id"], told["regraded_by"]) == ("A. Mason", None, None)
    assert answer_question(tmp_path, "versions").to_pylist()[0]["reviewed_by"] == "A. Mason"


def test_the_last_word_counts_and_the_same_is_not_written_twice(tmp_path: Path, first: CommitResult) -> None:
    append_reviews(tmp_path, TWO, **HERE)
    later = words(word("closerange/p0.jpg#0", hours=1), word("closerange/p1.jpg#0", hours=1))
    assert append_reviews(tmp_path, later, **HERE) == AppendResult(added=1, unchanged=1, version=first.version + 2)
    assert append_reviews(tmp_path, later, **HERE) == AppendResult(added=0, unchanged=2, version=None)
    standing = query(tmp_path, "SELECT subject, verdict, review_id FROM current_reviews ORDER BY subject").to_pylist()
    assert [(row["verdict"], row["review_id"][-2:]) for row in standing] == [("confirmed", "01"), ("confirmed", "03")]
    assert len(read_table(tmp_path, "reviews")) == 3


def test_inspecting_again_leaves_the_words(tmp_path: Path, first: CommitResult) -> None:
    append_reviews(tmp_path, TWO, **HERE)
    before = read_table(tmp_path, "reviews")
    again = commit(tmp_path, run_id="run-2", inputs="j" * 64)
    assert again.changed
    assert read_table(tmp_path, "reviews").equals(before)
    same = commit(tmp_path, run_id="run-3", inputs="j" * 64)
    assert same == CommitResult(version=again.version, changed=False)


def test_which_model_found_a_defect_and_what_was_said_of_it(tmp_path: Path, first: CommitResult) -> None:
    append_reviews(tmp_path, TWO, **HERE)
    (found,) = answer_question(tmp_path, "models_of_defects", {**HERE, "defect_id": "defect-0000"}).to_pylist()
    assert (found["detector"], found["detector_sha256"]) == ("coco:boxes.json", "d" * 64)
    assert (found["detections"], found["confirmed"], found["rejected"]) == (2, 1, 1)
    assert len(answer_question(tmp_path, "models_of_defects", HERE)) == 3


def test_a_word_on_another_box_of_that_name_is_none_on_this_one(tmp_path: Path, first: CommitResult) -> None:
    """A run on other poses looks at other tiles, and the same model's boxes are numbered otherwise."""
    then = word("closerange/p0.jpg@then", detection_id="closerange/p0.jpg#0", reviewed_box_x_px=900.0)
    append_reviews(tmp_path, words(word("closerange/p0.jpg#0"), then), **HERE)
    (found,) = answer_question(tmp_path, "models_of_defects", {**HERE, "defect_id": "defect-0000"}).to_pylist()
    assert (found["detections"], found["confirmed"], found["rejected"]) == (2, 1, 0)


def test_campaign_that_is_not_there_makes_no_lake(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match=r"there is no lake in .* so there is nothing to review"):
        append_reviews(tmp_path / "elsewhere", TWO, **HERE)
    assert not (tmp_path / "elsewhere").exists()


def test_refusals_name_what_is_wrong(tmp_path: Path, first: CommitResult) -> None:
    other = words(word("a.jpg#1", campaign_id="1999-01"))
    with pytest.raises(InputDataError, match=r"does not hold tower 1999-01, so there is nothing to review"):
        append_reviews(tmp_path, other, building_id=BUILDING, campaign_id="1999-01")
    with pytest.raises(SchemaError, match=r"rows with campaign_id \['1999-01'\]; these are of 2026-04"):
        append_reviews(tmp_path, other, **HERE)
    with pytest.raises(SchemaError, match=r"table reviews has the columns"):
        append_reviews(tmp_path, TWO.drop_columns(["note"]), **HERE)


def test_failure_and_a_held_lock_write_nothing(
    tmp_path: Path, first: CommitResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    with hold_lock(tmp_path), pytest.raises(StoreError, match="being written by another process"):
        append_reviews(tmp_path, TWO, **HERE, lock_timeout_s=0.0)
    monkeypatch.setattr(transaction_module, "quote_sql_string", lambda text: "no text")
    with pytest.raises(StoreError, match=r"(?s)writing reviews of tower 2026-04 .* no review was written"):
        append_reviews(tmp_path, TWO, **HERE)
    assert len(read_table(tmp_path, "reviews")) == 0
    assert list_versions(tmp_path)["version"].to_pylist() == [first.version]
