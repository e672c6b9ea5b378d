"""The defects of a building for life in the terminal, and reviews of their states."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

from cli.terminal.listings import WIDE_COLUMNS, require_known
from facadelake.core.errors import InputDataError, suggest_name
from facadelake.core.tables import list_rows
from facadelake.lake import answer_question
from schemas.vocabulary import DefectClass, TrackState, TrendQuantity

if TYPE_CHECKING:
    from facadelake.reviews import TrackReviewResult

# Unit in the terminal, factor to it, decimals.
_UNITS = {
    TrendQuantity.LENGTH: ("cm", 100.0, 1),
    TrendQuantity.AREA: ("cm²", 1e4, 0),
    TrendQuantity.CRACK_WIDTH: ("mm", 1.0, 2),
}


def show_tracks(
    console: Console,
    lake: Path,
    portfolio: Path,
    building: str,
    *,
    states: str | None,
    defect_class: str | None,
    limit: int,
    as_of: int | None,
) -> None:
    """Print a table of tracks, what matters most first.

    Args:
        console: where to print.
        lake: folder of the lake.
        portfolio: path of the portfolio.
        building: the building.
        states: only these states, separated by commas; None: all.
        defect_class: only this class; None: all.
        limit: largest number of rows.
        as_of: an earlier version of the lake; None: the newest.

    Raises:
        InputDataError: a state, the class or the building is unknown, or the building has no history.
    """
    for name, given, known in (("state", states, TrackState), ("class", defect_class, DefectClass)):
        for one in (given or "").replace(" ", "").split(",") if given else ():
            if one not in set(known):
                like = suggest_name(one, known)
                raise InputDataError(f"there is no {name} '{one}'{like}; there are {', '.join(known)}")
    require_known(lake, portfolio, building)
    rows = [row for row in list_rows(answer_question(lake, "tracks", as_of=as_of)) if row["building_id"] == building]
    if not rows:
        raise InputDataError(
            f"the lake {lake} has{'' if as_of is None else f' at version {as_of}'} no tracks of building '{building}': "
            f"its campaigns were committed without a history; 'facadelake track {building}' makes it"
        )
    wanted = set((states or ",".join(TrackState)).replace(" ", "").split(","))
    chosen = [row for row in rows if row["track_state"] in wanted and defect_class in (None, row["defect_class"])]
    table = RichTable(
        title=f"{len(chosen)} of {len(rows)} tracks of {building}, state of {rows[0]['campaign_id']}",
        title_justify="left",
    )
    wide = console.width >= WIDE_COLUMNS
    for name in ("track", "class", "state", "severity", "facade", "storey", "size cm"):
        table.add_column(name, justify="right" if name == "size cm" else "left", no_wrap=True)
    if wide:
        for name in ("change", "first seen", "last seen"):
            table.add_column(name, no_wrap=True)
    for row in chosen[:limit]:
        cells = [row["track_id"], row["defect_class"], row["track_state"], row["severity"], row["facade"]]
        cells += [row["storey"] or "", f"{row['width_m'] * 100:.0f} x {row['height_m'] * 100:.0f}"]
        if wide:
            cells += [_format_change(row), _format_first(row), _format_time(row, "last")]
        table.add_row(*(escape(cell) for cell in cells))
    console.print(table)
    if len(chosen) > limit:
        console.print(f"{len(chosen) - limit} more; --limit {len(chosen)} shows all")
    if wide and any(row["first_state"] == TrackState.FIRST_SEEN for row in chosen[:limit]):
        console.print("≤: their place was not imaged well enough before, so that their age is unknown.")


def _format_change(row: Mapping[str, Any]) -> str:
    """The significant change, such as "length +6.0 ± 1.0 cm in 0.5 a"; empty where there is none."""
    if row["changed_quantity"] is None or row["change"] is None:
        return ""
    quantity = TrendQuantity(row["changed_quantity"])
    unit, factor, digits = _UNITS[quantity]
    sigma = "" if row["change_sigma"] is None else f" ± {row['change_sigma'] * factor:.{digits}f}"
    years = "" if row["years_since_previous"] is None else f" in {row['years_since_previous']:.1f} a"
    name = quantity.value.rsplit("_", 1)[0].replace("crack_", "")
    return f"{name} {row['change'] * factor:+.{digits}f}{sigma} {unit}{years}"


def _format_time(row: Mapping[str, Any], which: str) -> str:
    time = row[f"{which}_seen_at"]
    return f"{time:%Y-%m-%d}" if time else row[f"{which}_campaign"] or ""


def _format_first(row: Mapping[str, Any]) -> str:
    return f"{'≤ ' if row['first_state'] == TrackState.FIRST_SEEN else ''}{_format_time(row, 'first')}"


def show_track_review(console: Console, done: TrackReviewResult, track: str, campaign: str, state: str) -> None:
    """Print what a review of a track changes, and what applies it."""
    if done.added.version is None:
        console.print(f"nothing new: the latest review of {track} in {campaign} says the same")
        return
    before = "no state" if done.state_before is None else f"'{done.state_before}'"
    console.print(
        f"{track} in {campaign}: '{state}' in place of {before}, in lake version {done.added.version}; "
        f"'facadelake track {done.building_id}', or the next inspection of the building, applies it",
        soft_wrap=True,
        highlight=False,
    )
