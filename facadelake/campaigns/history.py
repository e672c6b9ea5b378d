"""The campaigns of a building read from the lake for tracking, with one that is not committed yet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import pairwise
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from facadelake.building import BuildingModel
from facadelake.campaigns.capture_order import has_date, resolve_capture_time
from facadelake.core.tables import list_rows
from facadelake.lake import RunRecord, has_lake, read_table, read_tables
from facadelake.tracking import CampaignRecords, CampaignViews, KnownHistory, LookRequest, read_records
from schemas.tables import LAKE_TABLES

_READ = ("buildings", "campaigns", "runs", "georeference", "poses", "observations", "defects")
_KNOWN = ("tracks", "track_states", "track_reviews")


@dataclass(frozen=True, kw_only=True, eq=False)
class BuildingHistory:
    """All campaigns of a building, and its tracks so far; ``remarks``: what is odd in the campaigns' times."""

    records: Sequence[CampaignRecords]
    known: KnownHistory
    remarks: tuple[str, ...]

    @property
    def run_ids(self) -> dict[str, str]:
        """The run of each campaign."""
        return {one.campaign_id: one.run_id for one in self.records}


def read_history(
    lake: Path, building_id: str, model: BuildingModel, current: Mapping[str, pa.Table] | None
) -> BuildingHistory:
    """Read the campaigns of a building.

    Args:
        lake: folder of the lake; it may not exist yet.
        building_id: the building.
        model: its model, whose site frame all campaigns are moved into.
        current: tables of a campaign (lake form) that replaces, or is added to, those of the lake.

    Raises InputDataError for a campaign without capture times whose id is no date: its place in the order is unknown.
    """
    tables = _read_lake(lake, building_id)
    found = _split_by_campaign(tables)
    if current is not None:
        found[current["campaigns"].column("campaign_id")[0].as_py()] = current
    records = []
    for campaign_id, of_campaign in sorted(found.items()):
        captured_at, remark = find_capture_time(campaign_id, of_campaign["campaigns"])
        record = read_records(of_campaign, captured_at=captured_at, origin=model.origin)
        records.append(replace(record, time_remark=remark))
    known = KnownHistory(tracks=tables["tracks"], states=tables["track_states"], reviews=tables["track_reviews"])
    return BuildingHistory(records=records, known=known, remarks=_remark_order(records))


def find_same_run(lake: Path, run: RunRecord) -> str | None:
    """The committed run of the same inputs, code and configuration; None: the lake has none."""
    if not has_lake(lake):
        return None
    rows = list_rows(read_table(lake, "runs", building_id=run.building_id, campaign_id=run.campaign_id))
    names = ("inputs_sha256", "code_sha256", "configuration")
    same = [row["run_id"] for row in rows if all(row[name] == getattr(run, name) for name in names)]
    return same[0] if same else None


def collect_campaign_views(history: BuildingHistory, requests: Sequence[LookRequest]) -> dict[str, CampaignViews]:
    """The photographs of the campaigns that the requests name."""
    wanted = {name for request in requests for name in (request.seen_campaign, request.campaign_id)}
    return {
        one.campaign_id: CampaignViews(posed=one.posed, root=one.root)
        for one in history.records
        if one.campaign_id in wanted
    }


def count_photographs(record: CampaignRecords) -> int:
    """Files of a campaign's photographs with a pose that are there: a look is made anew where they come back."""
    return sum((record.root / photo_id).is_file() for photo_id in record.posed)


def _read_lake(lake: Path, building_id: str) -> dict[str, pa.Table]:
    names = (*_READ, *_KNOWN)
    if not has_lake(lake):
        return {name: LAKE_TABLES[name].arrow.empty_table() for name in names}
    return read_tables(lake, names, building_id=building_id)


def _split_by_campaign(tables: Mapping[str, pa.Table]) -> dict[str, Mapping[str, pa.Table]]:
    return {
        campaign_id: {name: tables[name].filter(pc.equal(tables[name]["campaign_id"], campaign_id)) for name in _READ}
        for campaign_id in tables["campaigns"].column("campaign_id").to_pylist()
    }


def find_capture_time(campaign_id: str, campaigns: pa.Table) -> tuple[datetime, str | None]:
    """When a campaign was flown, by its row of table ``campaigns``, and what is to be said of it."""
    return resolve_capture_time(campaign_id, campaigns.column("captured_from")[0].as_py())


def _remark_order(records: Sequence[CampaignRecords]) -> tuple[str, ...]:
    """Campaigns whose ids are in another order than their capture times, and campaigns of one day."""
    by_time = sorted(records, key=lambda one: (one.tracked.captured_at, one.campaign_id))
    remarks = []
    for before, after in pairwise(by_time):
        if has_date(before.campaign_id) and has_date(after.campaign_id) and before.campaign_id > after.campaign_id:
            remarks.append(
                f"campaign {before.campaign_id} was flown on {before.tracked.captured_at:%Y-%m-%d}, before "
                f"{after.campaign_id} ({after.tracked.captured_at:%Y-%m-%d}), though its id is later: the history "
                "follows the photographs' times; correct the camera's clock or the campaign's name"
            )
        if before.tracked.captured_at.date() == after.tracked.captured_at.date():
            remarks.append(
                f"campaigns {before.campaign_id} and {after.campaign_id} are of one day "
                f"({after.tracked.captured_at:%Y-%m-%d}): their order is that of their first photographs, and changes "
                "between them have no rate"
            )
    return tuple(remarks)
