"""Flows run from the terminal: progress bars, quiet logs, Ctrl-C, errors as they are."""

from __future__ import annotations

import logging
import os
import signal
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any

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

from cli.prefect_server import prepare
from facadelake.core.progress import listen_to_progress

if TYPE_CHECKING:
    from flows.inspect_building import InspectionResult


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


SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # the last: the terminal was closed
STOPPED = 130  # what shells give for a program ended by SIGINT


@contextmanager
def stoppable(console: Console) -> Iterator[None]:
    """Inside the block SIGINT, SIGTERM and SIGHUP end the program with a line of what to do next, in silence else.

    Ctrl-C in a terminal reaches Prefect's temporary server too; what then goes wrong between the two must neither
    hide the interrupt nor print tracebacks.
    """
    stopped = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal stopped
        stopped = True
        logging.disable(logging.CRITICAL)
        raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in SIGNALS}
    try:
        yield
    except BaseException:
        if stopped:
            console.print("stopped; finished stages are kept, run the same command to go on")
            raise SystemExit(STOPPED) from None
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _BarsLog(logging.Handler):
    """Facadelake's own log lines as lines above the bars."""

    def __init__(self, bars: ProgressBars) -> None:
        super().__init__(level=logging.INFO)
        self._bars = bars

    def emit(self, record: logging.LogRecord) -> None:
        self._bars.say(f"  {record.getMessage()}")


def inspect_in_terminal(console: Console, *, portfolio: Path, lake: Path, **parameters: Any) -> InspectionResult:
    """Run the flow ``inspect_building`` in this process; its errors come out as they were raised."""
    os.environ.setdefault("PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL", "CRITICAL")  # main() tells the error, once
    prepare(lake)
    with stoppable(console), ProgressBars(console) as bars, listen_to_progress(bars):
        bars.wait("Starting Prefect")
        from flows.inspect_building import inspect_building

        log = logging.getLogger("facadelake.tasks")
        handler = _BarsLog(bars)
        log.addHandler(handler)
        log.setLevel(logging.INFO)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # libraries' deprecations are ours to mend, not the person's to read
                result: InspectionResult = inspect_building(
                    portfolio=str(portfolio.resolve()), lake=str(lake.resolve()), **parameters
                )
        finally:
            log.removeHandler(handler)
    return result


def make_demo_in_terminal(
    console: Console, *, folder: Path, lake: Path, recipe: Path, portfolio: Path
) -> list[InspectionResult]:
    """Make the demo building (once) and inspect its campaigns in order."""
    from facadelake.demo import generate_demo, load_recipe

    os.environ["FACADELAKE_DEMO"] = str(folder.resolve())  # the registry's paths of the demo are made of it
    with stoppable(console), ProgressBars(console) as bars, listen_to_progress(bars):
        files = generate_demo(load_recipe(recipe), folder)
        bars.say(f"The demo building is in {folder}" + ("" if files.made else " (it was there already)"))
    return [
        inspect_in_terminal(
            console, building_id="demo", campaign_id=campaign.campaign_id, portfolio=portfolio, lake=lake
        )
        for campaign in files.campaigns
    ]
