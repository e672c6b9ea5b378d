"""Coverage is drawn in QGIS as on the sheets of the elevations; the style is read back from the GeoPackage."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from xml.etree import ElementTree

import pyarrow as pa
import pytest
from matplotlib.colors import to_hex

from facadelake.coverage import OBSTACLES
from facadelake.publish import NOT_IMAGED_FILLS, export_table
from facadelake.publish.coverage_styles import choose_limits_mm, create_coverage_style
from facadelake.reporting.elevations.coverage_figure import _choose_scale
from schemas.vocabulary import CoverageOutcome
from tests.unit.lake.small_campaign import lake_tables

Rules = dict[str, tuple[str, list[tuple[str, str]]]]  # filter, and colours and patterns, by label


def read_rules(style: str) -> Rules:
    root = ElementTree.fromstring(style.split("\n", 1)[1])
    fills = {}
    for symbol in root.iter("symbol"):
        layers = [{one.get("k"): one.get("v") for one in layer.iter("prop")} for layer in symbol.iter("layer")]
        assert {layer["outline_style"] for layer in layers} == {"no"}
        fills[symbol.get("name")] = [
            (to_hex([int(part) / 255 for part in layer["color"].split(",")]), layer["style"]) for layer in layers
        ]
    return {rule.get("label"): (rule.get("filter"), fills[rule.get("symbol")]) for rule in root.find(".//rules")}


def change(coverage: pa.Table, **columns: list[float | None]) -> pa.Table:
    for name, values in columns.items():
        place = coverage.schema.get_field_index(name)
        coverage = coverage.set_column(place, coverage.schema.field(name), pa.array(values, pa.float64()))
    return coverage


@pytest.fixture(scope="module")
def coverage() -> pa.Table:
    return lake_tables()["coverage"]


def test_each_layer_of_the_file_has_the_style(coverage: pa.Table, tmp_path: Path) -> None:
    path = export_table("coverage", coverage, tmp_path / "coverage.gpkg")
    with closing(sqlite3.connect(path)) as package:
        found = package.execute(
            "SELECT f_table_name, styleQML FROM layer_styles WHERE useAsDefault = 1 AND f_geometry_column = 'geometry'"
        ).fetchall()
    assert [name for name, _ in found] == ["coverage_3d", "coverage_S"]
    assert {style for _, style in found} == {create_coverage_style(coverage)}


def test_what_is_not_imaged_has_the_colour_and_the_words_of_the_elevation(coverage: pa.Table) -> None:
    rules = read_rules(create_coverage_style(coverage))
    assert set(NOT_IMAGED_FILLS) == set(CoverageOutcome) - {CoverageOutcome.IMAGED}
    assert {str(outcome): fill.meaning for outcome, fill in NOT_IMAGED_FILLS.items()} == dict(OBSTACLES)
    patterns = set()
    for outcome, fill in NOT_IMAGED_FILLS.items():
        condition, ((colour, solid), (white, pattern)) = rules[fill.meaning]
        assert (condition, colour) == (f"\"coverage_outcome\" = '{outcome}'", fill.colour.lower())
        assert (solid, white) == ("solid", "#ffffff")
        patterns.add(pattern)
    assert len(patterns) == 4  # told apart without colours
    condition, _ = rules["imaged, not searched by the detector"]
    assert condition == '"coverage_outcome" = \'imaged\' AND "searched_count" = 0'


def test_imaged_cells_have_the_classes_and_colours_of_the_elevation(coverage: pa.Table) -> None:
    widths = [0.4, 0.6, 1.2, 2.5, None]
    rules = read_rules(create_coverage_style(change(coverage, found_crack_width_mm=widths)))
    classes = {label: rule for label, rule in rules.items() if label.startswith("cracks found")}
    assert [label.removeprefix("cracks found: ") for label in classes] == [
        "0.3 to 0.5 mm", "0.5 to 0.7 mm", "0.7 to 1 mm", "1 to 1.5 mm", "1.5 to 2 mm", "2 to 3 mm",
    ]  # fmt: skip
    assert [condition for condition, _ in classes.values()][:2] == [
        '"found_crack_width_mm" < 0.5', '"found_crack_width_mm" >= 0.5 AND "found_crack_width_mm" < 0.7',
    ]  # fmt: skip
    values = pa.array(widths[:4]).to_numpy()
    norm, colours = _choose_scale(values)
    drawn = {to_hex(colours(norm(value))) for value in values}
    assert drawn <= {fills[0][0] for _, fills in classes.values()}
    assert to_hex(colours(norm(0.4))) == classes["cracks found: 0.3 to 0.5 mm"][1][0][0]
    assert to_hex(colours(norm(2.5))) == classes["cracks found: 2 to 3 mm"][1][0][0]


def test_without_a_recall_the_classes_are_of_the_pixel_on_the_surface(coverage: pa.Table) -> None:
    unknown = change(coverage, found_crack_width_mm=[None] * len(coverage))
    rules = read_rules(create_coverage_style(unknown))
    conditions = [condition for label, (condition, _) in rules.items() if label.startswith("pixel on the surface")]
    assert conditions and all('"gsd_mm" / cos(radians("incidence_deg"))' in condition for condition in conditions)
    nothing = change(unknown, gsd_mm=[None] * len(coverage))
    assert len(read_rules(create_coverage_style(nothing))) == 5


def test_one_value_is_one_class() -> None:
    assert choose_limits_mm(pa.array([1.0, 1.0]).to_numpy()).tolist() == [1.0, 1.5]
