"""Drawing pictures from the terminal: bars while it goes on, then which files were written and what was missing."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from cli.terminal.run import ProgressBars, stoppable
from facadelake.core.progress import listen_to_progress

if TYPE_CHECKING:
    from facadelake.reporting import Drawn

_TOLD = 5  # of many alike, so many are named


class _Kept(logging.Handler):
    """Warnings, kept until the bars are gone."""

    def __init__(self) -> None:
        super().__init__(level=logging.WARNING)
        self.lines: dict[str, None] = {}

    def emit(self, record: logging.LogRecord) -> None:
        self.lines[record.getMessage()] = None


def draw_in_terminal(console: Console, draw: Callable[[], Drawn]) -> None:
    """Run ``draw`` under bars and tell what came of it."""
    kept = _Kept()
    log = logging.getLogger("facadelake")
    log.addHandler(kept)
    try:
        with stoppable(console), ProgressBars(console) as bars, listen_to_progress(bars):
            drawn = draw()
    finally:
        log.removeHandler(kept)
    for line in _some(list(kept.lines), "warnings"):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    if drawn.missing:
        names = ", ".join(_some(list(drawn.missing), "photographs"))
        console.print(
            f"{len(drawn.missing)} photographs are not there or cannot be read, the pictures do without them: {names}",
            highlight=False, markup=False, soft_wrap=True,
        )  # fmt: skip
    counts = Counter(path.parent for path in drawn.paths)
    for folder, count in sorted(counts.items()):
        console.print(f"{count} in {folder}", highlight=False, markup=False, soft_wrap=True)
    if len(drawn.paths) <= _TOLD:
        for path in drawn.paths:
            console.print(f"  {path.name}", highlight=False, markup=False)


def _some(lines: list[str], what: str) -> list[str]:
    return lines if len(lines) <= _TOLD else [*lines[:_TOLD], f"and {len(lines) - _TOLD} more {what}"]


def default_folder(lake: Path, building: str, campaign: str) -> Path:
    """Where pictures go that are asked for without a folder: beside the lake's published files."""
    return lake / "pictures" / building / campaign
