"""Flows run from the terminal: progress bars, quiet logs, Ctrl-C, errors as they are."""

from __future__ import annotations

import logging
import os
import signal
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any, TypeVar

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

from cli.prefect_server import configure_prefect
from facadelake.core.progress import listen_to_progress

if TYPE_CHECKING:
    from flows.inspect_building import InspectionResult
    from flows.track_building import TrackingResult

R = TypeVar("R")


class ProgressBars:
    """A listener of facadelake.core.progress that draws bars with rich; a context manager."""

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
        """A bar of unknown length, removed when the first step begins or the first line is printed."""
        self._waiting = self._bars.add_task(label, total=None)

    def _end_waiting(self) -> None:
        if self._waiting is not None:
            self._bars.remove_task(self._waiting)
            self._waiting = None

    def begin(self, label: str, total: int | None) -> int:
        """A new bar."""
        self._end_waiting()
        return self._bars.add_task(label, total=total)

    def advance(self, handle: int, steps: int) -> None:
        """Advance the bar."""
        self._bars.advance(TaskID(handle), steps)

    def end(self, handle: int) -> None:
        """Remove the bar."""
        self._bars.remove_task(TaskID(handle))

    def print_line(self, line: str) -> None:
        """Print a line above the bars; it stays."""
        self._end_waiting()
        self._console.print(line, highlight=False)


SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # the last: the terminal was closed
STOPPED = 130  # exit status of a program ended by SIGINT


@contextmanager
def handle_interrupts(console: Console) -> Iterator[None]:
    """Inside the block SIGINT, SIGTERM and SIGHUP end the program with one line on how to continue.

    Ctrl-C in a terminal reaches Prefect's temporary server too; errors between the two must neither hide the
    interrupt nor print tracebacks.
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
            console.print("stopped; finished stages are kept, run the same command to continue")
            raise SystemExit(STOPPED) from None
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _BarsLog(logging.Handler):
    """Prints Facadelake's log lines above the bars."""

    def __init__(self, bars: ProgressBars) -> None:
        super().__init__(level=logging.INFO)
        self._bars = bars

    def emit(self, record: logging.LogRecord) -> None:
        self._bars.print_line(f"  {record.getMessage()}")


def inspect_in_terminal(console: Console, *, portfolio: Path, lake: Path, **parameters: Any) -> InspectionResult:
    """Run the flow ``inspect_building`` in this process; its errors are raised unchanged."""

    def load() -> Callable[..., InspectionResult]:
        from flows.inspect_building import inspect_building

        return inspect_building

    return run_flow(console, load, portfolio=portfolio, lake=lake, **parameters)


def track_in_terminal(console: Console, *, portfolio: Path, lake: Path, building_id: str) -> TrackingResult:
    """Run the flow ``track_building`` in this process; its errors are raised unchanged."""

    def load() -> Callable[..., TrackingResult]:
        from flows.track_building import track_building

        return track_building

    return run_flow(console, load, portfolio=portfolio, lake=lake, building_id=building_id)


def run_flow(
    console: Console, load: Callable[[], Callable[..., R]], *, portfolio: Path, lake: Path, **parameters: Any
) -> R:
    """Run a flow in this process, with progress bars and quiet logs; its errors are raised unchanged.

    Args:
        console: where the bars and the log lines are printed.
        load: imports the flow.
        portfolio: path of the portfolio.
        lake: folder of the lake.
        **parameters: others of the flow.

    Returns:
        The flow's result.
    """
    os.environ.setdefault("PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL", "CRITICAL")  # main() prints the error, once
    configure_prefect(lake)
    with handle_interrupts(console), ProgressBars(console) as bars, listen_to_progress(bars):
        bars.wait("Starting Prefect")
        flow = load()
        logs = [logging.getLogger(name) for name in ("facadelake.tasks", "facadelake.flows")]
        handler = _BarsLog(bars)
        for log in logs:
            log.addHandler(handler)
            log.setLevel(logging.INFO)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # deprecation warnings of libraries are for developers
                return flow(portfolio=str(portfolio.resolve()), lake=str(lake.resolve()), **parameters)
        finally:
            for log in logs:
                log.removeHandler(handler)


def make_demo_in_terminal(
    console: Console, *, folder: Path, lake: Path, recipe: Path, portfolio: Path
) -> list[InspectionResult]:
    """Generate the demo building (once) and inspect its campaigns in order."""
    from facadelake.demo import generate_demo, load_recipe

    os.environ["FACADELAKE_DEMO"] = str(folder.resolve())  # the demo's paths in the portfolio refer to it
    with handle_interrupts(console), ProgressBars(console) as bars, listen_to_progress(bars):
        files = generate_demo(load_recipe(recipe), folder)
        bars.print_line(f"The demo building is in {folder}" + ("" if files.made else " (already there)"))
    return [
        inspect_in_terminal(
            console, building_id="demo", campaign_id=campaign.campaign_id, portfolio=portfolio, lake=lake
        )
        for campaign in files.campaigns
    ]
