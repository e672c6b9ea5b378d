"""What is worth flying again, and what no flight can see, of made tables ``coverage``."""

from __future__ import annotations

import pytest

from facadelake.building.surface import Surface
from facadelake.coverage import find_out_of_sight, find_unimaged_areas, list_reflights
from tests.unit.coverage.facade_scene import WALL, make_building
from tests.unit.coverage.test_summary import cell, make_table


def test_a_rectangle_is_one_area() -> None:
    cells = [cell(c, r, coverage_outcome="not_in_view") for c in range(4, 10) for r in range(-2, 3)]
    (area,) = find_unimaged_areas(make_table([*cells, cell(0, 0)]))
    assert (area.u_min_m, area.u_max_m, area.v_min_m, area.v_max_m) == (1.0, 2.5, -0.5, 0.75)
    assert area.area_m2 == pytest.approx(30 * 0.0625)  # m2
    assert (area.outcome, area.storeys) == ("not_in_view", ("Ground floor",))


def test_an_l_is_two_rectangles_that_contain_each_cell_once() -> None:
    upright = {(c, r) for c in range(2) for r in range(16)}
    foot = {(c, r) for c in range(2, 16) for r in range(2)}
    areas = find_unimaged_areas(make_table(cell(c, r, coverage_outcome="obstructed") for c, r in upright | foot))
    boxes = sorted((a.u_min_m, a.u_max_m, a.v_min_m, a.v_max_m) for a in areas)
    assert boxes == [(0.0, 0.5, 0.0, 4.0), (0.5, 4.0, 0.0, 0.5)]
    assert sum(area.area_m2 for area in areas) == pytest.approx(60 * 0.0625)  # m2


def test_facades_and_distant_areas_are_apart() -> None:
    cells = [cell(0, 0, coverage_outcome="grazing"), cell(9, 0, coverage_outcome="grazing")]
    cells += [cell(0, 0, coverage_outcome="not_in_view", facade="N", facade_azimuth_deg=0.0)]
    assert len(find_unimaged_areas(make_table(cells))) == 3


def test_full_coverage_leaves_nothing_to_fly() -> None:
    assert find_unimaged_areas(make_table([cell(0, 0)])) == []
    assert find_unimaged_areas(make_table([])) == []


def test_patches_that_two_cells_part_are_one_area() -> None:
    strips = [(c, r) for c in range(8) for r in (0, 1, 4, 5)]
    (area,) = find_unimaged_areas(make_table(cell(c, r, coverage_outcome="grazing") for c, r in strips))
    assert (area.v_min_m, area.v_max_m) == (0.0, 1.5)
    assert area.area_m2 == pytest.approx(32 * 0.0625)  # m2: without the strip between, which is imaged


def test_scraps_are_summed_and_not_listed() -> None:
    cells = [cell(c, r, coverage_outcome="not_in_view") for c in range(4) for r in range(2)]  # 0.5 m2
    cells += [cell(c, 0, coverage_outcome="obstructed") for c in (20, 30, 31)]
    table = make_table([*cells, cell(0, 12)])
    found = list_reflights(table, None)
    assert [area.area_m2 for area in found.areas] == [0.5]
    assert (found.small_count, found.small_m2, found.visible_m2) == (2, 0.1875, 0.6875)
    assert found.describe() == (
        "A flight could see 0.7 m² that no photograph shows, of which 0.2 m² in 2 areas of less than 0.5 m² are not "
        "listed; how much of it the building hides from every side is unknown without its model."
    )
    assert len(list_reflights(table, None, least_m2=0.0).areas) == 3
    assert list_reflights(make_table([cell(0, 0)]), None).areas == ()


@pytest.mark.parametrize(
    ("screen", "hidden_rows"),
    [
        (((-9.0, -1.1, -9.0), (17.0, -1.0, 13.0)), set(range(16))),  # 1 m before the whole wall
        (((-9.0, -4.1, -9.0), (17.0, -4.0, 13.0)), set()),  # a camera flies between
        (((-9.0, -1.1, -9.0), (17.0, -1.0, 2.0)), set()),  # open above: seen from above at 75 degrees
        (((-9.0, -0.5, 3.0), (17.0, 0.0, 3.2)), {12}),  # the cells behind the edge of a slab
    ],
)
def test_what_the_building_hides_from_every_camera_in_front_is_told_apart(screen, hidden_rows: set[int]) -> None:
    surface = Surface(make_building({"wall": WALL, "screen": screen}))
    table = make_table(cell(16, row, coverage_outcome="hidden_by_model") for row in range(16))
    hidden = find_out_of_sight(table, surface)
    assert {row for row, one in enumerate(hidden) if one} == hidden_rows
    found = list_reflights(table, surface)
    assert found.out_of_sight_m2 == len(hidden_rows) / 16
    assert found.visible_m2 == 1.0 - len(hidden_rows) / 16
    if len(hidden_rows) == 16:
        assert found.describe() == (
            "A flight could see 0.0 m² that no photograph shows. 1.0 m² more can be seen by no flight: the building "
            "hides them from every camera 3 m in front."
        )
