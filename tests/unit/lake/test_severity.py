"""Severity comes from a rule pack, whole and known."""

from pathlib import Path

import pyarrow as pa
import pytest

from facadelake.errors import InputDataError, SchemaError
from facadelake.lake.severity import grade, rule_file
from facadelake.tables import check_table
from tests.unit.lake.small_campaign import stage_tables

HEADER = "-- severities: bad, good\n"


def defects(*rows: tuple[str, float, float, float]) -> pa.Table:
    names = ("defect_class", "width_m", "height_m", "area_m2")
    columns = {name: [row[i] for row in rows] for i, name in enumerate(names)}
    return pa.table({"defect_id": [f"d{i}" for i in range(len(rows))], **columns})


def graded(tmp_path: Path, sql: str, rows: int = 2) -> pa.Table:
    path = tmp_path / "trial_v1.sql"
    path.write_text(HEADER + sql)
    return grade(defects(*[("crack", 1.0, 1.0, 1.0)] * rows), path)


@pytest.mark.parametrize(
    ("row", "severity"),
    [
        (("crack", 0.1, 0.49, 0.01), "minor"),
        (("crack", 0.1, 0.50, 0.01), "moderate"),
        (("crack", 2.0, 0.10, 0.01), "severe"),
        (("spalling", 0.29, 0.29, 0.08), "minor"),
        (("spalling", 0.3, 0.2, 0.06), "moderate"),
        (("spalling", 0.9, 0.9, 0.81), "severe"),
        (("moisture", 0.9, 0.9, 0.81), "minor"),
        (("moisture", 1.0, 0.9, 0.9), "moderate"),
        (("moisture", 2.5, 2.0, 5.0), "severe"),
    ],
)
def test_extent_rule(row: tuple[str, float, float, float], severity: str) -> None:
    result = grade(defects(row), rule_file("extent_v1"))
    assert result["severity"].to_pylist() == [severity]
    assert result["severity_rule"].to_pylist() == ["extent_v1"]


def test_graded_stage_table_fits_the_schema() -> None:
    table = stage_tables()["defects"]
    assert check_table("defects", grade(table, rule_file("extent_v1"))).num_rows == 3
    assert grade(table.slice(0, 0), rule_file("extent_v1")).schema == table.schema


def test_rule_that_does_not_grade_every_defect_once(tmp_path: Path) -> None:
    with pytest.raises(SchemaError, match="1 defects without a severity, such as 'd1'"):
        graded(tmp_path, "SELECT defect_id, 'bad' AS severity FROM defects WHERE defect_id = 'd0'")
    with pytest.raises(SchemaError, match="2 defects without a severity"):
        graded(tmp_path, "SELECT defect_id, NULL AS severity FROM defects")
    with pytest.raises(SchemaError, match="2 defects graded twice, such as 'd0'"):
        graded(tmp_path, "SELECT defect_id, 'bad' AS severity FROM defects, range(2)")
    with pytest.raises(SchemaError, match="1 defects that do not exist, such as 'x'"):
        graded(tmp_path, "SELECT defect_id, 'bad' AS severity FROM defects UNION ALL SELECT 'x', 'bad'")
    with pytest.raises(SchemaError, match="severities that are none of bad, good, such as 'ugly'"):
        graded(tmp_path, "SELECT defect_id, 'ugly' AS severity FROM defects")


def test_rule_that_cannot_be_used(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match=r"no severity rule pack extent_v9 in .*; there are extent_v1"):
        rule_file("extent_v9")
    with pytest.raises(InputDataError, match="no severity rule pack"):
        rule_file("../severity/extent_v1")
    with pytest.raises(InputDataError, match="only answers a SELECT"):
        graded(tmp_path, "COPY defects TO 'x.csv'")
    with pytest.raises(InputDataError, match="table function read_csv may not be used"):
        graded(tmp_path, "SELECT * FROM read_csv('/etc/passwd')")
    with pytest.raises(InputDataError, match="cannot be run"):
        graded(tmp_path, "SELECT defect_id, crack_width_mm AS severity FROM defects")
    (tmp_path / "silent_v1.sql").write_text("SELECT defect_id, 'bad' AS severity FROM defects")
    with pytest.raises(InputDataError, match="does not say '-- severities"):
        grade(defects(("crack", 1.0, 1.0, 1.0)), tmp_path / "silent_v1.sql")
