"""Uploads in the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

from facadelake.intake import SourceProblem, Upload, UploadState

_STYLES = {
    UploadState.RECEIVED: "green",
    UploadState.REFUSED: "bold red",
    UploadState.FAILED: "red",
    UploadState.STALLED: "yellow",
}


def show_uploads(
    console: Console, uploads: Sequence[Upload], problems: Sequence[SourceProblem], *, every: bool
) -> None:
    """Print one line for each upload, what is to be said of each, and the sources that cannot be read.

    ``every``: also those that are in their source no more.
    """
    shown = [one for one in uploads if every or one.in_source]
    if not shown:
        console.print("no uploads; a building with 'intake: {source: ...}' in the portfolio receives them from there")
    else:
        table = RichTable(title="Uploads", title_justify="left")
        for column in ("building", "folder", "state", "since (UTC)", "campaign", "photographs", "files", "MB"):
            table.add_column(column)
        table.add_column("last change seen (UTC)")
        for one in shown:
            style = _STYLES.get(one.state, "")
            state = f"[{style}]{one.state}[/{style}]" if style else str(one.state)
            table.add_row(
                escape(one.building_id),
                escape(one.folder),
                state if one.in_source else f"{state}, folder gone",
                f"{one.since:%Y-%m-%d %H:%M}",
                escape(one.campaign_id or ""),
                str(one.photographs),
                str(one.files),
                f"{one.bytes / 1e6:,.1f}",
                f"{one.unchanged_since:%Y-%m-%d %H:%M}",
            )
        console.print(table)
        for one in shown:
            for line in filter(None, (one.reason, *one.remarks)):
                console.print(f"[bold]{escape(one.building_id)} {escape(one.folder)}[/bold]: ", end="")
                console.print(line, markup=False, highlight=False, soft_wrap=True)
    for problem in problems:
        console.print(f"[bold red]{escape(problem.building_id)}[/bold red]: ", end="")
        console.print(problem.problem, markup=False, highlight=False, soft_wrap=True)
