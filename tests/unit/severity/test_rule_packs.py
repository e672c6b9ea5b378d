"""Severity comes from a rule pack, whole and known."""

from pathlib import Path

import pyarrow as pa
import pytest

from facadelake.core.checkout import locate_source
from facadelake.core.duckdb_engine import open_duckdb
from facadelake.core.errors import InputDataError, SchemaError
from facadelake.core.sql_files import read_statement_file, read_statements
from facadelake.core.tables import check_table
from facadelake.registry import Building
from facadelake.severity.description import describe_severity
from facadelake.severity.rule_packs import (
    RULE_FOLDER,
    find_rule_file,
    grade_defects,
    list_rule_packs,
    read_rule_pack,
)
from tests.unit.lake.small_campaign import stage_tables
from tests.unit.severity.rule_headers import read_severities

HEADER = "-- severities: bad, good\n"


def defects(*rows: tuple[str, float, float, float]) -> pa.Table:
    names = ("defect_class", "width_m", "height_m", "area_m2")
    columns = {name: [row[i] for row in rows] for i, name in enumerate(names)}
    return pa.table({"defect_id": [f"d{i}" for i in range(len(rows))], **columns})


def graded(tmp_path: Path, sql: str, rows: int = 2) -> pa.Table:
    path = tmp_path / "trial_v1.sql"
    path.write_text(HEADER + sql)
    return grade_defects(defects(*[("crack", 1.0, 1.0, 1.0)] * rows), path)


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
    result = grade_defects(defects(row), find_rule_file("extent_v1"))
    assert result["severity"].to_pylist() == [severity]
    assert result["severity_rule"].to_pylist() == ["extent_v1"]


@pytest.mark.parametrize(
    ("pack", "width_mm", "sigma_mm", "severity", "low", "high"),
    [
        # The demo's crack of 24.5 mm, which was drawn 9 mm wide: 24.5 - 2 x 10 is up to 5 mm.
        ("width_and_extent_v1", 24.5, 10.0, "severe", "minor", "severe"),
        ("width_and_extent_v1", 24.5, 5.0, "severe", "moderate", "severe"),
        ("width_and_extent_v1", 24.5, 1.0, "severe", "severe", "severe"),
        ("width_and_extent_v1", 3.0, 0.9, "minor", "minor", "minor"),
        ("width_and_extent_v1", 3.0, 1.1, "minor", "minor", "moderate"),
        ("width_and_extent_v1", 3.0, None, "minor", "minor", "minor"),  # stated by a person without an error
        ("width_and_extent_v1", None, None, "minor_or_worse", "minor_or_worse", "minor_or_worse"),
        ("bre251_v1", 24.5, 4.9, "severe", "moderate", "very_severe"),
        ("bre251_v1", 0.2, 0.2, "very_slight", "negligible", "very_slight"),  # not below 0
        ("concrete_03_v1", 0.35, 0.05, "over_limit", "within_limit", "over_limit"),
        ("nyc_fisp_v1", 6.0, 1.0, "UNSAFE", "SWARMP", "UNSAFE"),
        ("paper_crack_width_v1", 0.45, 0.04, "moderate", "moderate", "severe"),
    ],
)
def test_the_severity_says_what_the_error_of_the_width_leaves_open(
    pack: str, width_mm: float | None, sigma_mm: float | None, severity: str, low: str, high: str
) -> None:
    crack = {
        "defect_id": "d", "defect_class": "crack", "width_m": 0.4, "height_m": 0.3, "length_m": None, "area_m2": 0.12,
        "crack_width_mm": width_mm, "crack_width_sigma_mm": sigma_mm, "crack_width_limit_mm": None,
        "material": "Concrete", "crack_width_outcome": "no_line" if width_mm is None else "measured",
    }  # fmt: skip
    table = pa.Table.from_pylist([crack])
    numbers = ("length_m", "crack_width_mm", "crack_width_sigma_mm", "crack_width_limit_mm")
    for name in numbers:
        table = table.set_column(table.column_names.index(name), name, table[name].cast(pa.float64()))
    row = grade_defects(table, find_rule_file(pack)).to_pylist()[0]
    assert (row["severity"], row["severity_low"], row["severity_high"]) == (severity, low, high)
    assert row["crack_width_mm"] == width_mm
    assert describe_severity(row) == (severity if low == high else f"{severity} ({low} to {high})")
    assert describe_severity(row | {"graded_by": "A. Mason"}) == severity  # a person decided


