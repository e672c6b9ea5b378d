"""The portfolio: an unattended quarter on a compressed clock, and what orchestration costs.

    .venv/bin/python -m benchmarks.portfolio quarter [--seeds 5]     # 50 buildings, a minute a seed
    .venv/bin/python -m benchmarks.portfolio orchestration BUILDING CAMPAIGN --portfolio FILE --work FOLDER

``quarter``: uploads in pieces, late photographs, killed processes, an inspection of the portfolio every night;
inspecting is marking as done. ``orchestration`` inspects a campaign once, so that every stage is in the cache of
FOLDER, and then times the flow, on a server that runs already, against the same functions without Prefect: their
difference is what Prefect takes, and it does not depend on how long the stages take. Prints Markdown.
"""

from __future__ import annotations

import argparse
import os
import random
import statistics
import tempfile
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from unittest.mock import patch

import psutil

from benchmarks.portfolio_quarter import NIGHTS, Quarter, Upload, make_portfolio

_BUILDINGS = 50
_UPLOADS = 120
_REPEATS = 5


def print_quarter(seeds: int) -> None:
    """Print how often campaigns were inspected and overdue dates told, for each seed."""
    print("| seed | uploads | to be inspected | once each | more | missed | overdue told | not told | twice told "
          "| wrong dates | s a night |\n|---|---|---|---|---|---|---|---|---|---|---|")  # fmt: skip
    for seed in range(seeds):
        with tempfile.TemporaryDirectory(prefix="facadelake-quarter-") as name:
            quarter = Quarter(
                root=Path(name), portfolio=make_portfolio(Path(name), _BUILDINGS, seed), uploads=_draw_uploads(seed)
            )
            begin = time.perf_counter()
            quarter.run()
            seconds = time.perf_counter() - begin
            expected, found = quarter.count_expected(), quarter.inspected
            more = sum((found - expected).values()) + quarter.started_growing
            missed = sum((expected - found).values())
            twice_told = sum(count - 1 for count in quarter.told.values())
            print(
                f"| {seed} | {len(quarter.uploads)} | {expected.total()} | {expected.total() - missed} | {more} "
                f"| {missed} | {len(quarter.told)} | {len(quarter.untold)} | {twice_told} | {len(quarter.wrong_dates)} "
                f"| {seconds / NIGHTS:.2f} |",
                flush=True,
            )


def _draw_uploads(seed: int) -> list[Upload]:
    draw = random.Random(seed)
    uploads: dict[tuple[str, str], Upload] = {}
    for _ in range(_UPLOADS):
        one = Upload(
            building=draw.randrange(_BUILDINGS),
            first_day=draw.randrange(NIGHTS),
            pieces=draw.randint(1, 4),
            late_days=draw.choice([0, 0, 0, 1, 20]),
            is_killed=draw.random() < 0.1,
        )
        uploads[one.key] = one
    return list(uploads.values())


def print_orchestration(building: str, campaign: str, portfolio: Path, work: Path) -> None:
    """Print the time of the flow and of the same functions without Prefect, all stages in the cache."""
    os.environ["PREFECT_HOME"] = str(work / "prefect")
    os.environ.setdefault("PREFECT_LOGGING_LEVEL", "CRITICAL")
    from prefect import Task
    from prefect.server.api.server import SubprocessASGIServer
    from prefect.settings import PREFECT_API_URL, temporary_settings

    import flows.inspect_building as module
    import tasks.commit

    parameters = {
        "building_id": building, "campaign_id": campaign, "portfolio": str(portfolio), "lake": str(work / "lake")
    }  # fmt: skip
    server = SubprocessASGIServer()
    begin = time.perf_counter()
    server.start(timeout=180)
    start_s = time.perf_counter() - begin
    with temporary_settings({PREFECT_API_URL: server.api_url}):
        first_s = _time(lambda: module.inspect_building(**parameters))
        bare = {name: value.fn for name, value in vars(module).items() if isinstance(value, Task)}
        with_prefect, without = [], []
        for _ in range(_REPEATS):  # one after the other, so that the machine's load is shared
            with_prefect.append(_time(lambda: module.inspect_building(**parameters)))
            with (
                patch.multiple(module, **bare),
                patch.multiple(tasks.commit, create_table_artifact=_skip, create_markdown_artifact=_skip),
            ):
                without.append(_time(lambda: module.inspect_building.fn(**parameters)))
    server.stop()
    taken_s = statistics.median(with_prefect) - statistics.median(without)
    print("| campaign | first inspection s | flow, cached s | without Prefect s | Prefect takes s | share | server s |")
    print("|---|---|---|---|---|---|---|")
    print(
        f"| {building} {campaign} | {first_s:.0f} | {_format(with_prefect)} | {_format(without)} | {taken_s:.1f} "
        f"| {taken_s / first_s:.1%} | {start_s:.0f} |"
    )


def _skip(**_: Any) -> None:
    """Nothing in place of an artifact."""


def _time(run: Callable[[], object]) -> float:
    begin = time.perf_counter()
    run()
    return time.perf_counter() - begin


def _format(seconds: list[float]) -> str:
    return f"{statistics.median(seconds):.1f} ({min(seconds):.1f} to {max(seconds):.1f})"


def main() -> None:
    """Parse the command line and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    subcommands = parser.add_subparsers(dest="command", required=True)
    quarter = subcommands.add_parser("quarter")
    quarter.add_argument("--seeds", type=int, default=5)
    orchestration = subcommands.add_parser("orchestration")
    orchestration.add_argument("building")
    orchestration.add_argument("campaign")
    orchestration.add_argument("--portfolio", type=Path, required=True)
    orchestration.add_argument("--work", type=Path, required=True)
    given = parser.parse_args()
    gib = psutil.virtual_memory().total / 2**30
    print(f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, {psutil.cpu_count()} cores, {gib:.0f} GiB, "
          f"load {os.getloadavg()[0]:.1f} before\n")  # fmt: skip
    if given.command == "quarter":
        print_quarter(given.seeds)
    else:
        given.work.mkdir(parents=True, exist_ok=True)
        print_orchestration(given.building, given.campaign, given.portfolio.resolve(), given.work.resolve())


if __name__ == "__main__":
    main()
