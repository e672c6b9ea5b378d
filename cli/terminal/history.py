"""The history of a building in the terminal: two campaigns compared, one track explained."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

from cli.terminal.listings import WIDE_COLUMNS
from facadelake.reporting.history import (
    COUNTED_ONLY,
    MEANINGS,
    BuildingComparison,
    Finding,
    describe_class,
    describe_count,
    describe_evidence,
    describe_grade,
    describe_offsets,
    describe_sizes,
    describe_span,
    format_changes,
)

if TYPE_CHECKING:
    from facadelake.reporting.history import TrackExplanation, TrackPictures

_COLOURS = {
    Finding.REOPENED: "bold red",
    Finding.REPAIRED_BETWEEN: "bold red",
    Finding.GROWN: "bold red",
    Finding.CLASS_CHANGED: "bold red",
    Finding.NEW: "magenta",
    Finding.FIRST_SEEN: "magenta",
    Finding.REGRADED: "yellow",
    Finding.NOT_IMAGED: "yellow",
    Finding.NOT_FOUND: "yellow",
    Finding.MISSED: "blue",
    Finding.REPAIRED: "green",
}


def show_comparison(console: Console, comparison: BuildingComparison, limit: int) -> None:
    """Print counts, the listed tracks and the offset of the frames; at most ``limit`` tracks."""
    console.print(escape(f"{comparison.building_id}: {describe_span(comparison)}"), highlight=False)
    listed = comparison.listed
    if listed:
        console.print(_build_list(console, comparison, limit))
    if len(listed) > limit:
        console.print(f"{len(listed) - limit} more; --limit {len(listed)} shows all")
    console.print(_build_counts(comparison))
    console.print(escape(describe_offsets(comparison)), highlight=False)
    for offset in comparison.offsets[1:]:
        if offset.xyz_m is None and offset.remark:
            console.print(escape(f"Facade {offset.facade}: {offset.remark}"), highlight=False)


def _build_list(console: Console, comparison: BuildingComparison, limit: int) -> RichTable:
    table = RichTable(title="What needs attention, the most urgent first", title_justify="left")
    wide = console.width >= WIDE_COLUMNS
    names = ["track", "", "class", "severity", "place", comparison.earlier, comparison.later, "change ± sigma"]
    for name in [*names, "why"] if wide else names:
        table.add_column(escape(name), no_wrap=name == "track", overflow="fold")
    for track in comparison.listed[:limit]:
        place = ", ".join(str(part) for part in (track.place["facade"], track.place["storey"]) if part)
        cells = [
            escape(track.track_id),
            _colour(track.finding),
            describe_class(track),
            escape(describe_grade(track)),
            escape(place),
            *(escape(size) for size in describe_sizes(track)),
            escape(format_changes(track.changes, track.defect_class, track.pair)),
        ]
        table.add_row(*cells, *([escape(describe_evidence(track))] if wide else []))
    return table


def _build_counts(comparison: BuildingComparison) -> RichTable:
    counts = comparison.count_findings()
    table = RichTable(
        title=escape(describe_count(comparison)),
        title_justify="left",
    )
    table.add_column("")
    table.add_column("defects", justify="right")
    table.add_column("facades")
    table.add_column("meaning")
    for finding, count in counts.items():
        facades = Counter(
            str(track.place["facade"] or "none") for track in comparison.tracks if track.finding is finding
        )
        told = ", ".join(f"{name} {number}" for name, number in sorted(facades.items()))
        meaning = MEANINGS[finding] + (" (not listed)" if finding in COUNTED_ONLY else "")
        table.add_row(_colour(finding), str(count), escape(told), meaning)
    return table


def _colour(finding: Finding) -> str:
    colour = _COLOURS.get(finding)
    return f"[{colour}]{finding}[/{colour}]" if colour else str(finding)


def show_explanation(console: Console, explained: TrackExplanation) -> None:
    """Print a track campaign by campaign."""
    console.print(f"[bold]{escape(explained.track_id)}[/bold]", highlight=False)
    for line in explained.lines:
        console.print(escape(f"  {line}"), highlight=False, soft_wrap=True)
    for campaign in explained.campaigns:
        word = (
            campaign.word
            if campaign.finding is None
            else _colour(campaign.finding).replace(str(campaign.finding), campaign.word)
        )
        console.print(f"[bold]{escape(campaign.campaign_id)}[/bold]: {word}", highlight=False)
        for line in campaign.lines:
            console.print(escape(f"  - {line}"), highlight=False, soft_wrap=True)


def show_track_pictures(console: Console, drawn: TrackPictures) -> None:
    """Print the files written of a track, and why there are none."""
    for path in drawn.paths:
        console.print(f"written: {path}", soft_wrap=True, highlight=False, markup=False)
    for remark in drawn.remarks:
        console.print(remark, soft_wrap=True, highlight=False, markup=False)
