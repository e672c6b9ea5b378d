"""Histories of defects against truth: identity, states, changes; time and memory of tracking; coverage.

    .venv/bin/python -m benchmarks.history synthetic growth trends size coverage     # ten minutes
    .venv/bin/python -m benchmarks.history demo pair --work FOLDER            # whole inspections; reuses FOLDER

``demo`` and ``pair`` inspect all campaigns with exact and with noisy boxes by the command line, then evaluate with
``facadelake evaluate --history``; pictures of wrong states are in FOLDER/pictures. ``synthetic`` draws histories
without photographs, in which looks err with the stated rates; ``growth`` draws pairs of campaigns in which nothing
grows, and such with growth by 1.4; ``trends`` draws sizes over three to six campaigns; ``size`` tracks 20 campaigns
with 2,000 defects in a process of its own. Prints Markdown.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import platform
import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import psutil

from benchmarks.coverage import GOAL_S, measure_castle
from benchmarks.drawn_growth import GROWTHS, count_held_trends
from benchmarks.history_campaigns import measure_demo, measure_pair
from benchmarks.history_report import (
    FALSE_GROWTH,
    FALSE_REPAIRED,
    FOUND_GROWTH,
    INSIDE,
    RECOVERED,
    Goal,
    HistoryReport,
)
from benchmarks.synthetic_history import HistoryRecipe, draw_history
from benchmarks.synthetic_tracking import build_tables, draw_looks, track_synthetic
from facadelake.evaluation.history import HistoryFigures, compute_history_figures
from facadelake.tracking import link_history, list_look_requests

# As many detected defects in each of 20 campaigns as the goal says: 0.85 of those there, and a tenth false ones.
_LARGE = HistoryRecipe(
    defects=2000, campaigns=20, recall=0.85, new_share=0.05, length_m=250.0, height_m=60.0,
)  # fmt: skip


@dataclass(kw_only=True)
class PooledCounts:
    """Sums of the counts of many histories, and their IDF1."""

    idf1: list[float]
    right: int = 0
    total: int = 0
    repaired: int = 0
    false_repaired: int = 0
    missed: int = 0
    recovered: int = 0
    unchanged: int = 0
    false_changes: int = 0
    changed: int = 0
    found_changes: int = 0
    compared: int = 0
    inside: int = 0

    def add(self, figures: HistoryFigures) -> None:
        """Add a history."""
        self.idf1.append(figures.identity.idf1 or 0.0)
        for part in (figures.states, figures.changes):
            names = {one.name for one in fields(part)} & {one.name for one in fields(self)}
            for name in names:
                setattr(self, name, getattr(self, name) + getattr(part, name))
        self.compared += sum(one.count for one in figures.changes.by_quantity.values())
        self.inside += sum(one.inside for one in figures.changes.by_quantity.values())


def _pool_histories(recipe: HistoryRecipe, seeds: int) -> PooledCounts:
    counts = PooledCounts(idf1=[])
    for seed in range(seeds):
        counts.add(compute_history_figures(track_synthetic(draw_history(recipe, seed), seed)))
    return counts


def measure_synthetic(report: HistoryReport, work: Path, seeds: int) -> None:
    """Histories of five campaigns with a detector of recall 0.7."""
    recipe = HistoryRecipe()
    counts = _pool_histories(recipe, seeds)
    run = f"{seeds} drawn histories, recall {recipe.recall:g}"
    rates = recipe.looks
    report.add(run, Goal(figure="IDF1, mean"), float(np.mean(counts.idf1)), f"least {min(counts.idf1):.4f}")
    report.add(run, Goal(figure="states right"), counts.right / counts.total, f"{counts.right}/{counts.total}")
    report.add(
        run, Goal(figure=FALSE_REPAIRED, high=0.5, factor=100, unit="%", digits=2),
        counts.false_repaired / counts.repaired,
        f"{counts.false_repaired}/{counts.repaired}; looks say gone of {100 * rates.there_gone:g} % that are there, "
        f"same of {100 * rates.gone_same:g} % that are gone",
    )  # fmt: skip
    report.add(
        run, Goal(figure=RECOVERED), counts.recovered / counts.missed,
        f"{counts.recovered}/{counts.missed}; looks say same of {100 * rates.there_same:g} % that are there as they "
        f"were, of {100 * rates.changed_same:g} % in another size",
    )  # fmt: skip
    report.add(run, Goal(figure=INSIDE, low=0.90, high=0.99), counts.inside / counts.compared, f"{counts.compared}")


def measure_growth(report: HistoryReport, work: Path, seeds: int) -> None:
    """Pairs of campaigns that detect everything: repeated noise alone, and with a fifth of the defects grown."""
    same = HistoryRecipe(campaigns=2, recall=1.0, repaired_share=0.0, grown_share=0.0)
    counts = _pool_histories(same, seeds)
    report.add(f"{seeds} drawn pairs without growth", Goal(figure=FALSE_GROWTH, high=2, factor=100, unit="%", digits=2),
               counts.false_changes / counts.unchanged, f"{counts.false_changes}/{counts.unchanged}")  # fmt: skip
    report.add(f"{seeds} drawn pairs without growth", Goal(figure=INSIDE, low=0.90, high=0.99),
               counts.inside / counts.compared, f"{counts.compared}")  # fmt: skip
    grown = HistoryRecipe(campaigns=2, recall=1.0, repaired_share=0.0, grown_share=0.2)
    counts = _pool_histories(grown, seeds)
    run = f"{seeds} drawn pairs, 20 % grown by {grown.growth:g}"
    report.add(run, Goal(figure=FOUND_GROWTH, low=0.9), counts.found_changes / counts.changed,
               f"{counts.found_changes}/{counts.changed}")  # fmt: skip
    report.add(run, Goal(figure=FALSE_GROWTH, high=2, factor=100, unit="%", digits=2),
               counts.false_changes / counts.unchanged, f"{counts.false_changes}/{counts.unchanged}")  # fmt: skip
    report.add(run, Goal(figure=INSIDE, low=0.90, high=0.99), counts.inside / counts.compared, f"{counts.compared}")


@dataclass(frozen=True, kw_only=True)
class TrackingCost:
    """Wall and CPU seconds of tracking, the peak of the process (its drawn input alone: ``input_mib``), and counts."""

    wall_s: float
    cpu_s: float
    peak_mib: float
    input_mib: float
    detected: int
    tracks: int
    looks: int


def track_large_history(seed: int) -> TrackingCost:
    """Track 20 campaigns with 2,000 defects; what photographs would take for the looks is not part of it."""
    history = draw_history(_LARGE, seed)
    input_mib = _measure_peak_mib()
    begin, cpu = time.perf_counter(), time.process_time()
    linked = link_history(history.records, _LARGE.area_m2)
    requests = list_look_requests(linked)
    wall_s, cpu_s = time.perf_counter() - begin, time.process_time() - cpu
    looks = draw_looks(history, requests, seed)
    begin, cpu = time.perf_counter(), time.process_time()
    tables = build_tables(linked, looks).tables
    return TrackingCost(
        wall_s=wall_s + time.perf_counter() - begin,
        cpu_s=cpu_s + time.process_time() - cpu,
        peak_mib=_measure_peak_mib(),
        input_mib=input_mib,
        detected=round(float(np.mean([len(one.tracked.defects) for one in history.records]))),
        tracks=len(tables["tracks"]),
        looks=len(looks),
    )


def _measure_peak_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def measure_trends(report: HistoryReport, work: Path, seeds: int) -> None:
    """Trends of sizes that grow in known ways, and the dates at which they reach a limit."""
    for kind in GROWTHS:
        for campaigns in (3, 4, 6):
            counts = count_held_trends(kind, campaigns, seeds)
            run = f"{seeds} drawn sizes growing {kind}, {campaigns} campaigns"
            report.add(run, Goal(figure="latest rate inside 95 %", low=0.90), counts.rates_held / counts.trends)
            report.add(
                run, Goal(figure="date of the limit inside 95 %", low=0.90), counts.dates_held / max(counts.dates, 1),
                f"{counts.dates} dates, {counts.ends} with a latest one",
            )  # fmt: skip


def measure_size(report: HistoryReport, work: Path, seeds: int) -> None:
    """Time and memory of tracking a large building, in a process of its own."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        cost = pool.apply(track_large_history, (0,))
    run = f"20 campaigns x {cost.detected} detected defects"
    busy = os.getloadavg()[0]
    report.add(run, Goal(figure="tracking", high=20, unit="s", digits=1), cost.wall_s,
               f"{cost.cpu_s:.1f} s CPU; {cost.tracks} tracks, {cost.looks} looks; load {busy:.1f}")  # fmt: skip
    report.add(run, Goal(figure="peak memory", high=1024, unit="MiB", digits=0), cost.peak_mib,
               f"{cost.input_mib:.0f} MiB before")  # fmt: skip


