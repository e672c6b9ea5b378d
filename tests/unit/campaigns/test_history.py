"""The history of a building from its campaigns in the lake: ids, order, reviews, models that changed, clear errors."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from facadelake.building import BuildingModel
from facadelake.building.surface import Surface
from facadelake.campaigns import BuildingHistory, collect_campaign_views, count_photographs, read_history
from facadelake.core.errors import InputDataError
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import list_rows, table_from_rows
from facadelake.lake import TrackedHistory, answer_question, append_reviews, commit_campaign, read_table
from facadelake.reporting.history.comparison import compare_campaigns
from facadelake.reviews import review_track
from facadelake.severity import find_rule_file
from facadelake.tracking import build_history_tables, link_history, list_look_requests, look_at_places
from schemas.tables import LAKE_TABLES
from tasks.job import StageResult
from tasks.stage import Counts
from tasks.track import track_campaigns
from tests.unit.lake.small_campaign import BUILDING, HEIGHT, LAT, LON, lake_tables, rows

SPRING, AUTUMN, NEXT = (datetime(y, m, 14, 9, 0, tzinfo=UTC) for y, m in ((2026, 4), (2026, 10), (2027, 4)))


def build_wall(elements: pa.Table, top_m: float = 10.0) -> BuildingModel:
    """A wall at y = 0, 20 m long, that faces south."""
    corners = np.array([[-10.0, 0, 0], [10, 0, 0], [10, 0, top_m], [-10, 0, top_m]])
    return BuildingModel(
        origin=SiteOrigin(lon_deg=LON, lat_deg=LAT, height_ellipsoidal_m=HEIGHT),
        map_crs="EPSG:25832", vertical_datum="ellipsoidal", georeference_level="50", remarks="",
        vertices_site_m=corners, triangles=np.array([[0, 1, 2], [0, 2, 3]]), element_of_triangle=np.zeros(2, int),
        elements=elements,
    )  # fmt: skip


GEO = ("lon_deg", "lat_deg", "height_ellipsoidal_m")
MODEL = build_wall(table_from_rows("elements", rows()["elements"][:1]))


def track(
    lake: Path, current: dict[str, pa.Table] | None = None, model: BuildingModel = MODEL
) -> tuple[BuildingHistory, dict[str, pa.Table]]:
    history = read_history(lake, BUILDING, model, current)
    linked = link_history(history.records, 200.0)
    requests = list_look_requests(linked)
    looks = look_at_places(requests, collect_campaign_views(history, requests), Surface(model))
    made = build_history_tables(
        BUILDING,
        linked,
        {look.key: look for look in looks},
        history.known,
        origin=model.origin,
        rule_file=find_rule_file("extent_v1"),
    )
    return history, dict(made.tables)


def build_tables(campaign_id: str, start: datetime | None, run_id: str, **changed: Any) -> dict[str, pa.Table]:
    """A small campaign whose defects lie at their site coordinates on the globe, too."""
    note = f"{campaign_id} {run_id}"
    keys = {"building_id": BUILDING, "campaign_id": campaign_id, "run_id": run_id}
    tables = dict(lake_tables(**keys, start=start, note=note, inputs=f"{note:x<64}", **changed))
    site = np.column_stack([tables["defects"].column(f"{axis}_site_m").to_numpy() for axis in "xyz"])
    for name, values in zip(GEO, MODEL.origin.geo_from_site(site).T, strict=True):
        tables["defects"] = set_column(tables["defects"], name, values.tolist())
    return tables


def set_column(table: pa.Table, name: str, values: list[Any]) -> pa.Table:
    at = table.column_names.index(name)
    return table.set_column(at, table.schema.field(at), pa.array(values, table.schema.field(at).type))


def commit_tables(lake: Path, campaign_id: str, run_id: str, tables: dict[str, pa.Table]) -> dict[str, pa.Table]:
    """Track and commit a campaign; returns the tables of the history."""
    history, made = track(lake, tables)
    known = frozenset(history.known.tracks.column("track_id").to_pylist())
    commit_campaign(
        lake,
        building_id=BUILDING,
        campaign_id=campaign_id,
        run_id=run_id,
        tables=tables,
        inputs_sha256=tables["runs"].column("inputs_sha256")[0].as_py(),
        history=TrackedHistory(tables=made, run_ids=history.run_ids, known_tracks=known, code_sha256="c" * 64),
    )
    return made


def commit(
    lake: Path, campaign_id: str, start: datetime | None, run_id: str = "r1", **changed: Any
) -> dict[str, pa.Table]:
    """Track and commit a small campaign."""
    return commit_tables(lake, campaign_id, run_id, build_tables(campaign_id, start, run_id, **changed))


def make_stage(make: Callable[[Path], Counts], folder: Path) -> StageResult:
    """A stage that is run outside a flow."""
    folder.mkdir()
    counts = tuple(make(folder).items())
    return StageResult(
        stage="track", key="k", folder=folder, content_sha256="0", hit=False, seconds=0.0, peak_mib=0.0, counts=counts
    )


def read_states(made: dict[str, pa.Table]) -> dict[tuple[str, str], str]:
    return {(row["track_id"], row["campaign_id"]): row["track_state"] for row in list_rows(made["track_states"])}


def test_defects_keep_their_ids_through_campaigns_new_runs_and_late_arrivals(tmp_path: Path) -> None:
    commit(tmp_path, "2026-10", AUTUMN)
    second = commit(tmp_path, "2027-04", NEXT)
    assert {row["track_id"] for row in list_rows(second["tracks"])} == {f"tower-000{k}" for k in (1, 2, 3)}
    anew = commit(tmp_path, "2026-10", AUTUMN, run_id="r2")  # inspected again
    assert anew["tracks"].column("track_id").to_pylist() == second["tracks"].column("track_id").to_pylist()
    late = commit(tmp_path, "2026-04", SPRING)  # an older campaign arrives last
    assert set(late["tracks"].column("track_id").to_pylist()) == {f"tower-000{k}" for k in (1, 2, 3)}
    assert set(late["tracks"].column("first_campaign").to_pylist()) == {"2026-04"}
    assert set(late["tracks"].column("campaign_id").to_pylist()) == {"2027-04"}
    assert read_states(late)["tower-0001", "2026-04"] == "first_seen"
    assert read_states(late)["tower-0001", "2027-04"] == "seen"


def test_any_order_of_arrival_gives_the_same_history(tmp_path: Path) -> None:
    campaigns = {"2026-04": (SPRING, 2), "2026-10": (AUTUMN, 4), "2027-04": (NEXT, 3)}
    found = []
    for order in (("2026-04", "2026-10", "2027-04"), ("2027-04", "2026-04", "2026-10")):
        lake = tmp_path / order[0]
        for name in order:
            made = commit(lake, name, campaigns[name][0], defects=campaigns[name][1])
        rows_of = list_rows(made["track_states"])
        partition = {}
        for row in rows_of:
            partition.setdefault(row["track_id"], set()).add((row["campaign_id"], row["defect_id"], row["track_state"]))
        found.append({frozenset(one) for one in partition.values()})
    assert found[0] == found[1] and len(found[0]) == 4


def test_a_defect_that_is_gone_without_photographs_to_look_at_is_not_called_repaired(tmp_path: Path) -> None:
    commit(tmp_path, "2026-04", SPRING, defects=3)
    made = commit(tmp_path, "2026-10", AUTUMN, defects=2)
    found = {(row["track_id"], row["campaign_id"]): row for row in list_rows(made["track_states"])}
    state = found["tower-0003", "2026-10"]
    assert state["track_state"] in ("not_found", "not_imaged")
    assert state["state_evidence"] in ("no_photograph", "not_in_view")


def test_a_track_whose_campaign_is_inspected_anew_without_it_is_withdrawn_and_its_id_stays(tmp_path: Path) -> None:
    commit(tmp_path, "2026-04", SPRING, defects=3)
    made = commit(tmp_path, "2026-04", SPRING, run_id="r2", defects=2)
    withdrawn = {row["track_id"]: row["withdrawn"] for row in list_rows(made["tracks"])}
    assert withdrawn == {"tower-0001": False, "tower-0002": False, "tower-0003": True}
    again = commit(tmp_path, "2026-04", SPRING, run_id="r3", defects=3)
    assert {row["track_id"]: row["withdrawn"] for row in list_rows(again["tracks"])} == dict.fromkeys(withdrawn, False)


def test_a_model_with_new_global_ids_keeps_the_tracks_and_attribution_follows(tmp_path: Path) -> None:
    commit(tmp_path, "2026-04", SPRING)
    tables = build_tables("2026-10", AUTUMN, "r1")
    tables["defects"] = set_column(tables["defects"], "element_guid", ["0NewGlobalIdOfTheWall0"] * 3)
    _, made = track(tmp_path, tables)
    assert set(made["tracks"].column("track_id").to_pylist()) == {f"tower-000{k}" for k in (1, 2, 3)}
    assert set(made["tracks"].column("element_guid").to_pylist()) == {"0NewGlobalIdOfTheWall0"}
    remarks = {row["state_remark"] for row in list_rows(made["track_states"]) if row["campaign_id"] == "2026-10"}
    assert remarks == {"attributed to element 0NewGlobalIdOfTheWall0, in 2026-04 to 3vB2YO$MX4xv5uCqZZG05x"}


def test_campaigns_follow_their_photographs_times_and_contradicting_ids_are_told(tmp_path: Path) -> None:
    commit(tmp_path, "2026-04", AUTUMN)
    commit(tmp_path, "2026-10", SPRING)
    history, made = track(tmp_path)
    assert history.remarks == (
        "campaign 2026-10 was flown on 2026-04-14, before 2026-04 (2026-10-14), though its id is later: the history "
        "follows the photographs' times; correct the camera's clock or the campaign's name",
    )
    assert set(made["tracks"].column("first_campaign").to_pylist()) == {"2026-10"}


def test_two_campaigns_of_one_day_have_no_rates_and_it_is_told(tmp_path: Path) -> None:
    commit(tmp_path, "2026-04a", SPRING)
    made = commit(tmp_path, "2026-04b", SPRING.replace(hour=15))
    history, _ = track(tmp_path)
    assert history.remarks == (
        "campaigns 2026-04a and 2026-04b are of one day (2026-04-14): their order is that of their first photographs, "
        "and changes between them have no rate",
    )
    remarks = {row["state_remark"] for row in list_rows(made["track_states"]) if row["campaign_id"] == "2026-04b"}
    assert remarks == {"less than a day after the detection before: a rate would say nothing"}


def test_a_campaign_without_times_is_ordered_by_its_id_or_refused(tmp_path: Path) -> None:
    commit(tmp_path, "2026-10", AUTUMN)
    made = commit(tmp_path, "2025-10", None)
    (told,) = (row["detail"] for row in list_rows(made["frame_offsets"]) if row["campaign_id"] == "2025-10")
    assert "no photograph has a capture time: 2025-10-01 is taken from the id 2025-10" in told
    with pytest.raises(InputDataError) as raised:
        commit(tmp_path, "after-the-storm", None)
    assert str(raised.value) == (
        "no photograph of campaign after-the-storm has a capture time, and its id does not begin with a date such as "
        "2026-04: its place in the building's history is unknown; rename the campaign's folder"
    )


def test_a_frame_that_jumped_is_refused_by_name_and_the_others_go_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def place(name: str, start: datetime, shift_m: float) -> dict[str, pa.Table]:
        """Twelve defects at irregular places, one sigma of 1 cm, all shifted."""
        tables = build_tables(name, start, "r1", defects=12)
        x_m = np.cumsum(np.random.default_rng(0).uniform(0.6, 1.6, 12)) - 8.0 + shift_m
        tables["defects"] = set_column(tables["defects"], "x_site_m", x_m.tolist())
        for axis in ("east", "north", "up"):
            tables["georeference"] = set_column(tables["georeference"], f"sigma_{axis}_m", [0.01])
        return tables

    commit_tables(tmp_path, "2026-04", "r1", place("2026-04", SPRING, 0.0))
    made = commit_tables(tmp_path, "2026-10", "r1", place("2026-10", AUTUMN, 0.5))
    (refused,) = (row for row in list_rows(made["frame_offsets"]) if row["campaign_id"] == "2026-10")
    assert refused["offset_outcome"] == "refused" and abs(refused["offset_east_m"] - 0.5) < 0.02
    distance_m, limit_m = (float(number) for number in re.findall(r"(\d+\.\d+) m", refused["detail"]))
    assert abs(distance_m - 0.5) < 0.02 and limit_m < 0.25
    monkeypatch.setattr("tasks.track.read_building", lambda folder: MODEL)
    monkeypatch.setattr("tasks.track._look", lambda *_: {})
    monkeypatch.setattr("tasks.track.run_stage", lambda *_, make, **__: make_stage(make, tmp_path / "stage"))
    building = SimpleNamespace(id=BUILDING, severity_rules="extent_v1")
    job: Any = SimpleNamespace(building=building, code_sha256="c" * 64)
    history = read_history(tmp_path, BUILDING, MODEL, None)
    tracked = track_campaigns(job, make_stage(lambda _: {}, tmp_path / "model"), history)
    assert tracked.warnings == (
        "campaign 2026-10 is not part of the building's history: 12 defects agree that the positions of 2026-10 are "
        f"{distance_m:.2f} m off those of the campaigns before; the georeferencing of both admits {limit_m:.2f} m. "
        "Its defects are not matched: inspect that campaign, or the one before, with other control",
    )
    assert {row["campaign_id"] for row in list_rows(made["track_states"])} == {"2026-04"}
    _, made = track(tmp_path, place("2027-04", NEXT, 0.0))
    assert {row["campaign_id"] for row in list_rows(made["track_states"])} == {"2026-04", "2027-04"}
    assert len(made["tracks"]) == 12


def test_defects_of_a_facade_that_was_torn_down_are_not_imaged_and_it_is_told(tmp_path: Path) -> None:
    commit(tmp_path, "2026-04", SPRING)
    tables = build_tables("2026-10", AUTUMN, "r1", defects=0)
    _, made = track(tmp_path, tables, build_wall(MODEL.elements, top_m=1.0))  # the defects are at 3 m
    states = [row for row in list_rows(made["track_states"]) if row["campaign_id"] == "2026-10"]
    assert {row["track_state"] for row in states} == {"not_imaged"}
    assert {row["state_remark"] for row in states} == {"the building's model has no surface within 0.5 m"}


def test_the_word_of_a_person_is_kept_by_later_runs(tmp_path: Path) -> None:
    commit(tmp_path, "2026-04", SPRING)
    commit(tmp_path, "2026-10", AUTUMN, defects=2)
    row = {
        "building_id": BUILDING, "campaign_id": "2026-10", "run_id": "r1", "review_id": "", "track_id": "tower-0003",
        "track_state": "repaired", "reviewer": "M. Weber", "reviewed_at": NEXT, "note": "new render",
    }  # fmt: skip
    reviews = pa.Table.from_pylist([row], schema=LAKE_TABLES["track_reviews"].arrow)
    append_reviews(tmp_path, reviews, building_id=BUILDING, campaign_id="2026-10", name="track_reviews")
    made = commit(tmp_path, "2027-04", NEXT)
    states = read_states(made)
    assert states["tower-0003", "2026-10"] == "repaired"
    assert states["tower-0003", "2027-04"] == "reopened"
    (reviewed,) = (row for row in list_rows(made["track_states"]) if row["state_evidence"] == "review")
    assert reviewed["reviewer"] == "M. Weber"


def test_a_crack_that_spalled_keeps_its_track_and_has_no_change_of_size(tmp_path: Path) -> None:
    commit(tmp_path, "2026-04", SPRING)
    tables = build_tables("2026-10", AUTUMN, "r1")
    tables["defects"] = set_column(tables["defects"], "defect_class", ["spalling", "spalling", "moisture"])
    _, made = track(tmp_path, tables)
    (relation,) = list_rows(made["track_relations"])
    assert (relation["track_id"], relation["track_relation"]) == ("tower-0001", "class_changed")
    assert relation["detail"] == "crack in 2026-04, spalling since"
    changes = {
        row["track_id"]: row["area_change_m2"] for row in list_rows(made["track_states"]) if row["previous_campaign"]
    }
    assert changes["tower-0001"] is None and changes["tower-0002"] == pytest.approx(0.0)


def test_a_state_that_a_track_cannot_have_is_refused(tmp_path: Path) -> None:
    commit(tmp_path, "2026-04", SPRING)
    commit(tmp_path, "2026-10", AUTUMN)
    for campaign, state in (("2026-04", "repaired"), ("2026-04", "grown"), ("2026-10", "new")):
        with pytest.raises(InputDataError, match=f"track tower-0001 cannot be {state} in {campaign}"):
            review_track(tmp_path, "tower-0001", campaign, state, reviewer="M. Weber")
    with pytest.raises(InputDataError) as refused:
        review_track(tmp_path, "tower-0001", "2026-04", "repaired", reviewer="M. Weber")
    assert str(refused.value) == (
        "track tower-0001 cannot be repaired in 2026-04, the first campaign of its history; possible are new, "
        "first_seen, seen, not_found, not_imaged. A wrong detection is rejected by a review of the campaign's "
        "detections ('facadelake review')"
    )
    assert not len(read_table(tmp_path, "track_reviews"))
    assert review_track(tmp_path, "tower-0001", "2026-10", "repaired", reviewer="M. Weber").added.added == 1


def test_photographs_that_come_back_are_counted(tmp_path: Path) -> None:
    commit(tmp_path, "2026-04", SPRING)
    (record,) = read_history(tmp_path, BUILDING, MODEL, None).records
    assert count_photographs(record) == 0
    here = replace(record, root=tmp_path / "photos")
    for photo_id in record.posed:
        (here.root / photo_id).parent.mkdir(parents=True, exist_ok=True)
        (here.root / photo_id).touch()
    assert count_photographs(here) == len(record.posed) > 0


def test_a_comparison_of_two_successive_campaigns_is_that_of_their_states(tmp_path: Path) -> None:
    """One function tells changes and what is significant, of states and of comparisons."""
    campaigns = {"2026-04": (SPRING, 0.08), "2026-10": (AUTUMN, 0.16), "2027-04": (NEXT, 0.082)}
    for name, (start, area_m2) in campaigns.items():
        tables = build_tables(name, start, "r1", sightings=9)
        owners = tables["observations"].column("defect_id").to_pylist()
        grown = tables["defects"].column("defect_id").to_pylist()[1]  # a spall
        areas = [area_m2 if owner == grown else 0.08 for owner in owners]
        tables["observations"] = set_column(tables["observations"], "area_m2", areas)
        made = commit_tables(tmp_path, name, "r1", tables)
    read = {name: read_table(tmp_path, name) for name in ("campaigns", "defects", "observations")}
    states = {(row["track_id"], row["campaign_id"]): row for row in list_rows(made["track_states"])}
    for pair, word in ((("2026-04", "2026-10"), "grown"), (("2026-10", "2027-04"), "shrunk")):
        tracks = {track.track_id: track for track in compare_campaigns({**made, **read}, *pair).tracks}
        given = dict(zip(("from_campaign", "to_campaign"), pair, strict=True), building_id=BUILDING)
        answer = {row["track_id"]: row for row in answer_question(tmp_path, "campaigns_compared", given).to_pylist()}
        assert {name: row["finding"] for name, row in answer.items()} == {
            name: str(track.finding) for name, track in tracks.items()
        }
        grown_row = next(row for row in answer.values() if row["finding"] == word)
        difference = grown_row["area_to_m2"] - grown_row["area_from_m2"]
        assert grown_row["area_change_m2"] == pytest.approx(difference, abs=1e-4)  # sizes beside a change are its own
        assert len(tracks) == 3
        assert [str(track.finding) for track in tracks.values()].count(word) == 1
        for name, track in tracks.items():
            state = states[name, pair[1]]
            assert (track.finding in ("grown", "shrunk")) == (state["track_state"] == word)
            told = {change.quantity: (change.value, change.sigma) for change in track.changes}
            for quantity, column in (("area_m2", "area_change"), ("length_m", "length_change")):
                unit = quantity.rpartition("_")[2]
                if state[f"{column}_{unit}"] is not None:
                    assert told[quantity] == pytest.approx((state[f"{column}_{unit}"], state[f"{column}_sigma_{unit}"]))
                else:
                    assert quantity not in told
    taken_back = compare_campaigns({**made, **read}, "2026-04", "2027-04").tracks
    assert {str(track.finding) for track in taken_back} == {"unchanged"}
