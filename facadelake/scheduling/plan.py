"""What an inspection of the portfolio does: campaigns that wait, in order, those left out and why, and the dates."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Literal

from facadelake.core.errors import FacadelakeError, InputDataError, StoreError
from facadelake.core.hashing import compute_key
from facadelake.photos import summarise_photographs
from facadelake.registry import CAMPAIGN, Building, Portfolio
from facadelake.scheduling.building_log import BuildingLog, read_building_log
from facadelake.scheduling.committed import (
    CommittedBuilding,
    CommittedCampaign,
    find_flown_at,
    read_committed_buildings,
)
from facadelake.scheduling.due_dates import InspectionDates, find_dates
from facadelake.scheduling.memory_need import CampaignSize, MemoryNeed, find_memory_need
from facadelake.scheduling.photograph_files import (
    compare_photographs,
    compute_fingerprint,
    compute_listing,
    find_last_change,
    list_photograph_files,
)

# What is awaited of a campaign's photographs before they are read, such as the end of their upload; empty: nothing.
UploadCheck = Callable[[Building, str], str]
LeftOutKind = Literal["growing", "failed_before", "photographs_gone", "too_large", "no_photographs", "unreadable"]
_PRIORITIES = ("high", "normal", "low")
_GONE_SHARE = 0.5


@dataclass(frozen=True, kw_only=True)
class WaitingCampaign:
    """A campaign that is to be inspected, why, and what it needs; ``fingerprint`` is of all that it is made of."""

    building_id: str
    campaign_id: str
    reason: str
    priority: str
    legal_overdue: bool
    captured_from: datetime | None
    photographs: int
    need: MemoryNeed
    fingerprint: str


@dataclass(frozen=True, kw_only=True)
class LeftOutCampaign:
    """A campaign that waits and is not inspected; ``reason`` says why and what to do."""

    building_id: str
    campaign_id: str
    kind: LeftOutKind
    reason: str


@dataclass(frozen=True, kw_only=True)
class PortfolioPlan:
    """``waiting`` is in the order of inspection; ``logs`` are to be written once the plan is carried out.

    ``remarks`` are what else is to be told.
    """

    waiting: tuple[WaitingCampaign, ...]
    left_out: tuple[LeftOutCampaign, ...]
    dates: tuple[InspectionDates, ...]
    logs: dict[str, BuildingLog]
    remarks: tuple[str, ...] = ()


def plan_portfolio(
    portfolio: Portfolio,
    lake: Path,
    *,
    code_sha256: str,
    now: datetime,
    check_upload: UploadCheck,
    memory_mib: float,
) -> PortfolioPlan:
    """Find what is to be inspected.

    Args:
        portfolio: the portfolio.
        lake: folder of the lake.
        code_sha256: version of the code of an inspection.
        now: the present time.
        check_upload: what is awaited of a campaign's photographs.
        memory_mib: memory of all inspections; a campaign that needs more is left out.

    Returns:
        The plan. Nothing is written. A building whose files cannot be read is left out with the reason.
    """
    committed = read_committed_buildings(lake, [building.id for building in portfolio.buildings])
    waiting: list[list[WaitingCampaign]] = []
    left_out: list[LeftOutCampaign] = []
    dates: list[InspectionDates] = []
    logs: dict[str, BuildingLog] = {}
    remarks: list[str] = []
    for building in portfolio.buildings:
        held = committed[building.id]
        try:
            log = read_building_log(lake, building.id, now)
        except StoreError as error:
            log = BuildingLog(registered_at=now)
            remarks.append(f"{building.id}: {error}")
        logs[building.id] = log
        found = find_building_dates(building, held, log, now)
        dates.append(found)
        remarks += _remark_missing_folder(building)
        queue = []
        for campaign_id in building.list_campaigns():
            try:
                one = _plan_campaign(
                    building, campaign_id, held, log, code_sha256=code_sha256, dates=found, check_upload=check_upload
                )
            except (FacadelakeError, OSError) as error:
                one = _leave_out(building, campaign_id, "unreadable", str(error))
            if isinstance(one, WaitingCampaign) and one.need.mib > memory_mib:
                one = _leave_out(building, campaign_id, "too_large", _describe_lack(one, memory_mib))
            if isinstance(one, WaitingCampaign):
                queue.append(one)
            elif one is not None:
                left_out.append(one)
        if queue:
            waiting.append(sorted(queue, key=_order_in_history))
    waiting.sort(key=lambda queue: _order_buildings(queue))
    return PortfolioPlan(
        waiting=tuple(one for queue in waiting for one in queue),
        left_out=tuple(left_out),
        dates=tuple(dates),
        logs=logs,
        remarks=tuple(remarks),
    )


def find_building_dates(
    building: Building, held: CommittedBuilding, log: BuildingLog, now: datetime
) -> InspectionDates:
    """The dates of a building by its campaigns in the lake."""
    captured, remarks = held.list_captured()
    found = find_dates(building.id, building.schedule, captured, registered_at=log.registered_at, now=now)
    return replace(found, remarks=(*found.remarks, *remarks))


def describe_recent_change(folder: Path, *, quiet: timedelta, now: datetime) -> str:
    """That photographs put in place by hand are still being copied: something has changed within ``quiet``."""
    changed = find_last_change(folder)
    if now - changed >= quiet:
        return ""
    minutes = quiet.total_seconds() / 60
    return f"its folder changed at {changed:%H:%M:%S} UTC and is taken as complete after {minutes:g} minutes without"


def _plan_campaign(
    building: Building,
    campaign_id: str,
    held: CommittedBuilding,
    log: BuildingLog,
    *,
    code_sha256: str,
    dates: InspectionDates,
    check_upload: UploadCheck,
) -> WaitingCampaign | LeftOutCampaign | None:
    """The campaign as it is to be planned; None: it is in the lake as it is."""
    here = held.campaigns.get(campaign_id)
    try:
        folder = building.locate_photographs(campaign_id)
    except InputDataError as error:  # one that the portfolio lists, and that is not flown yet, or archived
        return _leave_out(building, campaign_id, "no_photographs", str(error)) if here is None else None
    files = list_photograph_files(folder)
    if not files and here is None:
        return _leave_out(building, campaign_id, "no_photographs", f"there are no photographs in {folder}")
    reason = "new"
    if here is not None:
        compared = compute_key({"files": compute_listing(files), "run": here.run_id})
        changes = compare_photographs(
            folder,
            files,
            here.photographs,
            run_started_at=here.started_at,
            compared_before=log.compared.get(campaign_id) == compared,
        )
        reason = changes.describe()
        if not changes.added and not changes.changed and not changes.gone:
            log.compared[campaign_id] = compared
            return None
        if not (changes.added or changes.changed) or len(changes.gone) > _GONE_SHARE * len(here.photographs):
            return _leave_out(building, campaign_id, "photographs_gone", _describe_gone(building, here, reason))
    growing = check_upload(building, campaign_id)
    if growing:
        return _leave_out(building, campaign_id, "growing", growing)
    fingerprint = compute_fingerprint(
        building,
        campaign_id,
        code_sha256=code_sha256,
        committed={one.campaign_id: one.run_id for one in held.campaigns.values()},
    )
    attempt = log.attempts.get(campaign_id)
    if attempt is not None and (problem := attempt.explain_no_retry(fingerprint)):
        return _leave_out(building, campaign_id, "failed_before", problem)
    summary = summarise_photographs(folder / name for name in files)
    return WaitingCampaign(
        building_id=building.id,
        campaign_id=campaign_id,
        reason=reason,
        priority=building.priority,
        legal_overdue=dates.legal_overdue,
        captured_from=find_flown_at(campaign_id, summary.captured_from),
        photographs=len(files),
        need=find_memory_need(
            CampaignSize(photographs=len(files), largest_px=summary.largest_px),
            held.list_measured_runs(),
            max_image_px=building.tolerances.features_max_image_px,
            threads=os.cpu_count() or 1,
            killed_at_mib=attempt.peak_mib if attempt is not None and attempt.outcome == "killed" else None,
        ),
        fingerprint=fingerprint,
    )


def _remark_missing_folder(building: Building) -> list[str]:
    """That nothing of a building can wait, because the folder in which its campaigns are looked for is not there."""
    before, has_campaigns, _ = building.photographs.partition(CAMPAIGN)
    parent = Path(before) if before.endswith("/") else Path(before).parent
    if not has_campaigns or parent.is_dir():
        return []
    return [
        f"{building.id}: {parent}, in which its campaigns are looked for, does not exist, so that none can wait; mount "
        "the disk, or correct 'photographs' in the portfolio"
    ]


def _leave_out(building: Building, campaign_id: str, kind: LeftOutKind, reason: str) -> LeftOutCampaign:
    return LeftOutCampaign(building_id=building.id, campaign_id=campaign_id, kind=kind, reason=reason)


def _describe_lack(one: WaitingCampaign, memory_mib: float) -> str:
    return (
        f"needs about {one.need.mib / 1024:.1f} GiB ({one.need.basis}), and inspections may take "
        f"{memory_mib / 1024:.1f} GiB on this machine; free memory, raise limits: memory_gib, or run "
        f"'facadelake inspect {one.building_id} {one.campaign_id}', which does not look at it"
    )


def _describe_gone(building: Building, here: CommittedCampaign, reason: str) -> str:
    return (
        f"{reason}, of {len(here.photographs)} in the lake; it is kept as it is. Put them back, give other photographs "
        f"a campaign of their own, or run 'facadelake inspect {building.id} {here.campaign_id}'"
    )


_LATEST = datetime.max.replace(tzinfo=UTC)  # campaigns without any date come last


def _order_in_history(one: WaitingCampaign) -> tuple[datetime, str]:
    return one.captured_from or _LATEST, one.campaign_id


def _order_buildings(queue: list[WaitingCampaign]) -> tuple[int, bool, datetime, str]:
    first = queue[0]
    return _PRIORITIES.index(first.priority), not first.legal_overdue, first.captured_from or _LATEST, first.building_id
