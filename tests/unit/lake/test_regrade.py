"""Committed defects are graded anew in one version; inspections and persons' grades are not undone by it."""

import shutil
from pathlib import Path

import pyarrow as pa
import pytest

from facadelake.core.errors import InputDataError, StoreError
from facadelake.lake import transaction as transaction_module
from facadelake.lake.commit import CommitResult
from facadelake.lake.connect import open_catalog_to_write
from facadelake.lake.questions import answer_question
from facadelake.lake.read import list_versions, read_table, read_tables
from facadelake.lake.regrading import GradeChange, Regrading, preview_regrading, regrade
from facadelake.severity import GRADE_COLUMNS
from facadelake.severity.rule_packs import find_rule_file
from schemas.tables import TABLES
from tests.unit.lake.small_campaign import BUILDING, CAMPAIGN, commit

FISP = find_rule_file("nyc_fisp_v1")
EVERY = {"building_id": BUILDING, "campaign_id": None, "rule_file": FISP}


def grades(lake: Path, campaign: str = CAMPAIGN, as_of: int | None = None) -> list[tuple[str, str, str | None]]:
    rows = read_table(lake, "defects", building_id=BUILDING, campaign_id=campaign, as_of=as_of).to_pylist()
    return [(row["severity"], row["severity_rule"], row["graded_by"]) for row in rows]


# The small campaign's crack, spalling and moisture of 0.4 x 0.2 m, the crack's width not measured.
OLD = [("minor", "extent_v1", None)] * 3
NEW = [(word, "nyc_fisp_v1", "rules") for word in ("SWARMP", "UNSAFE", "SWARMP")]


@pytest.fixture(scope="module")
def twice(tmp_path_factory: pytest.TempPathFactory, template: tuple[Path, CommitResult]) -> tuple[Path, int, Regrading]:
    """A lake with two campaigns, its version before, and the regrading of both; it is only read."""
    lake = tmp_path_factory.mktemp("regraded")
    shutil.copytree(template[0], lake, dirs_exist_ok=True)
    before = commit(lake, campaign_id="2026-10").version
    expected = preview_regrading(lake, **EVERY)
    assert expected.version is None
    assert list_versions(lake)["version"].to_pylist() == [template[1].version, before]
    done = regrade(lake, **EVERY)
    assert done.changes == expected.changes
    return lake, before, done


def test_all_campaigns_in_one_version_and_the_earlier_one_stays_readable(twice: tuple[Path, int, Regrading]) -> None:
    lake, before, done = twice
    assert done.version == before + 1
    assert done.campaigns == (CAMPAIGN, "2026-10")
    assert done.changes[0] == GradeChange(
        campaign_id=CAMPAIGN, before=("minor", "extent_v1"), after=("SWARMP", "nyc_fisp_v1"), defects=2
    )
    assert grades(lake) == grades(lake, "2026-10") == NEW
    assert grades(lake, as_of=before) == OLD


def test_nothing_but_the_grades_changes(twice: tuple[Path, int, Regrading]) -> None:
    now, then = (read_tables(twice[0], list(TABLES), as_of=version) for version in (None, twice[1]))
    for name in TABLES:
        kept = [c for c in TABLES[name].arrow.names if c not in GRADE_COLUMNS]
        # made-up campaigns may share a run's id, which is the key of table runs
        key = [(column, "ascending") for column in dict.fromkeys(("campaign_id", *TABLES[name].key))]
        assert now[name].select(kept).sort_by(key).equals(then[name].select(kept).sort_by(key)), name


def test_again_changes_nothing(twice: tuple[Path, int, Regrading]) -> None:
    before = list_versions(twice[0])
    again = regrade(twice[0], **EVERY)
    assert again == Regrading(building_id=BUILDING, rules="nyc_fisp_v1", changes=(), unchanged=6, graded_by_person=0)
    assert list_versions(twice[0]).equals(before)


