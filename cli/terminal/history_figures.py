"""Figures of a building's history against truth in the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table as RichTable

if TYPE_CHECKING:
    from facadelake.evaluation.history import HistoryFigures


def show_history_figures(console: Console, figures: HistoryFigures) -> None:
    """Print the figures, and the table of true and called states."""
    title = f"History against truth: {', '.join(figures.campaigns)}"
    table = RichTable(title=title, title_justify="left")
    for index, name in enumerate(figures.COLUMNS):
        table.add_column(name, justify="right" if index in (1, 2) else "left", overflow="fold")
    for row in figures.format_rows():
        table.add_row(*row)
    console.print(table)
    confusion = figures.states.confusion
    called = sorted({pair[1] for pair in confusion})
    states = RichTable(
        title="States: true (rows) and called (columns)",
        title_justify="left",
        caption="no state: none is due, or there is no row; no defect: a track of false detections, or a second track",
        caption_justify="left",
    )
    states.add_column("true")
    for name in called:
        states.add_column(name.replace("_", " "), justify="right")
    for true in sorted({pair[0] for pair in confusion}):
        counts = (confusion.get((true, name), 0) for name in called)
        states.add_row(true.replace("_", " "), *(str(count) if count else "" for count in counts))
    console.print(states)
