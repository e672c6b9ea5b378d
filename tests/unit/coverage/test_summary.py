"""Totals of a made table ``coverage``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from facadelake.core.tables import table_from_rows
from facadelake.coverage import find_nearest_cells, summarise_coverage


def cell(column: int, row: int, **others: Any) -> dict[str, Any]:
    """An imaged and searched cell of facade S; not imaged where ``coverage_outcome`` says so."""
    is_imaged = others.get("coverage_outcome", "imaged") == "imaged"
    found = {"gsd_mm": 5.0, "incidence_deg": 10.0, "found_crack_width_mm": 1.0, "found_patch_mm": 50.0}
    return {
        "facade": "S", "facade_azimuth_deg": 180.0, "cell_column": column, "cell_row": row, "element_guid": "wall",
        "cell_layer": 0, "storey": "Ground floor", "coverage_outcome": "imaged", "u_min_m": column / 4,
        "u_max_m": (column + 1) / 4, "v_min_m": row / 4, "v_max_m": (row + 1) / 4, "area_m2": 0.0625,
        "x_site_m": column / 4 + 0.125, "y_site_m": 0.0, "z_site_m": row / 4 + 0.125, "normal_x": 0.0,
        "normal_y": -1.0, "normal_z": 0.0, "imaged_count": int(is_imaged), "searched_count": int(is_imaged),
        "geometry": b"", **(found if is_imaged else {}), **others,
    }  # fmt: skip


def make_table(cells: Iterable[dict[str, Any]]) -> pa.Table:
    return table_from_rows("coverage", list(cells))


def test_totals_are_of_areas_and_storeys_come_from_the_top() -> None:
    cells = [cell(c, 0) for c in range(8)]
    cells += [cell(c, 20, storey="First floor", coverage_outcome="obstructed") for c in range(4)]
    cells += [cell(4, 20, storey="First floor", searched_count=0)]
    facade, first, ground = summarise_coverage(make_table(cells))
    assert (facade.facade, facade.storey, first.storey, ground.storey) == ("S", "all", "First floor", "Ground floor")
    assert facade.surface_m2 == pytest.approx(13 * 0.0625)  # m2
    assert facade.imaged_share == pytest.approx(9 / 13)
    assert first.prevented_m2 == {"obstructed": pytest.approx(0.25)}
    assert first.searched_m2 == 0
    assert first.found_crack_width_mm is None
    assert ground.found_crack_width_mm == 1.0


def test_the_width_found_is_that_of_nine_tenths_of_the_searched_surface() -> None:
    cells = [cell(c, 0, found_crack_width_mm=float(c + 1)) for c in range(10)]
    (facade, _) = summarise_coverage(make_table(cells))
    assert facade.found_crack_width_mm == 9.0  # mm


def test_a_width_that_is_unknown_anywhere_is_unknown() -> None:
    (facade, _) = summarise_coverage(make_table([cell(0, 0), cell(1, 0, found_crack_width_mm=None)]))
    assert facade.found_crack_width_mm is None
    assert facade.found_patch_mm == 50.0


def test_a_place_has_the_cell_it_is_in() -> None:
    table = make_table(cell(c, 0) for c in range(8))
    rows = find_nearest_cells(table, np.array([[0.3, 0.02, 0.1], [1.9, 0.0, 0.2], [1.0, 5.0, 0.1]]))
    columns = table.column("cell_column").to_pylist()
    assert [columns[row] for row in rows[:2]] == [1, 7]
    assert rows[2] == -1  # 5 m before the wall
    assert find_nearest_cells(make_table([]), np.zeros((2, 3))).tolist() == [-1, -1]


def test_a_sliver_of_a_facade_is_no_total() -> None:
    sliver = cell(0, 0, facade="N", facade_azimuth_deg=0.0, area_m2=0.02)
    assert {total.facade for total in summarise_coverage(make_table([cell(0, 0), cell(1, 0), sliver]))} == {"S"}


def test_no_cells_are_no_totals() -> None:
    assert summarise_coverage(make_table([])) == []