def test_history_and_campaigns_tell_of_it(twice: tuple[Path, int, Regrading]) -> None:
    lake, before, done = twice
    told = answer_question(lake, "versions").to_pylist()
    assert [(row["campaign_id"], row["run_id"], row["regraded_by"]) for row in told[:3]] == [
        (CAMPAIGN, None, "nyc_fisp_v1"),
        ("2026-10", None, "nyc_fisp_v1"),
        ("2026-10", "run-1", None),
    ]
    assert answer_question(lake, "campaigns")["version"].to_pylist() == [done.version, done.version]
    assert answer_question(lake, "campaigns", as_of=before)["version"].to_pylist() == [before - 1, before]


def test_one_campaign_alone(tmp_path: Path, first: CommitResult) -> None:
    commit(tmp_path, campaign_id="2026-10")
    done = regrade(tmp_path, **{**EVERY, "campaign_id": "2026-10"})
    assert done.campaigns == ("2026-10",)
    assert grades(tmp_path) == OLD
    assert grades(tmp_path, "2026-10") == NEW


def test_later_inspection_of_the_same_inputs_leaves_the_new_grades_alone(tmp_path: Path, first: CommitResult) -> None:
    done = regrade(tmp_path, **EVERY)
    assert commit(tmp_path, run_id="run-2") == CommitResult(version=done.version or 0, changed=False)
    assert grades(tmp_path) == NEW


def test_later_inspection_of_changed_inputs_says_which_regrading_it_replaced(
    tmp_path: Path, first: CommitResult
) -> None:
    regrade(tmp_path, **EVERY)
    new = commit(tmp_path, run_id="run-2", inputs="j" * 64)
    assert (new.changed, new.regraded_before) == (True, ("nyc_fisp_v1",))
    assert grades(tmp_path) == OLD
    assert commit(tmp_path, run_id="run-3", inputs="k" * 64).regraded_before == ()


def test_what_a_person_graded_stays(tmp_path: Path, first: CommitResult) -> None:
    with open_catalog_to_write(tmp_path) as connection:
        connection.execute(
            "UPDATE defects SET severity = 'UNSAFE', severity_rule = 'nyc_fisp_v1', graded_by = 'A. Mason' "
            "WHERE defect_id = 'defect-0000'"
        )
    done = regrade(tmp_path, **{**EVERY, "rule_file": find_rule_file("bre251_v1")})
    assert (done.graded_by_person, sum(step.defects for step in done.changes)) == (1, 2)
    assert grades(tmp_path) == [
        ("UNSAFE", "nyc_fisp_v1", "A. Mason"),
        ("not_covered", "bre251_v1", "rules"),
        ("not_covered", "bre251_v1", "rules"),
    ]


def test_failure_leaves_the_grades_as_they_were(
    tmp_path: Path, first: CommitResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(transaction_module, "quote_sql_string", lambda text: "no text")
    with pytest.raises(StoreError, match=r"(?s)regrading tower in the lake .* no grade was changed"):
        regrade(tmp_path, **EVERY)
    assert grades(tmp_path) == OLD
    assert list_versions(tmp_path)["version"].to_pylist() == [first.version]


def test_campaign_that_is_not_there(tmp_path: Path, first: CommitResult) -> None:
    with pytest.raises(InputDataError, match=r"no defects of tower, campaign 1999-01, so there is nothing to grade"):
        regrade(tmp_path, **{**EVERY, "campaign_id": "1999-01"})
    with pytest.raises(StoreError, match="there is no lake"):
        regrade(tmp_path / "elsewhere", **EVERY)
    assert not (tmp_path / "elsewhere").exists()


def test_a_rule_sees_one_campaign_at_a_time(tmp_path: Path, first: CommitResult) -> None:
    commit(tmp_path, campaign_id="2026-10", defects=5)
    pack = tmp_path / "count_v1.sql"
    pack.write_text(
        "-- severities: many, few\nSELECT defect_id, if(count(*) OVER () > 3, 'many', 'few') AS severity FROM defects"
    )
    regrade(tmp_path, **{**EVERY, "rule_file": pack})
    defects: pa.Table = read_table(tmp_path, "defects")
    found = {(row["campaign_id"], row["severity"]) for row in defects.to_pylist()}
    assert found == {(CAMPAIGN, "few"), ("2026-10", "many")}
