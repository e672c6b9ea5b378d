"""Each check of sql/checks finds the fault it is there for."""

from collections.abc import Callable, Iterator
from typing import Any

import duckdb
import pytest
import shapely

from facadelake.lake.connect import bare_connection
from facadelake.lake.expectations import CHECKED, across_tables
from facadelake.lake.sqlfiles import statements
from facadelake.tables import table_of_rows
from tests.unit.lake.small_campaign import rows


def _no_defect(made: dict[str, list[dict[str, Any]]]) -> None:
    made["observations"][0]["defect_id"] = "defect-9999"


def _swapped(table: str) -> Callable[[dict[str, list[dict[str, Any]]]], None]:
    def change(made: dict[str, list[dict[str, Any]]]) -> None:
        row = made[table][0]
        point = shapely.Point(row["lat_deg"], row["lon_deg"], row["height_ellipsoidal_m"])
        row["geometry"] = shapely.to_wkb(point)

    return change


def _set(table: str, **values: Any) -> Callable[[dict[str, list[dict[str, Any]]]], None]:
    return lambda made: made[table][0].update(values)


COUNTEREXAMPLES = {
    "accepted_detections_are_observed_once": lambda made: made["observations"].pop(),
    "accepted_photographs_have_one_pose_row": lambda made: made["poses"].pop(),
    "best_photographs_show_the_defect": _set("defects", best_photo_id="closerange/elsewhere.jpg"),
    "covariances_of_poses": _set("poses", sigma_up_m=0.02),
    "counts_of_the_campaign": _set("campaigns", defects_total=99),
    "defects_are_seen_as_often_as_they_say": _set("defects", sightings=7),
    "detections_are_in_known_photographs": _set("detections", photo_id="closerange/elsewhere.jpg"),
    "detections_refused_have_a_reason": _set("detections", detection_outcome="bad_box"),
    "elements_of_defects": _set("defects", element_guid="0" * 22),
    "elements_of_observations": _set("observations", element_guid="0" * 22),
    "held_out_points_are_counted": lambda made: made["georeference_points"].pop(),
    "geometry_of_defects": _swapped("defects"),
    "geometry_of_poses": _swapped("poses"),
    "georeference_counts": _set("georeference", points_used=50),
    "integrity_is_of_localised_photographs": _set("poses", pose_source="unlocalised"),
    "map_crs_is_one": _set("georeference", map_crs="EPSG:25833"),
    "normals_of_defects": _set("defects", normal_y=-0.5),
    "normals_of_observations": _set("observations", normal_y=-0.5),
    "photographs_refused_have_a_reason": _set("photos", photo_outcome="duplicate"),
    "poses_are_whole": _set("poses", qw=0.5),
    "registered_observations_are_whole": _set("observations", gsd_mm=None),
    "registered_observations_belong_to_a_defect": _no_defect,
    "run_ends_after_it_began": lambda made: made["runs"][0].update(
        started_at=made["runs"][0]["finished_at"].replace(year=2030)
    ),
    "unlocalised_photographs_register_nothing": _set("observations", observation_outcome="unlocalised"),
}


def test_each_sql_check_has_a_counterexample_and_one_header() -> None:
    assert {check.name for check in statements("checks")} == COUNTEREXAMPLES.keys()
    assert {check.table for check in statements("checks")} <= set(CHECKED)


@pytest.fixture(scope="module")
def connection() -> Iterator[duckdb.DuckDBPyConnection]:
    """What ``across_tables`` asks on."""
    opened = bare_connection("spatial")
    yield opened
    opened.close()


CHECKS = {check.name: check.sql for check in statements("checks")}


def _found(connection: duckdb.DuckDBPyConnection, name: str, made: dict[str, list[dict[str, Any]]]) -> int:
    """Rows that one check finds."""
    for table in CHECKED:
        connection.register(table, table_of_rows(table, made[table]))
    return len(connection.execute(CHECKS[name]).fetchall())


@pytest.mark.parametrize("name", COUNTEREXAMPLES)
def test_sql_check_finds_its_counterexample(connection: duckdb.DuckDBPyConnection, name: str) -> None:
    made = rows()
    COUNTEREXAMPLES[name](made)
    assert _found(connection, name, made) >= 1


def _failures(made: dict[str, list[dict[str, Any]]]) -> dict[str, int]:
    results = across_tables({table: table_of_rows(table, made[table]) for table in CHECKED})
    return {row["expectation"]: row["unexpected"] for row in results if not row["passed"]}


def test_the_small_campaign_fails_no_check_and_a_changed_one_that_check_alone() -> None:
    assert _failures(rows()) == {}
    made = rows()
    made["defects"][0].update(sightings=7)
    assert _failures(made) == {"sql:defects_are_seen_as_often_as_they_say": 1}


def _changed(place: int, value: float) -> list[float]:
    covariance = list(rows()["poses"][0]["covariance"])
    covariance[place] = value
    return covariance


@pytest.mark.parametrize(
    "values",
    [
        {"covariance": None},
        {"covariance": [1e-4] * 9},
        {"covariance": _changed(3, float("nan"))},
        {"covariance": _changed(28, -1e-8)},  # the second angle's variance
        {"covariance": _changed(1, 1e-6)},  # (0, 1) without (1, 0)
        {"sigma_east_m": None},
        {"pose_source": "unlocalised"},
    ],
)
def test_covariances_that_are_none(connection: duckdb.DuckDBPyConnection, values: dict[str, Any]) -> None:
    made = rows()
    made["poses"][1].update(values)
    assert _found(connection, "covariances_of_poses", made) == 1


def test_passports_that_do_not_tell_of_their_points(connection: duckdb.DuckDBPyConnection) -> None:
    for values in ({"check_points": 2}, {"check_residual_max_m": None}, {"check_residual_max_m": 0.2}):
        made = rows()
        made["georeference"][0].update(values)
        assert _found(connection, "held_out_points_are_counted", made) == 1, values
    without = rows()
    without["georeference_points"].clear()
    without["georeference"][0].update(check_points=0, check_residual_mean_m=None, check_residual_max_m=None)
    assert _found(connection, "held_out_points_are_counted", without) == 0