def measure_coverage(report: HistoryReport, work: Path, seeds: int) -> None:
    """Coverage of the castle campaign by its published cameras."""
    found = measure_castle()
    report.add(
        f"coverage of the castle, {found.photographs} photographs",
        Goal(figure="time", high=GOAL_S, unit="s", digits=1), found.seconds,
        f"{found.cells} cells, {found.added_mib:.0f} MiB",
    )  # fmt: skip


PARTS: dict[str, Callable[[HistoryReport, Path, int], None]] = {
    "synthetic": measure_synthetic,
    "growth": measure_growth,
    "trends": measure_trends,
    "size": measure_size,
    "coverage": measure_coverage,
    "demo": lambda report, work, seeds: measure_demo(report, work),
    "pair": lambda report, work, seeds: measure_pair(report, work),
}


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"Parts to measure: {', '.join(PARTS)}; default: all.")
    parser.add_argument("--work", type=Path, help="Folder for lakes; existing lakes are reused.")
    parser.add_argument("--seeds", type=int, default=200, help="Number of drawn histories.")
    parser.add_argument("--json", type=Path, help="Also write all rows and figures to this file.")
    arguments = parser.parse_args()
    if unknown := sorted(set(arguments.parts) - set(PARTS)):
        parser.error(f"no part {', '.join(unknown)}; there are {', '.join(PARTS)}")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    print(
        f"{datetime.now(UTC):%Y-%m-%d}, {psutil.cpu_count()} cores, {psutil.virtual_memory().total / 2**30:.0f} GiB, "
        f"Python {platform.python_version()}"
    )
    report = HistoryReport()
    with tempfile.TemporaryDirectory() as scratch:
        work = (arguments.work or Path(scratch)).resolve()
        work.mkdir(parents=True, exist_ok=True)
        for part in arguments.parts or PARTS:
            PARTS[part](report, work, arguments.seeds)
    if arguments.json:
        arguments.json.write_text(json.dumps({"rows": report.rows, "figures": report.figures}, indent=1, default=str))


if __name__ == "__main__":
    main()
