"""Which campaign an upload is: by the name of its folder, else by when its photographs were taken."""

from __future__ import annotations

import calendar
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, datetime, timedelta

from facadelake.core.errors import InputDataError
from facadelake.intake.answer import ANSWER_FILE

_YEAR = r"((?:19|20)\d\d)"
_DAY = re.compile(rf"(?<!\d){_YEAR}([-_.])(\d\d)\2(\d\d)(?!\d)")
_MONTH = re.compile(rf"(?<!\d){_YEAR}[-_.](\d\d)(?!\d)")
_COMPACT = re.compile(rf"(?<!\d){_YEAR}(\d\d)(\d\d)(?:\d{{4}}|\d{{6}})?(?!\d)")  # DJI: 202604141030
_DOTTED = re.compile(rf"(?<!\d)(\d\d?)\.(\d\d?)\.{_YEAR}(?!\d)")
_YEAR_ALONE = re.compile(rf"{_YEAR}(?!\d)")  # at the begin: elsewhere it can be any number
_IDENTIFIER = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
# A campaign named by a month may end in the next one; one named by a day may be flown in the days after.
_TOLERANCE_DAYS = {"day": 7, "month": 31, "year": 31}


@dataclass(frozen=True, kw_only=True)
class Period:
    """A day, month or year that a name holds, as ISO 8601 writes it, and where in the name it is."""

    text: str
    first: date
    last: date
    tolerance_days: int
    begin: int
    end: int

    def is_within(self, taken_at: datetime) -> bool:
        """Whether photographs of a campaign of this name may have been taken then."""
        margin = timedelta(days=self.tolerance_days)
        return self.first - margin <= taken_at.date() <= self.last + margin


def find_period(name: str) -> Period | None:
    """The date in a name; None where it holds none. Raises InputDataError for one that the calendar does not have."""
    for pattern, groups in ((_DAY, (1, 3, 4)), (_DOTTED, (3, 2, 1))):
        if match := pattern.search(name):
            return _make_period(name, match, [int(match[group]) for group in groups])
    if match := _COMPACT.search(name):
        try:
            return _make_period(name, match, [int(match[group]) for group in (1, 2, 3)])
        except InputDataError:  # a number of eight digits that is no date
            return None
    if match := _MONTH.search(name):
        return _make_period(name, match, [int(match[1]), int(match[2])])
    if match := _YEAR_ALONE.match(name):
        return _make_period(name, match, [int(match[1])])
    return None


def _make_period(name: str, match: re.Match[str], numbers: Sequence[int]) -> Period:
    kind = ("year", "month", "day")[len(numbers) - 1]
    year, month, day = (*numbers, 1, 1)[:3]
    try:
        first = date(year, month, day)
    except ValueError as error:
        raise InputDataError(
            f"its folder's name '{name}' holds '{match[0]}', which is no {kind} of the calendar; rename the folder, "
            f"such as to 2026-04, or write 'campaign: 2026-04' into a file {ANSWER_FILE} in it"
        ) from error
    last = first
    if kind == "month":
        last = first.replace(day=calendar.monthrange(year, month)[1])
    elif kind == "year":
        last = first.replace(month=12, day=31)
    text = first.isoformat()[: {"year": 4, "month": 7, "day": 10}[kind]]
    return Period(
        text=text, first=first, last=last, tolerance_days=_TOLERANCE_DAYS[kind], begin=match.start(), end=match.end()
    )


def name_campaign(folder: str, known: Sequence[str]) -> str | None:
    """The campaign id that a folder's name is, or holds; None where it says none.

    A date at the begin is followed by the rest of the name where that makes a valid id (2026-04-east); elsewhere the
    date alone is the id. A name without a date is an id where it is like one of the building's other campaigns (c1,
    c2, c3).

    Raises:
        InputDataError: the name holds a date that the calendar does not have.
    """
    period = find_period(folder)
    if period is not None:
        whole = period.text + folder[period.end :]
        return whole if period.begin == 0 and _IDENTIFIER.fullmatch(whole) else period.text
    is_alike = any(_generalise(folder) == _generalise(one) for one in known if _has_no_date(one))
    return folder if is_alike and _IDENTIFIER.fullmatch(folder) else None


def _has_no_date(name: str) -> bool:
    try:
        return find_period(name) is None
    except InputDataError:
        return False


def _generalise(name: str) -> str:
    return re.sub(r"\d+", "0", name)


def name_campaign_by_dates(taken_at: Sequence[datetime], known: Sequence[str]) -> str:
    """A campaign id from capture dates: the month of the first, or its day where all other campaigns have days."""
    has_days = bool(known) and all(_DAY.match(one) for one in known)
    return f"{min(taken_at):%Y-%m-%d}" if has_days else f"{min(taken_at):%Y-%m}"
