"""The checks before a commit: quiet and quick on a good campaign, and each finds what it is there for."""

import pickle
import subprocess
import sys
from typing import Any

import pyarrow as pa
import pytest

from facadelake.core.errors import SchemaError
from facadelake.core.sql_files import read_statements
from facadelake.core.tables import get_stage_schema
from facadelake.lake.checks import CHECKED, CHECKS, format_failures, select_failures, validate
from schemas.tables import HISTORY_TABLES, RUN_KEYS, TABLES
from tests.unit.lake.small_campaign import REPOSITORY, history_tables, lake_tables, rows, stage_tables


def loose(name: str, made: list[dict[str, Any]]) -> pa.Table:
    """A table of the right types that may be empty where it must not be: what validation has to find."""
    return pa.Table.from_pylist(made, schema=get_stage_schema(name))


@pytest.fixture(scope="module")
def checked(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pa.Table]:
    """What a process says of a good campaign and of one with bad values; Great Expectations is imported once."""
    folder = tmp_path_factory.mktemp("checked")
    bad = rows()
    bad["photos"][0]["prior_lat_deg"] = 91.0
    bad["photos"][1]["photo_outcome"] = "splendid"
    bad["defects"][1]["defect_id"] = bad["defects"][0]["defect_id"]
    del bad["georeference"][0]["control"]
    bad["campaigns"] *= 2
    bad["elements"] = []
    bad |= {name: [] for name in HISTORY_TABLES}
    tables = {
        "good": {**lake_tables(defects=200), **history_tables(defects=200)},
        "bad": {name: loose(name, bad[name]) for name in CHECKED},
    }
    (folder / "tables").write_bytes(pickle.dumps(tables))
    code = (
        "import pathlib, pickle, sys\n"
        "from facadelake.lake.checks import validate\n"
        "tables, checks = map(pathlib.Path, sys.argv[1:])\n"
        "found = {name: validate(given) for name, given in pickle.loads(tables.read_bytes()).items()}\n"
        "checks.write_bytes(pickle.dumps(found))\n"
    )
    command = [sys.executable, "-c", code, str(folder / "tables"), str(folder / "checks")]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    found: dict[str, pa.Table] = pickle.loads((folder / "checks").read_bytes())
    return found


def test_results_of_a_good_campaign_are_silent_and_a_row_per_expectation_of_every_table(
    checked: dict[str, pa.Table],
) -> None:
    checks = checked["good"]
    assert set(checks["table_name"].to_pylist()) == set(CHECKED)
    keys = checks.select([name for name in TABLES["checks"].key if name not in RUN_KEYS]).to_pylist()
    assert len({tuple(key.values()) for key in keys}) == len(keys) > 200
    assert sum(key["expectation"].startswith("sql:") for key in keys) == len(read_statements(CHECKS))
    assert all(checks["passed"].to_pylist()), format_failures(checks)


def test_bad_values_of_one_table_are_rows_that_failed(checked: dict[str, pa.Table]) -> None:
    checks = checked["bad"]
    found = {
        (r["table_name"], r["column_name"], r["expectation"]): r["unexpected"]
        for r in select_failures(checks).to_pylist()
    }
    assert found[("photos", "prior_lat_deg", "expect_column_values_to_be_between")] == 1
    assert found[("photos", "photo_outcome", "expect_column_values_to_be_in_set")] == 1
    assert found[("defects", "defect_id", "expect_column_values_to_be_unique")] == 2
    assert found[("georeference", "control", "expect_column_values_to_not_be_null")] == 1
    assert ("campaigns", "", "expect_table_row_count_to_equal") in found
    assert ("elements", "", "expect_table_row_count_to_be_between") in found
    text = format_failures(checks)
    assert "photos.prior_lat_deg: expect_column_values_to_be_between, 1 unexpected" in text
    assert '"found": [91.0]' in text


def test_wrong_columns_are_refused_at_once() -> None:
    tables = {**stage_tables(), **history_tables()}
    with pytest.raises(SchemaError, match="table poses is missing"):
        validate({name: table for name, table in tables.items() if name != "poses"})
    with pytest.raises(SchemaError, match="table poses has the columns"):
        validate({**tables, "poses": tables["poses"].drop_columns(["qw"])})
