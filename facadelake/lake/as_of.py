"""Which version of the lake a person means: by its number, or by a time at which it was the newest."""

from __future__ import annotations

import re
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

from facadelake.core.errors import InputDataError
from facadelake.lake.read import list_versions

_NUMBER = re.compile(r"v?([0-9]+)")  # v000012: a release's folder
_TIME = re.compile(r"[0-9]{4}-[0-9]{2}-[0-9]{2}([T ].+)?")
_FORMS = (
    "give a version such as 12, a date such as 2026-04-30 (its end, UTC), or a time such as 2026-04-30T14:30 (UTC) or "
    "2026-04-30T14:30+02:00"
)


def resolve_version(lake: Path, as_of: str | None) -> int | None:
    """The version of the lake that ``as_of`` names; None: the newest.

    A number is that version; whether the lake has it is checked where the lake is read. A time is the last version
    committed at or before it; a date means its end, and a time without an offset is in UTC.
    Raises InputDataError for any other text, and where no version is as early; StoreError where there is no lake.
    """
    if as_of is None:
        return None
    number = _NUMBER.fullmatch(as_of.strip())
    return int(number[1]) if number else _find_version_at(lake, _read_time(as_of.strip()), as_of)


def _read_time(text: str) -> datetime:
    try:
        if not _TIME.fullmatch(text):
            raise ValueError
        if len(text) == len("2026-04-30"):
            day_end = datetime.combine(date.fromisoformat(text) + timedelta(days=1), datetime.min.time(), UTC)
            return day_end - timedelta.resolution
        time = datetime.fromisoformat(text)
    except (ValueError, OverflowError):
        raise InputDataError(f"'{text}' is no version and no time; {_FORMS}") from None
    return time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC)


def _find_version_at(lake: Path, time: datetime, text: str) -> int:
    committed = {row["version"]: row["committed_at"] for row in list_versions(lake).to_pylist()}
    until = [version for version, committed_at in committed.items() if committed_at <= time]
    if not until:
        first = min(committed, default=None)
        held = "it has none" if first is None else f"its first is {first}, of {committed[first]:%Y-%m-%d %H:%M:%S} UTC"
        raise InputDataError(f"the lake {lake} had no version at {text} ({time:%Y-%m-%d %H:%M:%S} UTC); {held}")
    found: int = max(until)
    later = [version for version in committed if version < found and committed[version] > time]
    if later:
        raise InputDataError(
            f"which version the lake {lake} had at {text} cannot be said: version {later[0]} is of "
            f"{committed[later[0]]:%Y-%m-%d %H:%M:%S} UTC and the later version {found} of "
            f"{committed[found]:%Y-%m-%d %H:%M:%S} UTC, so a clock was wrong; give the version by its number"
        )
    return found
