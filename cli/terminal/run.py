"""Run flows from the terminal: bars, quiet logs, errors as they are."""

from __future__ import annotations

import logging
import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from cli.prefect_session import prepare
from cli.terminal.bars import ProgressBars
from cli.terminal.stopping import stoppable
from facadelake.core.progress import listening

if TYPE_CHECKING:
    from flows.inspect_building import InspectionResult


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
    with stoppable(console), ProgressBars(console) as bars, listening(bars):
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
    with stoppable(console), ProgressBars(console) as bars, listening(bars):
        files = generate_demo(load_recipe(recipe), folder)
        bars.say(f"The demo building is in {folder}" + ("" if files.made else " (it was there already)"))
    return [
        inspect_in_terminal(
            console, building_id="demo", campaign_id=campaign.campaign_id, portfolio=portfolio, lake=lake
        )
        for campaign in files.campaigns
    ]