def grade_one(pack: str, **values: object) -> str:
    """The severity of one defect: by default a crack of 0.4 x 0.3 m on an element without a material."""
    crack = {
        "defect_id": "d", "defect_class": "crack", "width_m": 0.4, "height_m": 0.3, "length_m": None, "area_m2": 0.12,
        "crack_width_mm": None, "crack_width_limit_mm": None, "crack_width_outcome": None, "material": None,
    }  # fmt: skip
    schema = pa.schema(
        [
            (
                name,
                pa.string()
                if name in ("defect_id", "defect_class", "material", "crack_width_outcome")
                else pa.float64(),
            )
            for name in crack
        ]
    )
    graded = grade_defects(pa.Table.from_pylist([crack | values], schema=schema), find_rule_file(pack))
    assert graded["severity_rule"].to_pylist() == [pack]
    assert graded["graded_by"].to_pylist() == ["rules"]
    return str(graded["severity"][0])


@pytest.mark.parametrize(
    ("pack", "width_mm", "severity"),
    [
        ("paper_crack_width_v1", 0.0, "minor"),
        ("paper_crack_width_v1", 0.199, "minor"),
        ("paper_crack_width_v1", 0.2, "moderate"),
        ("paper_crack_width_v1", 0.5, "moderate"),
        ("paper_crack_width_v1", 0.501, "severe"),
        ("bre251_v1", 0.099, "negligible"),
        ("bre251_v1", 0.1, "very_slight"),
        ("bre251_v1", 1.0, "very_slight"),
        ("bre251_v1", 1.01, "slight"),
        ("bre251_v1", 5.0, "slight"),
        ("bre251_v1", 5.1, "moderate"),
        ("bre251_v1", 15.0, "moderate"),
        ("bre251_v1", 15.1, "severe"),
        ("bre251_v1", 25.0, "severe"),
        ("bre251_v1", 25.1, "very_severe"),
        ("concrete_03_v1", 0.3, "within_limit"),
        ("concrete_03_v1", 0.31, "over_limit"),
        ("nyc_fisp_v1", 0.09, "SAFE"),
        ("nyc_fisp_v1", 0.1, "SWARMP"),
        ("nyc_fisp_v1", 4.9, "SWARMP"),
        ("nyc_fisp_v1", 5.0, "UNSAFE"),
    ],
)
def test_cracks_by_their_width(pack: str, width_mm: float, severity: str) -> None:
    assert grade_one(pack, crack_width_mm=width_mm) == severity


@pytest.mark.parametrize(
    ("values", "severity"),
    [
        # Burland, Broms and de Mello 1977: 15 to 25 mm is category 4, severe. By its extent it was "minor".
        ({"crack_width_mm": 24.0, "crack_width_outcome": "measured"}, "severe"),
        ({"crack_width_mm": 15.0}, "moderate"),
        ({"crack_width_mm": 5.1}, "moderate"),
        ({"crack_width_mm": 5.0}, "minor"),
        ({"crack_width_mm": 0.2, "height_m": 2.0}, "moderate"),
        ({"crack_width_outcome": "below_limit", "crack_width_limit_mm": 5.0, "height_m": 1.0}, "minor"),
        ({"crack_width_outcome": "below_limit", "crack_width_limit_mm": 5.1, "height_m": 1.0}, "moderate_or_worse"),
        ({"crack_width_outcome": "no_line"}, "minor_or_worse"),
        ({"height_m": 0.5}, "moderate_or_worse"),
        ({"height_m": 2.0}, "severe"),
        ({"defect_class": "spalling", "width_m": 0.29, "height_m": 0.29}, "minor"),
        ({"defect_class": "spalling", "area_m2": 0.5}, "severe"),
        ({"defect_class": "moisture", "width_m": 1.0}, "moderate"),
    ],
)
def test_the_default_pack_uses_the_width_and_says_where_there_is_none(values: dict[str, object], severity: str) -> None:
    assert Building.model_fields["severity_rules"].default == "width_and_extent_v1"
    assert grade_one("width_and_extent_v1", **values) == severity


