"""The campaigns of a building in order of their photographs' times, whatever their ids."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import pyarrow as pa

from facadelake.core.errors import InputDataError
from facadelake.core.tables import list_rows
from facadelake.lake import has_lake, read_table
from facadelake.photos import find_first_capture_time
from facadelake.registry import Building
from schemas.vocabulary import PhotoOutcome

_DATE = re.compile(r"(\d{4})(?:\D?(\d{2}))?(?:\D?(\d{2}))?")


@dataclass(frozen=True, kw_only=True)
class CampaignOrder:
    """The campaigns with photographs, the one flown first first; ``remarks``: where the order is not by their times."""

    campaigns: tuple[str, ...]
    remarks: tuple[str, ...] = ()


def has_date(campaign_id: str) -> bool:
    """Whether the id begins with a date, such as 2026-04."""
    return _DATE.match(campaign_id) is not None


def resolve_capture_time(campaign_id: str, captured_from: datetime | None) -> tuple[datetime, str | None]:
    """When a campaign was flown, and what is to be said of it: by its photographs, else by its id.

    Raises InputDataError for a campaign without capture times whose id is no date.
    """
    if captured_from is not None:
        return captured_from, None
    date = _DATE.match(campaign_id)
    if date is None:
        raise InputDataError(
            f"no photograph of campaign {campaign_id} has a capture time, and its id does not begin with a date such "
            "as 2026-04: its place in the building's history is unknown; rename the campaign's folder"
        )
    year, month, day = (int(part) if part else 1 for part in date.groups())
    try:
        found = datetime(year, month, day, tzinfo=UTC)
    except ValueError as error:
        raise InputDataError(f"campaign {campaign_id} has no capture times, and its id is no date: {error}") from error
    return found, f"no photograph has a capture time: {found:%Y-%m-%d} is taken from the id {campaign_id}"


def order_by_capture(building: Building) -> CampaignOrder:
    """The registered campaigns of a building in order of their first photographs, as tracking orders them.

    Where the time of one is not known, and its id is no date, all are in the order of their ids, and a remark says so.
    """
    known = building.list_campaigns()
    if len(known) < 2:
        return CampaignOrder(campaigns=known)
    folders = {name: Path(building.photographs.replace("{campaign}", name)) for name in known}
    known = tuple(name for name in known if folders[name].is_dir()) or known
    times, remarks = {}, []
    for name in known:
        captured = find_first_capture_time(folders[name]) if folders[name].is_dir() else None
        try:
            times[name], remark = resolve_capture_time(name, captured)
        except InputDataError:
            return CampaignOrder(
                campaigns=known,
                remarks=(
                    f"no photograph of campaign {name} of '{building.id}' has a capture time, and its id is no date: "
                    f"the campaigns are taken in the order of their ids ({', '.join(known)}), so that the latest is "
                    f"{known[-1]}; name the campaign that you mean",
                ),
            )
        remarks += [f"campaign {name}: {remark}"] if remark else []
    return CampaignOrder(campaigns=tuple(sorted(known, key=lambda name: (times[name], name))), remarks=tuple(remarks))


def find_earlier_campaigns(lake: Path, building_id: str, campaign_id: str, photos: pa.Table) -> tuple[str, ...]:
    """The campaigns of a building in the lake that were flown before a campaign, the first one first.

    Args:
        lake: folder of the lake; it may not exist yet.
        building_id: the building.
        campaign_id: the campaign, which need not be in the lake.
        photos: its table ``photos``.

    Raises:
        InputDataError: for a campaign without capture times whose id is no date.
    """
    held = list_rows(read_table(lake, "campaigns", building_id=building_id)) if has_lake(lake) else []
    captured = {row["campaign_id"]: row["captured_from"] for row in held if row["campaign_id"] != campaign_id}
    if not captured:
        return ()
    own = [row["taken_at"] for row in list_rows(photos.select(["photo_outcome", "taken_at"])) if _is_dated(row)]
    placed = {name: (resolve_capture_time(name, time)[0], name) for name, time in captured.items()}
    limit = (resolve_capture_time(campaign_id, min(own, default=None))[0], campaign_id)
    return tuple(sorted((name for name in placed if placed[name] < limit), key=lambda name: placed[name]))


def _is_dated(row: dict[str, object]) -> bool:
    return row["photo_outcome"] == PhotoOutcome.ACCEPTED and row["taken_at"] is not None
