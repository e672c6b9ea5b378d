"""The checks before a commit: quiet and quick on a good campaign, and each finds what it is there for."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from facadelake.errors import SchemaError
from facadelake.lake import expectations as module
from facadelake.lake.expectations import CHECKED, checks_sha256, failure_text, failures, validate
from facadelake.lake.sqlfiles import statements
from facadelake.tables import read_table, stage_schema
from schemas.expectations import expectations
from schemas.tables import RUN_KEYS, TABLES
from tests.unit.lake.small_campaign import REPOSITORY, rows, stage_tables


def loose(name: str, made: list[dict[str, Any]]) -> pa.Table:
    """A table of the right types that may be empty where it must not be: what validation has to find."""
    return pa.Table.from_pylist(made, schema=stage_schema(name))


def test_results_of_a_good_campaign_are_silent_and_a_row_per_expectation_of_every_table(tmp_path: Path) -> None:
    code = (
        f"import sys; sys.path.insert(0, {str(REPOSITORY)!r})\n"
        "from pathlib import Path\n"
        "from tests.unit.lake.small_campaign import lake_tables\n"
        "from facadelake.lake.expectations import validate\n"
        "from facadelake.tables import write_table\n"
        f"write_table('checks', validate(lake_tables(defects=200)), Path({str(tmp_path)!r}))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    checks = read_table("checks", tmp_path)
    assert set(checks["table_name"].to_pylist()) == set(CHECKED)
    keys = checks.select([name for name in TABLES["checks"].key if name not in RUN_KEYS]).to_pylist()
    assert len({tuple(key.values()) for key in keys}) == len(keys) > 200
    assert sum(key["expectation"].startswith("sql:") for key in keys) == len(statements("checks"))
    assert all(checks["passed"].to_pylist()), failure_text(checks)


def test_bad_values_of_one_table_are_rows_that_failed() -> None:
    made = rows()
    made["photos"][0]["prior_lat_deg"] = 91.0
    made["photos"][1]["photo_outcome"] = "splendid"
    made["defects"][1]["defect_id"] = made["defects"][0]["defect_id"]
    del made["georeference"][0]["control"]
    made["campaigns"] *= 2
    made["elements"] = []
    checks = validate({name: loose(name, made[name]) for name in CHECKED})
    found = {
        (r["table_name"], r["column_name"], r["expectation"]): r["unexpected"] for r in failures(checks).to_pylist()
    }
    assert found[("photos", "prior_lat_deg", "expect_column_values_to_be_between")] == 1
    assert found[("photos", "photo_outcome", "expect_column_values_to_be_in_set")] == 1
    assert found[("defects", "defect_id", "expect_column_values_to_be_unique")] == 2
    assert found[("georeference", "control", "expect_column_values_to_not_be_null")] == 1
    assert ("campaigns", "", "expect_table_row_count_to_equal") in found
    assert ("elements", "", "expect_table_row_count_to_be_between") in found
    text = failure_text(checks)
    assert "photos.prior_lat_deg: expect_column_values_to_be_between, 1 unexpected" in text
    assert '"found": [91.0]' in text


def test_wrong_columns_are_refused_at_once() -> None:
    tables = stage_tables()
    with pytest.raises(SchemaError, match="table poses is missing"):
        validate({name: table for name, table in tables.items() if name != "poses"})
    with pytest.raises(SchemaError, match="table poses has the columns"):
        validate({**tables, "poses": tables["poses"].drop_columns(["qw"])})


def test_hash_of_the_checks_changes_with_them(monkeypatch: pytest.MonkeyPatch) -> None:
    before = checks_sha256()
    assert checks_sha256() == before
    monkeypatch.setattr(module, "expectations", lambda table: expectations(table)[1:])
    fewer = checks_sha256()
    monkeypatch.setattr(module, "statements", lambda kind: statements(kind)[1:])
    assert len({before, fewer, checks_sha256()}) == 3