def test_the_header_of_a_pack_states_its_limits() -> None:
    pack = read_rule_pack("width_and_extent_v1")
    assert pack.severities == ("severe", "moderate_or_worse", "moderate", "minor_or_worse", "minor")
    assert "  severe     wider than 15 mm (categories 4 and 5)" in pack.basis
    assert not [line for line in pack.basis if line.startswith(("grain:", "meaning:", "severities:"))]


@pytest.mark.parametrize("pack", ["paper_crack_width_v1", "bre251_v1", "concrete_03_v1"])
def test_a_width_that_was_not_measured_is_not_guessed(pack: str) -> None:
    assert grade_one(pack, width_m=9.0, area_m2=30.0) == "not_measured"
    for other in ("spalling", "moisture"):
        assert grade_one(pack, defect_class=other, crack_width_mm=9.0) == "not_covered"


@pytest.mark.parametrize(
    ("pack", "limit_mm", "severity"),
    [
        ("paper_crack_width_v1", 0.2, "minor"),
        ("paper_crack_width_v1", 0.5, "moderate"),
        ("paper_crack_width_v1", 0.51, "not_measured"),
        ("bre251_v1", 0.1, "negligible"),
        ("bre251_v1", 1.0, "very_slight"),
        ("bre251_v1", 5.0, "slight"),
        ("bre251_v1", 5.1, "not_measured"),
        ("concrete_03_v1", 0.3, "within_limit"),
        ("concrete_03_v1", 0.31, "not_measured"),
        ("nyc_fisp_v1", 0.1, "SAFE"),
        ("nyc_fisp_v1", 0.2, "SWARMP"),
    ],
)
def test_narrower_than_the_resolution_is_graded_by_the_bound(pack: str, limit_mm: float, severity: str) -> None:
    assert grade_one(pack, crack_width_outcome="below_limit", crack_width_limit_mm=limit_mm) == severity
    # A limit is no bound where the width was measured, or where no line was found.
    assert (
        grade_one(pack, crack_width_outcome="measured", crack_width_mm=9.0, crack_width_limit_mm=limit_mm) != severity
    )
    if pack != "nyc_fisp_v1":
        assert grade_one(pack, crack_width_outcome="no_line") == "not_measured"


def test_a_long_crack_narrower_than_a_millimetre_is_not_proposed_unsafe() -> None:
    long = {"height_m": 3.1, "crack_width_outcome": "below_limit"}
    assert grade_one("nyc_fisp_v1", **long, crack_width_limit_mm=0.9) == "SWARMP"
    assert grade_one("nyc_fisp_v1", **long, crack_width_limit_mm=4.0) == "UNSAFE"


@pytest.mark.parametrize(
    ("material", "severity"),
    [
        ("Concrete, Cast In Situ", "over_limit"),
        ("Stahlbeton C30/37; Putz", "over_limit"),
        ("RC 300", "over_limit"),
        ("Concrete Masonry Units", "not_covered"),
        ("Brick, Common", "not_covered"),
        ("arched timber", "not_covered"),
        (None, "over_limit"),
    ],
)
def test_concrete_is_recognised_by_the_material(material: str | None, severity: str) -> None:
    assert grade_one("concrete_03_v1", crack_width_mm=0.4, material=material) == severity


