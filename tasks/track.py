"""Task: follow the building's defects through all its campaigns."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from prefect import task

from facadelake.building import read_building
from facadelake.building.surface import Surface
from facadelake.campaigns import (
    BuildingHistory,
    collect_campaign_views,
    count_photographs,
    find_same_run,
    read_history,
)
from facadelake.core.errors import InputDataError
from facadelake.core.hashing import compute_key, hash_file
from facadelake.core.progress import report_progress
from facadelake.core.tables import list_rows, read_table, write_table
from facadelake.lake import TrackedHistory, build_lake_tables, commit_history
from facadelake.severity import find_rule_file
from facadelake.tracking import (
    LookRequest,
    build_history_tables,
    link_history,
    list_look_requests,
    look_at_places,
    read_look_files,
    write_look_files,
)
from schemas.tables import HISTORY_TABLES
from schemas.vocabulary import OffsetOutcome
from tasks.job import InspectionJob, StageResult, StageResults
from tasks.record import assemble_campaign
from tasks.stage import Counts, run_stage

LOOKS = "looks"  # folder of pictures, published; named by track, campaign that detected it and campaign looked at


@dataclass(frozen=True, kw_only=True)
class TrackedCampaigns:
    """The tables of the history, the runs of the campaigns they are made of, the tracks that the lake had, the code."""

    stage: StageResult
    run_ids: Mapping[str, str]
    known_tracks: frozenset[str]
    code_sha256: str
    warnings: tuple[str, ...]


@task(name="track")
def track(job: InspectionJob, results: StageResults) -> TrackedCampaigns:
    """Tables of the history of the building: its campaigns in the lake, and this one."""
    run, tables = assemble_campaign(job, results)
    run = replace(run, run_id=find_same_run(job.lake, run) or run.run_id)
    model = read_building(results.model.folder)
    with report_progress("Reading the building's campaigns"):
        history = read_history(job.lake, job.building.id, model, build_lake_tables(tables, run))
    return track_campaigns(job, results.model, history)


def track_campaigns(job: InspectionJob, model: StageResult, history: BuildingHistory) -> TrackedCampaigns:
    """Tables of the history of a building, whose model is that of ``model``."""
    building = read_building(model.folder)
    rule_file = find_rule_file(job.building.severity_rules)
    with report_progress("Matching the defects of all campaigns"):
        linked = link_history(history.records, sum(building.elements.column("surface_area_m2").to_pylist()))
    looked = _look(job, model, history, list_look_requests(linked))

    def make(folder: Path) -> Counts:
        looks = {look.key: look for result in looked.values() for look in read_look_files(result.folder)}
        made = build_history_tables(
            job.building.id, linked, looks, history.known, origin=building.origin, rule_file=rule_file
        )
        for name in HISTORY_TABLES:
            write_table(name, made.tables[name], folder)
        (folder / LOOKS).mkdir()
        for name, picture in made.pictures.items():
            (folder / LOOKS / name).write_bytes(picture)
        latest = linked.campaigns[-1].campaign_id
        states = [row for row in list_rows(made.tables["track_states"]) if row["campaign_id"] == latest]
        return {"tracks": len(made.tables["tracks"]), **Counter(row["track_state"] for row in states)}

    known = {name: list_rows(table) for name, table in vars(history.known).items()}
    inputs = {
        "known": compute_key({"rows": repr(known)}),
        "runs": history.run_ids,
        "inputs": {one.campaign_id: one.inputs_sha256 for one in history.records},
        "rules": hash_file(rule_file),
    }
    stage = run_stage(job, "track", reads={"model": model, **looked}, inputs=inputs, make=make)
    refused = [
        f"campaign {row['campaign_id']} is not part of the building's history: {row['detail']}"
        for row in list_rows(read_table("frame_offsets", stage.folder))
        if row["offset_outcome"] == OffsetOutcome.REFUSED
    ]
    return TrackedCampaigns(
        stage=stage,
        run_ids=history.run_ids,
        known_tracks=frozenset(row["track_id"] for row in known["tracks"]),
        code_sha256=job.code_sha256,
        warnings=(*history.remarks, *refused),
    )


@task(name="commit tracks")
def commit_tracks(job: InspectionJob, tracked: TrackedCampaigns) -> int | None:
    """Commit the history by itself; returns the version, None where nothing has changed."""
    return commit_history(job.lake, build_tracked_history(tracked), building_id=job.building.id)


def build_tracked_history(tracked: TrackedCampaigns) -> TrackedHistory:
    """The history as the lake takes it."""
    return TrackedHistory(
        tables={name: read_table(name, tracked.stage.folder) for name in HISTORY_TABLES},
        run_ids=tracked.run_ids,
        known_tracks=tracked.known_tracks,
        code_sha256=tracked.code_sha256,
    )


@task(name="track all campaigns")
def track_committed(job: InspectionJob, model: StageResult) -> TrackedCampaigns:
    """Tables of the history of the building from its campaigns in the lake alone."""
    history = read_history(job.lake, job.building.id, read_building(model.folder), None)
    if not history.records:
        raise InputDataError(
            f"the lake {job.lake} has no campaign of '{job.building.id}'; "
            f"run 'facadelake inspect {job.building.id}' first"
        )
    return track_campaigns(job, model, history)


def _look(
    job: InspectionJob, model: StageResult, history: BuildingHistory, requests: list[LookRequest]
) -> dict[str, StageResult]:
    """The looks at the places of defects, once for each pair of campaigns."""
    by_pair: dict[tuple[str, str], list[LookRequest]] = {}
    for request in requests:
        by_pair.setdefault((request.seen_campaign, request.campaign_id), []).append(request)
    runs = {one.campaign_id: [one.inputs_sha256, count_photographs(one)] for one in history.records}
    found = {}
    for (seen, other), wanted in sorted(by_pair.items()):

        def make(folder: Path, wanted: list[LookRequest] = wanted) -> Counts:
            surface = Surface(read_building(model.folder))
            looks = look_at_places(wanted, collect_campaign_views(history, wanted), surface)
            write_look_files(looks, folder)
            return Counter(look.verdict for look in looks)

        inputs = {
            "campaigns": [[seen, *runs[seen]], [other, *runs[other]]],
            "places": [_describe(one) for one in wanted],
        }
        found[f"{seen} in {other}"] = run_stage(job, "look", reads={"model": model}, inputs=inputs, make=make)
    return found


def _describe(request: LookRequest) -> list[Any]:
    """A request as JSON, to a tenth of a millimetre."""
    numbers = [*request.xyz_seen_m, *request.xyz_other_m, *request.normal_site, request.width_m, request.height_m]
    return [request.defect_id, *(round(float(number), 4) for number in numbers)]
