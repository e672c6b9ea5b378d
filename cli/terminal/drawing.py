"""Drawing pictures from the terminal: progress bars, then the files written and what was missing."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from rich.console import Console

from cli.terminal.run import ProgressBars, handle_interrupts
from facadelake.core.progress import listen_to_progress

if TYPE_CHECKING:
    from facadelake.reporting import DrawnPictures

_MOST_LISTED = 5
T = TypeVar("T")


class _DeferredWarnings(logging.Handler):
    """Collects warnings until the bars are removed."""

    def __init__(self) -> None:
        super().__init__(level=logging.WARNING)
        self.lines: dict[str, None] = {}

    def emit(self, record: logging.LogRecord) -> None:
        self.lines[record.getMessage()] = None


def run_with_progress(console: Console, draw: Callable[[], T]) -> T:
    """Run ``draw`` with progress bars, then print the warnings of the domain; returns its result."""
    warnings = _DeferredWarnings()
    log = logging.getLogger("facadelake")
    log.addHandler(warnings)
    try:
        with handle_interrupts(console), ProgressBars(console) as bars, listen_to_progress(bars):
            drawn = draw()
    finally:
        log.removeHandler(warnings)
    for line in _shorten(list(warnings.lines), "warnings"):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    return drawn


def draw_in_terminal(console: Console, draw: Callable[[], DrawnPictures]) -> None:
    """Run ``draw`` with progress bars and print the files it wrote."""
    drawn = run_with_progress(console, draw)
    if drawn.missing:
        names = ", ".join(_shorten(list(drawn.missing), "photographs"))
        console.print(
            f"{len(drawn.missing)} photographs are missing or cannot be read and were left out: {names}",
            highlight=False, markup=False, soft_wrap=True,
        )  # fmt: skip
    counts = Counter(path.parent for path in drawn.paths)
    for folder, count in sorted(counts.items()):
        console.print(f"{count} in {folder}", highlight=False, markup=False, soft_wrap=True)
    if len(drawn.paths) <= _MOST_LISTED:
        for path in drawn.paths:
            console.print(f"  {path.name}", highlight=False, markup=False)


def _shorten(lines: list[str], what: str) -> list[str]:
    return (
        lines if len(lines) <= _MOST_LISTED else [*lines[:_MOST_LISTED], f"and {len(lines) - _MOST_LISTED} more {what}"]
    )


def get_default_folder(lake: Path, building: str, campaign: str, version: int | None) -> Path:
    """The folder of pictures drawn without ``--output``, beside the lake's published files.

    Pictures of an earlier version have one of their own, or they would pass for those of the newest.
    """
    newest = lake / "pictures" / building / campaign
    return newest if version is None else newest / f"v{version:06d}"