@pytest.mark.parametrize(
    ("values", "severity"),
    [
        ({}, "SWARMP"),
        ({"height_m": 3.0}, "SWARMP"),
        ({"height_m": 3.1}, "UNSAFE"),
        ({"height_m": 2.0, "length_m": 3.1}, "UNSAFE"),
        ({"height_m": 3.1, "crack_width_mm": 0.9}, "SWARMP"),
        ({"height_m": 3.1, "crack_width_mm": 1.0}, "UNSAFE"),
        ({"height_m": 3.1, "crack_width_mm": 0.05}, "SAFE"),
        ({"defect_class": "spalling", "width_m": 0.09, "height_m": 0.09, "area_m2": 0.0081}, "SWARMP"),
        ({"defect_class": "spalling", "width_m": 0.10, "height_m": 0.02, "area_m2": 0.002}, "UNSAFE"),
        ({"defect_class": "moisture", "width_m": 9.0, "height_m": 9.0, "area_m2": 81.0}, "SWARMP"),
    ],
)
def test_fisp_errs_towards_the_worse_severity(values: dict[str, object], severity: str) -> None:
    assert grade_one("nyc_fisp_v1", **values) == severity


def test_every_pack_has_a_meaning_and_the_lake_ranks_its_severities() -> None:
    assert {"extent_v1", "paper_crack_width_v1", "bre251_v1", "concrete_03_v1", "nyc_fisp_v1"} <= set(list_rule_packs())
    (view,) = (view for view in read_statements(locate_source("sql/views")) if view.name == "severities")
    ranked: dict[str, list[str]] = {}
    for pack, severity, _ in open_duckdb().execute(f"{view.sql} ORDER BY severity_rule, severity_rank").fetchall():
        ranked.setdefault(pack, []).append(severity)
    assert ranked == {pack: read_severities(pack) for pack in list_rule_packs()}
    for pack in list_rule_packs():
        (statement,) = read_statement_file(RULE_FOLDER / f"{pack}.sql")
        assert statement.meaning


def test_graded_stage_table_fits_the_schema() -> None:
    table = stage_tables()["defects"]
    assert check_table("defects", grade_defects(table, find_rule_file("extent_v1"))).num_rows == 3
    assert grade_defects(table.slice(0, 0), find_rule_file("extent_v1")).schema == table.schema


def test_rule_that_does_not_grade_every_defect_once(tmp_path: Path) -> None:
    with pytest.raises(SchemaError, match="1 defects without a severity, such as 'd1'"):
        graded(tmp_path, "SELECT defect_id, 'bad' AS severity FROM defects WHERE defect_id = 'd0'")
    with pytest.raises(SchemaError, match="2 defects without a severity"):
        graded(tmp_path, "SELECT defect_id, NULL AS severity FROM defects")
    with pytest.raises(SchemaError, match="2 defects graded twice, such as 'd0'"):
        graded(tmp_path, "SELECT defect_id, 'bad' AS severity FROM defects, range(2)")
    with pytest.raises(SchemaError, match="1 defects that do not exist, such as 'x'"):
        graded(tmp_path, "SELECT defect_id, 'bad' AS severity FROM defects UNION ALL SELECT 'x', 'bad'")
    with pytest.raises(SchemaError, match="severities that are not one of bad, good, such as 'ugly'"):
        graded(tmp_path, "SELECT defect_id, 'ugly' AS severity FROM defects")


def test_rule_that_cannot_be_used(tmp_path: Path) -> None:
    with pytest.raises(
        InputDataError,
        match=r"extent_v9 in .* \(did you mean 'extent_v1'\?\); available: bre251_v1, ",
    ):
        find_rule_file("extent_v9")
    with pytest.raises(InputDataError, match="no severity rule pack"):
        find_rule_file("../severity/extent_v1")
    with pytest.raises(InputDataError, match="only a SELECT is allowed"):
        graded(tmp_path, "COPY defects TO 'x.csv'")
    with pytest.raises(InputDataError, match="table function read_csv is not allowed"):
        graded(tmp_path, "SELECT * FROM read_csv('/etc/passwd')")
    with pytest.raises(InputDataError, match="cannot be run"):
        graded(tmp_path, "SELECT defect_id, crack_depth_mm AS severity FROM defects")
    (tmp_path / "silent_v1.sql").write_text("SELECT defect_id, 'bad' AS severity FROM defects")
    with pytest.raises(InputDataError, match="has no header '-- severities"):
        grade_defects(defects(("crack", 1.0, 1.0, 1.0)), tmp_path / "silent_v1.sql")
