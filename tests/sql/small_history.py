"""Three campaigns of the small building with their history, made by hand; the text order of their ids is not theirs.

| track | z-2025 (1 April 2025) | 2025-10 (1 October) | 2026-04 (1 April 2026) |
|---|---|---|---|
| 1, crack | first seen, 0.30 m | grown to 0.36 m | seen |
| 2, spalling | first seen | repaired | reopened |
| 3, moisture | first seen | repaired | still repaired |
| 4, crack | | new, 0.4 mm | grown to 0.5 mm |
| 5, spalling | | | new |
| 6, moisture | | | first seen |
| 7, crack | first seen | not imaged | repaired, says A. Mason |
| 8 | withdrawn | | |
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow as pa

from facadelake.core.tables import table_from_rows
from facadelake.lake.commit import commit_campaign
from facadelake.lake.migrate import open_to_write
from facadelake.lake.transaction import get_last_version, insert, make_version
from schemas.tables import LAKE_TABLES
from tests.unit.lake.small_campaign import BUILDING, INPUTS, _position, lake_tables

FIRST, SECOND, THIRD = "z-2025", "2025-10", "2026-04"
TIMES = {
    FIRST: datetime(2025, 4, 1, 8, tzinfo=UTC),
    SECOND: datetime(2025, 10, 1, 8, tzinfo=UTC),
    THIRD: datetime(2026, 4, 1, 8, tzinfo=UTC),
}
DEFECTS = {FIRST: 4, SECOND: 2, THIRD: 5}
ELEMENT = "3vB2YO$MX4xv5uCqZZG05x"
HALF, OTHER_HALF, WHOLE = 183 / 365.25, 182 / 365.25, 365 / 365.25

# Values of defects and of cells of coverage (by column) that are not those of the small campaign.
SIZES: dict[str, dict[int, dict[str, Any]]] = {
    FIRST: {0: {"length_m": 0.30}},
    SECOND: {
        0: {"length_m": 0.36},
        1: {"defect_class": "crack", "crack_width_mm": 0.4, "crack_width_sigma_mm": 0.014},
    },
    THIRD: {
        0: {"length_m": 0.36},
        1: {"area_m2": 0.1},
        2: {"defect_class": "crack", "crack_width_mm": 0.5, "crack_width_sigma_mm": 0.014},
        3: {"defect_class": "spalling", "severity": "severe"},
        4: {"defect_class": "moisture"},
    },
}
REACH = {0: {"found_crack_width_mm": 5.0}, 3: {"searched_count": 1, "found_crack_width_mm": 3.0}}
SEEN_AT_LAST = {4: {"imaged_count": 1, "searched_count": 1, "found_crack_width_mm": 0.8, "coverage_outcome": "imaged"}}


def _state(track: int, campaign: str, state: str, evidence: str, defect: int | None = None, **other: Any) -> dict:
    return {
        "building_id": BUILDING, "campaign_id": campaign, "run_id": f"run-{campaign}",
        "track_id": f"{BUILDING}-{track:04d}", "track_state": state, "state_evidence": evidence,
        "defect_id": None if defect is None else f"defect-{defect:04d}", "defect_class": CLASSES[track],
        "geometry": _position(track)["geometry"], **other,
    }  # fmt: skip


CLASSES = dict(enumerate(["crack", "spalling", "moisture", "crack", "spalling", "moisture", "crack", "crack"], start=1))


def _list_states() -> list[dict]:
    length = {"changed_quantity": "length_m", "length_change_m": 0.06, "length_change_sigma_m": 0.01}
    width = {"changed_quantity": "crack_width_mm", "crack_width_change_mm": 0.1, "crack_width_change_sigma_mm": 0.02}
    reopened = {"area_change_m2": 0.02, "area_change_sigma_m2": 0.015}
    return [
        _state(1, FIRST, "first_seen", "detected", 0),
        _state(1, SECOND, "grown", "detected", 0, previous_campaign=FIRST, years_since_previous=HALF, **length),
        _state(1, THIRD, "seen", "detected", 0, previous_campaign=SECOND, years_since_previous=OTHER_HALF,
               length_change_m=0.0, length_change_sigma_m=0.01),
        _state(2, FIRST, "first_seen", "detected", 1),
        _state(2, SECOND, "repaired", "looks_repaired"),
        _state(2, THIRD, "reopened", "detected", 1, previous_campaign=FIRST, years_since_previous=WHOLE, **reopened),
        _state(3, FIRST, "first_seen", "detected", 2),
        _state(3, SECOND, "repaired", "looks_repaired"),
        _state(3, THIRD, "repaired", "looks_repaired"),
        _state(4, SECOND, "new", "detected", 1),
        _state(4, THIRD, "grown", "detected", 2, previous_campaign=SECOND, years_since_previous=OTHER_HALF, **width),
        _state(5, THIRD, "new", "detected", 3),
        _state(6, THIRD, "first_seen", "detected", 4),
        _state(7, FIRST, "first_seen", "detected", 3),
        _state(7, SECOND, "not_imaged", "not_in_view"),
        _state(7, THIRD, "repaired", "review", reviewer="A. Mason", state_remark="plastered over"),
    ]  # fmt: skip


def _track(track: int, states: list[dict], sizes: Mapping[str, Any]) -> dict:
    own = [state for state in states if state["track_id"] == f"{BUILDING}-{track:04d}"]
    found = [state for state in own if state["defect_id"]]
    last = found[-1] if found else {"campaign_id": FIRST, "defect_id": "defect-0009"}
    there = [state["campaign_id"] for state in own if state["track_state"] not in ("repaired", "not_imaged")]
    return {
        "building_id": BUILDING, "campaign_id": THIRD, "run_id": f"run-{THIRD}", "track_id": f"{BUILDING}-{track:04d}",
        "defect_class": CLASSES[track], "track_state": own[-1]["track_state"] if own else None, "withdrawn": not own,
        "first_campaign": there[0] if there else None, "last_campaign": there[-1] if there else None,
        "detected_campaign": last["campaign_id"], "defect_id": last["defect_id"],
        "first_seen_at": TIMES[there[0]] if there else None, "last_seen_at": TIMES[there[-1]] if there else None,
        "detected_count": len(found), "severity": "minor", "severity_rule": "extent_v1", **_position(track),
        "width_m": 0.4, "height_m": 0.2, "length_m": 0.4, "area_m2": 0.08, "element_guid": ELEMENT,
        "ifc_class": "IfcWall", "element_name": "Wall S", "storey": "Level 1", "facade": "S",
        "facade_azimuth_deg": 180.0, "best_photo_id": "closerange/p0.jpg",
        **{name: value for name, value in sizes.items() if name != "crack_width_sigma_mm"},
    }  # fmt: skip


def make_history() -> dict[str, pa.Table]:
    """Tables tracks, track_states, track_relations and looks."""
    states = _list_states()
    keys = {"building_id": BUILDING, "campaign_id": SECOND, "run_id": f"run-{SECOND}"}
    sizes = {1: SIZES[THIRD][0], 2: SIZES[THIRD][1], 4: SIZES[THIRD][2], 5: SIZES[THIRD][3]}
    look = {
        **keys, "track_id": f"{BUILDING}-0002", "compared_campaign": FIRST, "defect_id": "defect-0001",
        "look_verdict": "gone", "look_count": 3, "compared_count": 2, "look_photo_id": "closerange/p1.jpg",
        "compared_photo_id": "closerange/p0.jpg", "look_similarity": 0.12,
    }  # fmt: skip
    relation = {**keys, "track_id": f"{BUILDING}-0004", "track_relation": "split_from",
                "other_track_id": f"{BUILDING}-0001", "detail": "beside it"}  # fmt: skip
    return {
        "tracks": table_from_rows("tracks", [_track(number, states, sizes.get(number, {})) for number in CLASSES]),
        "track_states": table_from_rows("track_states", states),
        "track_relations": table_from_rows("track_relations", [relation]),
        "looks": table_from_rows("looks", [look]),
    }


def _change_rows(table: pa.Table, changes: Mapping[int, Mapping[str, Any]]) -> pa.Table:
    rows = [{**row, **changes.get(place, {})} for place, row in enumerate(table.to_pylist())]
    return pa.Table.from_pylist(rows, schema=table.schema)


def _size_sightings(observations: pa.Table, sizes: Mapping[int, Mapping[str, Any]]) -> dict[int, dict[str, Any]]:
    """Length and area of the defects by the row of each of their sightings."""
    owners = observations.column("defect_id").to_pylist()
    return {
        place: {name: value for name, value in own.items() if name in ("length_m", "area_m2")}
        for number, own in sizes.items()
        for place, owner in enumerate(owners)
        if owner == f"defect-{number:04d}"
    }


def commit_small_campaign(lake: Path, campaign: str) -> int:
    """Commit one of the three campaigns; the version of the lake."""
    run = f"run-{campaign}"
    made = lake_tables(campaign_id=campaign, run_id=run, defects=DEFECTS[campaign], start=TIMES[campaign])
    reach = REACH | SEEN_AT_LAST if campaign == THIRD else {}
    tables = {
        **made,
        "defects": _change_rows(made["defects"], SIZES[campaign]),
        "observations": _change_rows(made["observations"], _size_sightings(made["observations"], SIZES[campaign])),
        "coverage": _change_rows(made["coverage"], reach),
    }
    return commit_campaign(
        lake, building_id=BUILDING, campaign_id=campaign, run_id=run, tables=tables, inputs_sha256=INPUTS
    ).version


def insert_history(lake: Path) -> int:
    """Write the history of the three campaigns as a version of its own."""
    with open_to_write(lake, 10.0) as connection:
        origin = {"building_id": BUILDING, "campaign_id": THIRD, "run_id": f"run-{THIRD}"}
        with make_version(connection, "history", origin):
            for name, table in make_history().items():
                insert(connection, LAKE_TABLES[name], table)
        return get_last_version(connection)


def commit_history(lake: Path) -> dict[str, int]:
    """The three campaigns and their history in a new lake; the versions by campaign, and of the ``history``."""
    versions = {campaign: commit_small_campaign(lake, campaign) for campaign in (FIRST, SECOND, THIRD)}
    return {**versions, "history": insert_history(lake)}
