"""Each check of sql/checks finds the fault it is there for."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import duckdb
import pytest
import shapely

from facadelake.core.checkout import locate_source
from facadelake.core.duckdb_engine import open_duckdb
from facadelake.core.sql_files import read_statements
from facadelake.core.tables import table_from_rows
from facadelake.lake.checks import CHECKED, check_across_tables
from tests.unit.lake.small_campaign import HEIGHT, LAT, LON, history_rows
from tests.unit.lake.small_campaign import rows as campaign_rows


def rows(**settings: Any) -> dict[str, list[dict[str, Any]]]:
    """The small campaign and its history."""
    return {**campaign_rows(**settings), **history_rows(**settings)}


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


def _patch_at(north_m: float, up_m: float) -> bytes:
    """A patch of 20 x 20 cm on a wall that faces south, moved off the first defect of the small campaign."""
    lon, lat, height = LON, LAT + north_m / 111_320, HEIGHT + 3.0 + up_m
    east = 0.1 / (111_320 * math.cos(math.radians(LAT)))
    ring = [(lon - east, lat, height - 0.1), (lon + east, lat, height - 0.1), (lon + east, lat, height + 0.1),
            (lon - east, lat, height + 0.1)]  # fmt: skip
    return bytes(shapely.to_wkb(shapely.Polygon(ring)))


def _all_off_target(made: dict[str, list[dict[str, Any]]]) -> None:
    """Twelve detections in localised photographs, none on the building."""
    row = made["observations"][0]
    row.update(observation_outcome="off_target", reason="it misses the building", defect_id=None)
    made["observations"] += [row | {"detection_id": f"lost-{k}"} for k in range(12)]
    for other in made["observations"]:
        other.update(row | {"detection_id": other["detection_id"]})


COUNTEREXAMPLES = {
    "accepted_detections_are_observed_once": lambda made: made["observations"].pop(),
    "accepted_photographs_have_one_pose_row": lambda made: made["poses"].pop(),
    "best_photographs_show_the_defect": _set("defects", best_photo_id="closerange/elsewhere.jpg"),
    "covariances_of_defects": _set("defects", sigma_up_m=0.02),
    "covariances_of_observations": _set("observations", covariance_site=[1e-4] * 9),
    "covariances_of_poses": _set("poses", sigma_up_m=0.02),
    "counts_of_campaigns_agree": _set("campaigns", defects_total=99),
    "photo_counts_of_defects_agree": _set("defects", photo_count=7),
    "detections_are_on_the_building": _all_off_target,
    "detections_are_in_known_photographs": _set("detections", photo_id="closerange/elsewhere.jpg"),
    "rejected_detections_have_a_reason": _set("detections", detection_outcome="bad_box"),
    "coverage_outcomes_agree": _set("coverage", searched_count=99),
    "coverage_cells_are_in_the_grid": _set("coverage", x_site_m=-0.125),
    "elements_of_coverage": _set("coverage", element_guid="0" * 22),
    "elements_of_defects": _set("defects", element_guid="0" * 22),
    "elements_of_observations": _set("observations", element_guid="0" * 22),
    "held_out_points_are_counted": lambda made: made["georeference_points"].pop(),
    "geometry_of_defects": _swapped("defects"),
    "geometry_of_poses": _swapped("poses"),
    "georeference_counts": _set("georeference", points_used=50),
    "integrity_is_of_localised_photographs": _set("poses", pose_source="unlocalised"),
    "map_crs_is_unique": _set("georeference", map_crs="EPSG:25833"),
    "merges_are_of_registered_observations": _set("merges", other_detection_id="stranger"),
    "merge_decisions_agree_with_defects": _set("merges", merge_decision="apart", merge_reason="no_overlap"),
    "normals_of_coverage": _set("coverage", normal_y=-0.5),
    "normals_of_defects": _set("defects", normal_y=-0.5),
    "normals_of_observations": _set("observations", normal_y=-0.5),
    "unregistered_observations_have_a_reason": _set("observations", observation_outcome="masked"),
    "patches_of_defects": _set("defects", patch=_patch_at(0.0, 1.0)),
    "patches_of_observations": _set("observations", patch=_patch_at(0.5, 0.0)),
    "rejected_photographs_have_a_reason": _set("photos", photo_outcome="duplicate"),
    "poses_are_complete": _set("poses", qw=0.5),
    "registered_observations_are_complete": _set("observations", gsd_mm=None),
    "registered_observations_belong_to_a_defect": _no_defect,
    "runs_end_after_they_start": lambda made: made["runs"][0].update(
        started_at=made["runs"][0]["finished_at"].replace(year=2030)
    ),
    "defects_belong_to_one_track": lambda made: made["track_states"].pop(),
    "track_states_agree_with_tracks": _set("track_states", defect_id=None),
    "triangulated_defects_have_two_photographs": _set("defects", photo_count=1),
    "unlocalised_photographs_register_nothing": _set("observations", observation_outcome="unlocalised"),
}


def test_each_sql_check_has_a_counterexample_and_one_header() -> None:
    assert {check.name for check in read_statements(locate_source("sql/checks"))} == COUNTEREXAMPLES.keys()
    assert {check.table for check in read_statements(locate_source("sql/checks"))} <= set(CHECKED)


@pytest.fixture(scope="module")
def connection() -> Iterator[duckdb.DuckDBPyConnection]:
    """What ``check_across_tables`` asks on."""
    opened = open_duckdb("spatial")
    yield opened
    opened.close()


CHECKS = {check.name: check.sql for check in read_statements(locate_source("sql/checks"))}


def _found(connection: duckdb.DuckDBPyConnection, name: str, made: dict[str, list[dict[str, Any]]]) -> int:
    """Rows that one check finds."""
    for table in CHECKED:
        connection.register(table, table_from_rows(table, made[table]))
    return len(connection.execute(CHECKS[name]).fetchall())


@pytest.mark.parametrize("name", COUNTEREXAMPLES)
def test_sql_check_finds_its_counterexample(connection: duckdb.DuckDBPyConnection, name: str) -> None:
    made = rows()
    COUNTEREXAMPLES[name](made)
    assert _found(connection, name, made) >= 1


def _failures(made: dict[str, list[dict[str, Any]]]) -> dict[str, int]:
    results = check_across_tables({table: table_from_rows(table, made[table]) for table in CHECKED})
    return {row["expectation"]: row["unexpected"] for row in results if not row["passed"]}


def test_the_small_campaign_fails_no_check_and_a_changed_one_that_check_alone() -> None:
    assert _failures(rows()) == {}
    made = rows()
    made["defects"][0].update(photo_count=7)
    assert _failures(made) == {"sql:photo_counts_of_defects_agree": 1}


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


def _site(place: int, value: float) -> dict[str, Any]:
    covariance = list(rows()["defects"][0]["covariance_site"])
    covariance[place] = value
    return {"covariance_site": covariance}


@pytest.mark.parametrize(
    "values",
    [
        {"covariance_site": [1e-4] * 6},
        {"covariance_site": [1e-4, 2e-4, 0, 2e-4, 4e-4, 0, 0, 0, 9e-4]},  # singular: one line alone
        {"covariance_site": [1e-4, 0, 0, 0, 4e-4, 7e-4, 0, 7e-4, 9e-4]},  # correlation of 1.17
        {"sigma_north_m": None},
        _site(0, float("nan")),
        _site(8, -9e-4),
        _site(1, 1e-5),  # (0, 1) without (1, 0)
    ],
)
def test_covariances_of_places_that_are_none(connection: duckdb.DuckDBPyConnection, values: dict[str, Any]) -> None:
    for table in ("defects", "observations"):
        made = rows()
        made[table][1].update(values)
        assert _found(connection, f"covariances_of_{table}", made) == 1, table


def test_what_may_be_empty(connection: duckdb.DuckDBPyConnection) -> None:
    made = rows()
    for table in ("defects", "observations"):
        made[table][0].update(covariance_site=None, sigma_east_m=None, patch=None)
    made["merges"].clear()
    for name in CHECKS:
        assert _found(connection, name, made) == 0, name


def test_a_deviation_moves_a_defect_off_its_patch(connection: duckdb.DuckDBPyConnection) -> None:
    made = rows()
    made["defects"][0].update(patch=_patch_at(0.4, 0.0), deviation_from_model_m=None)
    assert _found(connection, "patches_of_defects", made) == 1
    made["defects"][0].update(deviation_from_model_m=-0.4, deviation_sigma_m=0.01)
    assert _found(connection, "patches_of_defects", made) == 0
    made["defects"][0].update(deviation_sigma_m=None)
    assert _found(connection, "triangulated_defects_have_two_photographs", made) == 1


def test_outvoted_observation_may_have_another_class_than_its_defect(connection: duckdb.DuckDBPyConnection) -> None:
    made = rows()
    made["observations"][0].update(defect_class="moisture")
    assert _found(connection, "registered_observations_belong_to_a_defect", made) == 1
    made["merges"][0].update(merge_reason="outvoted")
    assert _found(connection, "registered_observations_belong_to_a_defect", made) == 0


def _merge(first: str, second: str, decision: str, **defects: str) -> dict[str, Any]:
    reason = "geography" if decision == "joined" else "no_overlap"
    defect = {"defect_id": "defect-0000", "other_defect_id": "defect-0000"} | defects
    return {"detection_id": first, "other_detection_id": second, "merge_decision": decision, "merge_reason": reason,
            "separation_m": 0.01, "mahalanobis_distance": 0.5, **defect}  # fmt: skip


def test_pairs_that_say_something_else_than_the_tables(connection: duckdb.DuckDBPyConnection) -> None:
    one, two, three = (f"closerange/p{photo}.jpg#0" for photo in range(3))
    other = {"other_defect_id": "defect-0001"}
    consistent = [
        [_merge(one, two, "joined"), _merge(two, three, "joined"), _merge(one, three, "apart")],
        [_merge(one, "closerange/p1.jpg#1", "apart", **other)],
    ]
    for merges in consistent:
        made = rows(sightings=3)
        made["merges"] = merges
        assert _found(connection, "merge_decisions_agree_with_defects", made) == 0
        assert _found(connection, "merges_are_of_registered_observations", made) == 0
    for name, merges in (
        ("merge_decisions_agree_with_defects", [_merge(one, "closerange/p1.jpg#1", "joined", **other)]),
        ("merge_decisions_agree_with_defects", [_merge(one, two, "joined"), _merge(one, three, "apart")]),
        ("merges_are_of_registered_observations", [_merge(one, two, "joined", **other)]),
        ("merges_are_of_registered_observations", [_merge(one, one, "joined")]),
        ("merges_are_of_registered_observations", [_merge(one, two, "joined"), _merge(one, two, "joined")]),
        ("merges_are_of_registered_observations", [_merge(one, two, "joined"), _merge(two, one, "joined")]),
    ):
        made = rows(sightings=3)
        made["merges"] = merges
        assert _found(connection, name, made) == 1, (name, merges)
