"""The table of a registration benchmark and the goals that issue 4 set, as Markdown."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

COLUMNS = (
    "run", "localised", "camera mean cm", "ray mean cm", "observation mean / median cm", "defect MAE / p95 cm",
    "merge F1", "element right: obs. / defects", "missed / double / false", "near kept apart",
    "2 sigma: cameras / obs. / defects", "NEES obs. / defects", "s",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Goal:
    """A figure that the issue asks of a run, and whether more or less is better."""

    words: str
    run: str
    path: tuple[str, ...]
    low: float = -np.inf
    high: float = np.inf
    factor: float = 1.0
    unit: str = ""


def _coverage(run: str, *keys: str) -> list[Goal]:
    return [Goal(words=key, run=run, path=(key,), low=0.90, high=0.99) for key in keys]


_DEFECTS, _SINGLE = "coverage_2sigma_defects", "coverage_2sigma_observations"
GOALS = [
    Goal(words="single observations, 3D mean", run="castle, published cameras, exact boxes",
         path=("observation_error_m", "mean"), high=4.5, factor=100, unit="cm"),
    Goal(words="merged defects, 3D MAE", run="castle, published cameras, exact boxes",
         path=("defect_error_m", "mae"), high=1.0, factor=100, unit="cm"),
    Goal(words="merged defects, 3D MAE", run="castle, gcp, exact boxes", path=("defect_error_m", "mae"), high=1.2,
         factor=100, unit="cm"),
    Goal(words="merged defects, p95", run="castle, gcp, exact boxes", path=("defect_error_m", "p95"), high=3.0,
         factor=100, unit="cm"),
    Goal(words="merged defects, 3D MAE", run="castle, model, exact boxes", path=("defect_error_m", "mae"), high=3.0,
         factor=100, unit="cm"),
    *(Goal(words=f"merged defects, {key}", run=f"demo {campaign}, gcp, exact boxes", path=("defect_error_m", key),
           high=high, factor=100, unit="cm")
      for campaign in ("2026-04", "2026-10") for key, high in (("mae", 1.0), ("p95", 3.0))),
    *(Goal(words="merging, pairwise F1", run=f"{run}, {boxes} boxes", path=("merge", "f1"), low=low)
      for run in ("castle, published cameras", "castle, gcp", "demo 2026-04, gcp", "demo 2026-10, gcp")
      for boxes, low in (("exact", 0.99), ("noisy", 0.97))),
    *(Goal(words=f"element right, {of}", run=run, path=(key,), low=0.98)
      for of, key in (("observations", "element_correct_share"), ("defects", "element_correct_share_defects"))
      for run in ("castle, published cameras, exact boxes", "castle, gcp, exact boxes")),
    *(goal for run in ("castle, published cameras with noise, exact boxes", "castle, gcp, exact boxes",
                       "castle, model, exact boxes", "demo 2026-04, gcp, exact boxes")
      for goal in _coverage(run, _SINGLE, _DEFECTS)),
]  # fmt: skip


@dataclass
class Report:
    """Rows as they come, and the figures behind them."""

    figures: dict[str, dict[str, Any]] = field(default_factory=dict)

    def add(self, run: str, figures: dict[str, Any], seconds: float) -> None:
        """Print one row at once: a benchmark that is cut off has told what it knew."""
        if not self.figures:
            print(f"\n| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
        self.figures[run] = figures
        print(f"| {' | '.join(_cells(run, figures, seconds))} |", flush=True)

    def goals(self) -> None:
        """The issue's goals that were measured."""
        print("\n| goal | run | wanted | found | |\n|---|---|---|---|---|")
        for goal in GOALS:
            if goal.run in self.figures:
                print(f"| {goal.words} | {goal.run} | {' | '.join(_reached(goal, self.figures[goal.run]))} |")


def _reached(goal: Goal, figures: dict[str, Any]) -> tuple[str, str, str]:
    value: Any = figures
    for key in goal.path:
        value = value[key]
    bounds = [f">= {goal.low:g}"] if np.isfinite(goal.low) else []
    bounds += [f"<= {goal.high:g} {goal.unit}".rstrip()] if np.isfinite(goal.high) else []
    if value is None:
        return " and ".join(bounds), "not stated", "no"
    scaled = goal.factor * value
    return (
        " and ".join(bounds),
        f"{scaled:.3f} {goal.unit}".rstrip(),
        "yes" if goal.low <= scaled <= goal.high else "NO",
    )


def _cells(run: str, figures: dict[str, Any], seconds: float) -> list[str]:
    def cm(key: str, name: str) -> str:
        value = figures[key][name]
        return "-" if value is None else f"{100 * value:.2f}"

    def number(value: float | None, digits: int = 2) -> str:
        return "-" if value is None else f"{value:.{digits}f}"

    points, consistency = figures["check_points"], figures["covariance_consistency"]
    shares = ("coverage_2sigma", _SINGLE, _DEFECTS)
    return [
        run,
        f"{figures['photographs']['localised']}/{figures['photographs']['total']}",
        cm("camera_error_m", "mean"),
        cm("ray_error_m", "mean"),
        f"{cm('observation_error_m', 'mean')} / {cm('observation_error_m', 'median')}",
        f"{cm('defect_error_m', 'mae')} / {cm('defect_error_m', 'p95')}",
        number(figures["merge"]["f1"], 4),
        f"{number(figures['element_correct_share'], 3)} / {number(figures['element_correct_share_defects'], 3)}",
        f"{points['lost']} / {points['duplicated']} / {points['false_defects']}",
        f"{points['near_apart']}/{points['near_pairs']}",
        " / ".join(number(figures[key]) for key in shares),
        f"{number(consistency['observations']['nees'])} / {number(consistency['defects']['nees'])}",
        f"{seconds:.0f}",
    ]
