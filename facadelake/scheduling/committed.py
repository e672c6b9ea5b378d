"""What the lake knows of the portfolio's campaigns: their photographs, capture times and runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

from facadelake.campaigns import resolve_capture_time
from facadelake.core.errors import InputDataError
from facadelake.lake import has_lake, query
from facadelake.scheduling.due_dates import CapturedCampaign
from facadelake.scheduling.memory_need import CampaignSize, MeasuredRun, parse_peak
from facadelake.scheduling.photograph_files import CommittedPhotograph

_CAMPAIGNS = """
SELECT c.building_id, c.campaign_id, c.captured_to, r.run_id, r.started_at, r.finished_at, r.stage_peak_mib
FROM campaigns AS c JOIN runs AS r USING (building_id, campaign_id)
ORDER BY r.finished_at
"""
_PHOTOGRAPHS = """
SELECT building_id, campaign_id, photo_id, sha256, bytes, image_width_px, image_height_px FROM photos
"""


@dataclass(frozen=True, kw_only=True)
class CommittedCampaign:
    """A campaign in the lake with its photographs by photo_id, and its run."""

    campaign_id: str
    captured_to: datetime | None
    run_id: str
    started_at: datetime
    peak_mib: float | None
    photographs: dict[str, CommittedPhotograph] = field(default_factory=dict)
    largest_px: int = 0


@dataclass(frozen=True, kw_only=True)
class CommittedBuilding:
    """The campaigns of a building in the lake, the last run last."""

    campaigns: dict[str, CommittedCampaign] = field(default_factory=dict)

    def list_measured_runs(self) -> list[MeasuredRun]:
        """The runs whose memory was measured from the photographs on."""
        return [
            MeasuredRun(
                peak_mib=one.peak_mib,
                size=CampaignSize(photographs=len(one.photographs), largest_px=one.largest_px),
            )
            for one in self.campaigns.values()
            if one.peak_mib is not None
        ]

    def list_captured(self) -> tuple[list[CapturedCampaign], list[str]]:
        """The campaigns with the times of their last photographs, and remarks about those without a time.

        As in the building's history, a campaign whose photographs tell no time is of the date in its id.
        """
        captured, remarks = [], []
        for one in self.campaigns.values():
            if one.captured_to is not None:
                captured.append(CapturedCampaign(campaign_id=one.campaign_id, captured_to=one.captured_to))
                continue
            dated = find_flown_at(one.campaign_id, None)
            if dated is None:
                remarks.append(
                    f"campaign {one.campaign_id}: its photographs tell no capture time and its id no date, so it "
                    "counts for no date of inspection; rename its folder, such as to 2026-04"
                )
            else:
                remarks.append(f"campaign {one.campaign_id}: its photographs tell no capture time; its id is its date")
                captured.append(CapturedCampaign(campaign_id=one.campaign_id, captured_to=dated))
        return captured, remarks


def find_flown_at(campaign_id: str, captured_at: datetime | None) -> datetime | None:
    """When a campaign was flown, by its photographs, else by its id; None: neither tells."""
    try:
        return resolve_capture_time(campaign_id, captured_at)[0]
    except InputDataError:
        return None


def read_committed_buildings(lake: Path, building_ids: Sequence[str]) -> dict[str, CommittedBuilding]:
    """What the lake holds of the buildings; a building without campaigns has none."""
    found = {building_id: CommittedBuilding() for building_id in building_ids}
    if not has_lake(lake):
        return found
    for row in query(lake, _CAMPAIGNS).to_pylist():
        if row["building_id"] in found:
            found[row["building_id"]].campaigns[row["campaign_id"]] = CommittedCampaign(
                campaign_id=row["campaign_id"],
                captured_to=row["captured_to"],
                run_id=row["run_id"],
                started_at=row["started_at"],
                peak_mib=parse_peak(row["stage_peak_mib"]),
            )
    sizes: dict[tuple[str, str], int] = {}
    for row in query(lake, _PHOTOGRAPHS).to_pylist():
        building = found.get(row["building_id"])
        campaign = building.campaigns.get(row["campaign_id"]) if building else None
        if campaign is not None:
            campaign.photographs[row["photo_id"]] = CommittedPhotograph(bytes=row["bytes"], sha256=row["sha256"])
            key = (row["building_id"], row["campaign_id"])
            sizes[key] = max(sizes.get(key, 0), (row["image_width_px"] or 0) * (row["image_height_px"] or 0))
    for (building_id, campaign_id), largest_px in sizes.items():
        campaigns = found[building_id].campaigns
        campaigns[campaign_id] = replace(campaigns[campaign_id], largest_px=largest_px)
    return found
