from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from facadelake.core.tables import table_from_rows
from facadelake.reporting.distribution import (
    NO_STOREY,
    compute_distribution,
    draw_distribution,
    format_distribution_title,
    write_distribution,
)
from facadelake.reporting.drawing.palette import bgr_from_hex, get_class_colour
from facadelake.reporting.inspection import Inspection
from tests.unit.reporting.painted_wall import PaintedWall, make_defect_row, make_inspection


@pytest.fixture
def spread(painted: PaintedWall) -> Inspection:
    rows = [
        *(make_defect_row(f"A{n}", 1.0, 1.0, facade="S") for n in range(3)),
        *(make_defect_row(f"B{n}", 1.0, 1.0, facade="S", defect_class="moisture") for n in range(2)),
        make_defect_row("C", 1.0, 1.0, facade="N-2", storey=None, area_m2=0.5),
        make_defect_row("D", 1.0, 1.0, facade="level", defect_class="spalling"),
    ]
    return make_inspection(painted, rows, [])


def test_every_defect_is_counted_once(spread: Inspection) -> None:
    found = compute_distribution(spread)
    assert found.count_defects() == 7
    assert found.count_defects("S") == 5
    assert found.count_defects("S", "moisture") == 2
    assert found.counts["N-2", NO_STOREY, "crack"] == 1
    assert found.storeys == ("Ground <floor>", NO_STOREY)


def test_facades_stand_clockwise_and_those_without_a_direction_last(painted: PaintedWall, spread: Inspection) -> None:
    element = painted.building.elements.to_pylist()[0]
    azimuths = {"S": 180.0, "N-2": 350.0, "E": None, "level": None}
    elements = table_from_rows(
        "elements",
        [
            {**element, "element_guid": name, "facade": name, "facade_azimuth_deg": turn}
            for name, turn in azimuths.items()
        ],
    )
    rows = [{**row, "facade": "E"} if row["defect_id"] == "A0" else row for row in spread.defects.to_pylist()]
    building = replace(painted.building, elements=elements)
    found = compute_distribution(replace(spread, building=building, defects=table_from_rows("defects", rows)))
    assert found.facades == ("E", "S", "N-2", "level")  # E by its word alone


def test_the_table_has_a_line_for_each_number(spread: Inspection, tmp_path: Path) -> None:
    with write_distribution(compute_distribution(spread), tmp_path / "d.csv").open(
        newline="", encoding="utf-8"
    ) as file:
        lines = list(csv.DictReader(file))
    assert {(row["facade"], row["storey"], row["defect_class"]): row["defects"] for row in lines} == {
        ("S", "Ground <floor>", "crack"): "3", ("S", "Ground <floor>", "moisture"): "2",
        ("N-2", NO_STOREY, "crack"): "1", ("level", "Ground <floor>", "spalling"): "1",
    }  # fmt: skip
    assert sum(float(row["area_m2"]) for row in lines) == pytest.approx(6 * 0.08 + 0.5, abs=1e-3)


def test_bars_are_as_long_as_their_numbers(spread: Inspection, tmp_path: Path) -> None:
    only = [row for row in spread.defects.to_pylist() if row["facade"] == "S"]
    one = replace(spread, defects=table_from_rows("defects", only))
    path = draw_distribution(compute_distribution(one), format_distribution_title(one), tmp_path / "d.png")
    picture = cv2.imread(str(path)).astype(int)[130:]  # below title and legend
    lengths = {}
    for word in ("crack", "moisture"):
        ink = np.abs(picture - np.array(bgr_from_hex(get_class_colour(word)))).max(axis=2) < 30
        columns = np.flatnonzero(ink.any(axis=0))
        lengths[word] = columns.max() - columns.min() + 1
    assert lengths["crack"] / lengths["moisture"] == pytest.approx(3 / 2, rel=0.02)


def test_no_defects_and_many_facades_are_drawn(painted: PaintedWall, tmp_path: Path) -> None:
    empty = make_inspection(painted, [], [])
    assert draw_distribution(compute_distribution(empty), "none", tmp_path / "none.png").stat().st_size > 2000
    rows = [make_defect_row(f"D{n}", 1.0, 1.0, facade=f"F{n}") for n in range(14)]
    many = make_inspection(painted, rows, [])
    picture = cv2.imread(str(draw_distribution(compute_distribution(many), "many", tmp_path / "many.png")))
    assert picture.shape[1] < 2200
    assert format_distribution_title(many).endswith("14 defects by facade and storey")
