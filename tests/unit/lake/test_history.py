"""A building's history is replaced as a whole, with a commit or by itself, and never by one that is out of date."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pytest

from facadelake.campaigns import regrading
from facadelake.core.errors import HistoryOutdatedError, SchemaError
from facadelake.lake.commit import commit_campaign
from facadelake.lake.history import TrackedHistory, commit_history
from facadelake.lake.questions import answer_question
from facadelake.lake.read import read_table
from facadelake.lake.regrading import regrade
from facadelake.severity import find_rule_file
from tests.unit.lake.small_campaign import BUILDING, CAMPAIGN, INPUTS, commit, history_tables, lake_tables

CODE = "e" * 64
IDS = {f"{BUILDING}-{number:04d}" for number in (1, 2, 3)}


def track(known: frozenset[str] = frozenset(), run_id: str = "run-1", **changed: pa.Table) -> TrackedHistory:
    tables = {**history_tables(run_id=run_id), **changed}
    return TrackedHistory(tables=tables, run_ids={CAMPAIGN: run_id}, known_tracks=known, code_sha256=CODE)


def commit_with(lake: Path, history: TrackedHistory, run_id: str = "run-1", note: str = "a") -> int:
    keys = {"building_id": BUILDING, "campaign_id": CAMPAIGN, "run_id": run_id}
    tables = lake_tables(run_id=run_id, note=note, inputs=INPUTS if note == "a" else note * 64)
    inputs = tables["runs"].column("inputs_sha256")[0].as_py()
    return commit_campaign(lake, tables=tables, inputs_sha256=inputs, history=history, **keys).version


def read_ids(lake: Path, as_of: int | None = None) -> set[str]:
    return set(read_table(lake, "tracks", as_of=as_of).column("track_id").to_pylist())


def test_a_campaign_and_its_history_are_one_version(tmp_path: Path) -> None:
    first = commit_with(tmp_path, track())
    assert read_ids(tmp_path) == IDS
    fewer = history_tables(run_id="run-2")["tracks"].slice(0, 2)
    second = commit_with(tmp_path, track(frozenset(IDS), "run-2", tracks=fewer), "run-2", note="b")
    assert second > first and len(read_ids(tmp_path)) == 2
    assert read_ids(tmp_path, as_of=first) == IDS


def test_a_history_of_other_campaigns_or_tracks_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    commit_with(tmp_path, track())
    with pytest.raises(HistoryOutdatedError) as raised:
        commit_with(tmp_path, track(frozenset(), "run-2"), "run-2", note="b")  # did not know of the tracks
    assert str(raised.value) == (
        "the lake has other campaigns or tracks of tower than when it was tracked: another process has committed "
        "meanwhile; nothing was written, run again"
    )
    assert read_table(tmp_path, "runs").column("run_id").to_pylist() == ["run-1"]
    commit(tmp_path, campaign_id="2027-04", run_id="run-3")
    with pytest.raises(HistoryOutdatedError):
        commit_history(tmp_path, track(frozenset(IDS)), building_id=BUILDING)  # does not know of 2027-04


def test_a_history_by_itself_is_a_version_and_keeps_other_buildings(tmp_path: Path) -> None:
    mill = {"building_id": "mill", "campaign_id": CAMPAIGN, "run_id": "run-1"}
    other = TrackedHistory(
        tables=history_tables(**mill), run_ids={CAMPAIGN: "run-1"}, known_tracks=frozenset(), code_sha256=CODE
    )
    commit_campaign(tmp_path, tables=lake_tables(**mill), inputs_sha256=INPUTS, history=other, **mill)
    commit(tmp_path)
    version = commit_history(tmp_path, track(), building_id=BUILDING)
    others = {"mill-0001", "mill-0002", "mill-0003"}
    assert version is not None and read_ids(tmp_path) == IDS | others and read_ids(tmp_path, version - 1) == others
    assert commit_history(tmp_path, track(frozenset(IDS)), building_id=BUILDING) is None  # nothing has changed


def test_a_version_says_what_it_has_brought_and_by_which_code(tmp_path: Path) -> None:
    commit(tmp_path)
    by_itself = commit_history(tmp_path, track(), building_id=BUILDING)
    newest, campaign = answer_question(tmp_path, "versions").to_pylist()
    assert (newest["version"], newest["campaign_id"], newest["run_id"]) == (by_itself, None, None)
    assert (newest["content"], newest["code_sha256"]) == ("history of tower", CODE)
    assert (campaign["content"], campaign["code_sha256"]) == (f"campaign {CAMPAIGN} of tower", "c" * 64)
    (known,) = answer_question(tmp_path, "provenance").to_pylist()
    assert (known["version"], known["code_sha256"]) == (campaign["version"], "c" * 64)
    assert (known["history_version"], known["history_content"], known["history_code_sha256"]) == (
        by_itself, "history of tower", CODE,
    )  # fmt: skip


def test_grades_are_published_by_campaign_after_a_history_by_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    commit(tmp_path)
    commit_history(tmp_path, track(), building_id=BUILDING)
    monkeypatch.setattr(regrading, "publish_regraded", lambda _, **given: given)
    done, releases = regrading.regrade_campaigns(tmp_path, BUILDING, None, "nyc_fisp_v1")
    assert releases == [{"building_id": BUILDING, "campaign_id": CAMPAIGN, "version": done.version}]


def test_an_unchanged_campaign_is_kept_and_its_changed_history_written(tmp_path: Path) -> None:
    """As after a review of a track: the inspection that applies it has the same photographs, code and settings."""
    first = commit_with(tmp_path, track())
    assert commit_with(tmp_path, track(frozenset(IDS))) == first  # nothing has changed
    fewer = history_tables(run_id="run-1")["tracks"].slice(0, 2)
    second = commit_with(tmp_path, track(frozenset(IDS), tracks=fewer))
    assert second > first and len(read_ids(tmp_path)) == 2
    assert read_table(tmp_path, "runs").column("run_id").to_pylist() == ["run-1"]
    by_itself = commit_history(tmp_path, track(frozenset(IDS) - {f"{BUILDING}-0003"}), building_id=BUILDING)
    again = commit_with(tmp_path, track(frozenset(IDS)))
    assert by_itself == again > second  # the release of this version has the history that was committed by itself


def test_a_history_with_other_columns_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SchemaError, match="table tracks has the columns"):
        commit_with(tmp_path, track(tracks=pa.table({"track_id": ["a"]})))


def test_a_regrading_reaches_the_tracks_and_takes_off_what_it_makes_untrue(tmp_path: Path) -> None:
    commit_with(tmp_path, track())
    regrade(tmp_path, building_id=BUILDING, campaign_id=None, rule_file=find_rule_file("nyc_fisp_v1"))
    tracks = read_table(tmp_path, "tracks").to_pylist()
    assert [(row["severity"], row["severity_rule"]) for row in tracks] == [
        (word, "nyc_fisp_v1") for word in ("SWARMP", "UNSAFE", "SWARMP")
    ]
    assert all("facadelake track" in row["trend_remark"] for row in tracks)
