"""Progress of long work as bars in the terminal, with the time left; plain lines where there is no terminal."""

from __future__ import annotations

from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


class ProgressBars:
    """A listener of facadelake.core.progress that draws with rich; a context manager."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._waiting: TaskID | None = None
        self._bars = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )

    def __enter__(self) -> ProgressBars:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()

    def wait(self, label: str) -> None:
        """A bar of unknown length that goes when the first work begins or the first line is said."""
        self._waiting = self._bars.add_task(label, total=None)

    def _arrive(self) -> None:
        if self._waiting is not None:
            self._bars.remove_task(self._waiting)
            self._waiting = None

    def begin(self, label: str, total: int | None) -> int:
        """A new bar."""
        self._arrive()
        return self._bars.add_task(label, total=total)

    def advance(self, handle: int, steps: int) -> None:
        """The bar grows."""
        self._bars.advance(TaskID(handle), steps)

    def end(self, handle: int) -> None:
        """The bar goes."""
        self._bars.remove_task(TaskID(handle))

    def say(self, line: str) -> None:
        """A line that stays, above the bars."""
        self._arrive()
        self._console.print(line, highlight=False)
