"""Markdown table of a benchmark of histories: each figure beside its goal, printed as soon as it is measured."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Goal:
    """A figure's limits; ``factor`` and ``unit``: in which it is printed."""

    figure: str
    low: float = -math.inf
    high: float = math.inf
    factor: float = 1.0
    unit: str = ""
    digits: int = 4

    def format_limits(self) -> str:
        """The limits as text."""
        low = f">= {self.low:g} {self.unit}".rstrip() if math.isfinite(self.low) else ""
        high = f"<= {self.high:g} {self.unit}".rstrip() if math.isfinite(self.high) else ""
        return " and ".join(text for text in (low, high) if text)


FALSE_REPAIRED = "false `repaired` of those called so"
RECOVERED = "`seen` recovered by the second look"
FALSE_GROWTH = "size called changed where it is not"
FOUND_GROWTH = "growth found"
INSIDE = "true change inside 2 sigma"


@dataclass
class HistoryReport:
    """Rows of the table, and the figures behind them by run."""

    rows: list[dict[str, Any]] = field(default_factory=list)
    figures: dict[str, Any] = field(default_factory=dict)

    def add(self, run: str, goal: Goal, value: float | None, of: str = "") -> None:
        """Print a row.

        Args:
            run: what was measured.
            goal: its figure and limits.
            value: the figure; None where nothing was there to be measured.
            of: how many it is of, and what else belongs to it.
        """
        if not self.rows:
            print("\n| run | figure | goal | measured | of | met |\n|---|---|---|---|---|---|")
        scaled = None if value is None else goal.factor * value
        met = "yes" if scaled is not None and goal.low <= scaled <= goal.high else "NO"
        if scaled is None or not goal.format_limits():
            met = ""
        shown = "nothing to measure" if scaled is None else f"{scaled:.{goal.digits}f} {goal.unit}".rstrip()
        self.rows.append({"run": run, "value": value, "of": of, "met": met, **asdict(goal)})
        print(f"| {run} | {goal.figure} | {goal.format_limits()} | {shown} | {of} | {met} |", flush=True)

    def add_history(self, run: str, figures: dict[str, Any], *, idf1: float, states: float) -> None:
        """Print the rows of ``facadelake evaluate --history``; ``idf1`` and ``states`` are the goals of both."""
        self.figures[run] = figures
        identity, found, changes = figures["identity"], figures["states"], figures["changes"]
        self.add(run, Goal(figure="IDF1", low=idf1), identity["idf1"],
                 f"{identity['objects']} detected defects, {identity['switches']} switches")  # fmt: skip
        self.add(
            run, Goal(figure="states right", low=states), found["right_share"], f"{found['right']}/{found['total']}"
        )
        self.add(run, Goal(figure=FALSE_REPAIRED, high=0.0), found["false_repaired_share"],
                 f"{found['false_repaired']}/{found['repaired']}")  # fmt: skip
        self.add(run, Goal(figure=RECOVERED, low=0.8), found["recovered_share"],
                 f"{found['recovered_by_look']}/{found['missed_by_detector']}")  # fmt: skip
        self.add(run, Goal(figure=FALSE_GROWTH, high=0.02), changes["false_share"],
                 f"{changes['false_changes']}/{changes['unchanged']}")  # fmt: skip
        self.add(run, Goal(figure=FOUND_GROWTH, low=0.9), changes["found_share"],
                 f"{changes['found_changes']}/{changes['changed']}")  # fmt: skip
        counts = ", ".join(
            f"{name} {one['n']}: {one['inside_2sigma']:.3f}" for name, one in changes["by_quantity"].items()
        )
        self.add(run, Goal(figure=INSIDE, low=0.90, high=0.99), changes["inside_2sigma"], counts)
        for one in changes["offsets"]:
            self.add(
                run, Goal(figure=f"offset {one['before']} to {one['campaign_id']}", high=1.5, factor=100, unit="cm",
                          digits=2),
                one["offset_m"], f"{one['count']} unchanged defects, median distance {100 * one['distance_m']:.2f} cm",
            )  # fmt: skip
