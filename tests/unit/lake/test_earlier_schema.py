"""A lake made by an earlier Facadelake is read as it lies, and migrated by the next commit; old versions stay readable.

``tests/data/lake_schema_1.tar.xz`` was written by the commit before schema version 2: two campaigns of the small
building, a review of the first, a regrading of the second; ``lake_schema_3.tar.xz`` and ``lake_schema_4.tar.xz`` by
the commits before versions 4 and 5.
"""

from __future__ import annotations

import tarfile
from pathlib import Path

import pyarrow as pa
import pytest

from facadelake.core.duckdb_engine import quote_sql_string
from facadelake.lake.connect import open_to_read
from facadelake.lake.migrate import get_schema_version
from facadelake.lake.questions import answer_question, list_questions
from facadelake.lake.read import list_versions, query, read_table
from schemas.tables import HISTORY_TABLES, LAKE_TABLES, SCHEMA_VERSION
from tests.unit.lake.small_campaign import CAMPAIGN, commit

DATA = Path(__file__).resolve().parents[2] / "data"
RENAMED = {
    "defects": {"sightings": "photo_count", "position_from": "position_method"},
    "merges": {"apart_m": "separation_m", "apart_sigma": "mahalanobis_distance"},
    "georeference": {
        "tie_inflation": "tie_variance_factor", "shift_score": "edge_score", "competing_score": "edge_score_runner_up",
    },
    "reviews": {"judged_class": "reviewed_class", "judged_box_width_px": "reviewed_box_width_px"},
}  # fmt: skip


def extract(tmp_path: Path, schema: int) -> Path:
    with tarfile.open(DATA / f"lake_schema_{schema}.tar.xz") as archive:
        archive.extractall(tmp_path / "lake", filter="data")
    return tmp_path / "lake"


@pytest.fixture
def lake(tmp_path: Path) -> Path:
    return extract(tmp_path, 1)


def stored(lake: Path, table: str, as_of: int | None = None) -> pa.Table:
    """The rows as the files hold them, without the views that rename columns."""
    with open_to_read(lake, as_of=as_of) as connection:
        key = ", ".join(LAKE_TABLES[table].key)
        return connection.execute(f"SELECT * FROM lake.{table} ORDER BY {key}").to_arrow_table()


# Tables that schema version 1 does not have.
ADDED = {"coverage", "placement_checks", "track_reviews", *HISTORY_TABLES}


@pytest.mark.parametrize("table", sorted(ADDED))
def test_a_table_added_since_is_read_without_rows(lake: Path, table: str) -> None:
    assert read_table(lake, table).num_rows == 0


@pytest.mark.parametrize("table", sorted(LAKE_TABLES.keys() - ADDED))
def test_every_table_is_read_before_it_is_migrated(lake: Path, table: str) -> None:
    before = stored(lake, table)
    rows = read_table(lake, table)
    assert len(rows) == len(before) > 0
    for old, new in RENAMED.get(table, {}).items():
        assert old not in rows.column_names
        assert rows.column(new).to_pylist() == before.column(old).to_pylist()
    if table == "defects":
        assert set(rows.column("facade_azimuth_deg").to_pylist()) == {180.0}  # of facade S, which no element measured
    with open_to_read(lake) as connection:
        assert get_schema_version(connection) == 1  # reading writes nothing


def test_questions_and_statements_use_the_new_names(lake: Path) -> None:
    for question in list_questions():
        answer_question(lake, question.name)
    assert query(lake, "SELECT sum(photo_count) AS n FROM defects").to_pylist() == [{"n": 10}]
    assert {row["regraded_by"] for row in list_versions(lake).to_pylist()} == {None, "nyc_fisp_v1"}
    (row,) = query(lake, "SELECT count(*) AS n FROM current_reviews WHERE reviewed_class = 'crack'").to_pylist()
    assert row["n"] == 2


def test_a_commit_migrates_and_earlier_versions_stay_readable(lake: Path) -> None:
    then = {table: read_table(lake, table) for table in LAKE_TABLES}
    newest = list_versions(lake).to_pylist()[-1]["version"]
    committed = commit(lake, run_id="run-3", campaign_id="2027-04")
    assert committed.changed
    with open_to_read(lake) as connection:
        assert get_schema_version(connection) == SCHEMA_VERSION
    for table, rows in then.items():
        assert read_table(lake, table, as_of=newest).equals(rows), table
        others = read_table(lake, table).to_pylist()
        assert [row for row in others if row["campaign_id"] != "2027-04"] == rows.to_pylist(), table
    keys = {row["run_id"]: row["stage_keys"] for row in read_table(lake, "runs").to_pylist()}
    assert keys["run-1"] is None and keys["run-3"] is not None
    first = read_table(lake, "defects", campaign_id=CAMPAIGN, as_of=2)
    assert first.column("photo_count").to_pylist() == [2, 2, 2]


def test_a_lake_of_schema_1_under_a_path_with_a_quote(lake: Path, tmp_path: Path) -> None:
    moved = tmp_path / "it's"
    lake.rename(moved)
    assert quote_sql_string(moved).count("''") == 1 and len(read_table(moved, "defects")) == 5


@pytest.mark.parametrize("schema", [3, 4])
def test_a_lake_of_a_later_schema_is_read_and_migrated(tmp_path: Path, schema: int) -> None:
    lake = extract(tmp_path, schema)
    then = {table: read_table(lake, table) for table in LAKE_TABLES}
    assert {table for table, rows in then.items() if not len(rows)} <= {
        "reviews",
        "track_reviews",
        "coverage",
        *HISTORY_TABLES,
    }
    assert then["defects"].column("severity_low").null_count == len(then["defects"])
    with open_to_read(lake) as connection:
        assert get_schema_version(connection) == schema
    assert commit(lake, run_id="run-3", campaign_id="2027-04").changed
    for table, rows in then.items():
        assert [r for r in read_table(lake, table).to_pylist() if r["campaign_id"] != "2027-04"] == rows.to_pylist()
    assert len(read_table(lake, "coverage", campaign_id="2027-04")) == 5
