"""Markdown table of a registration benchmark, and the goals that issue 4 set."""

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
    """A figure of a run and its limits; ``factor`` converts it to ``unit``. ``path``: its keys in the figures."""

    figure: str
    run: str
    path: tuple[str, ...]
    low: float = -np.inf
    high: float = np.inf
    factor: float = 1.0
    unit: str = ""


def _list_coverage_goals(run: str, *keys: str) -> list[Goal]:
    return [Goal(figure=key, run=run, path=(key,), low=0.90, high=0.99) for key in keys]


_DEFECTS, _SINGLE = "coverage_2sigma_defects", "coverage_2sigma_observations"
GOALS = [
    Goal(figure="single observations, 3D mean", run="castle, published cameras, exact boxes",
         path=("observation_error_m", "mean"), high=4.5, factor=100, unit="cm"),
    Goal(figure="merged defects, 3D MAE", run="castle, published cameras, exact boxes",
         path=("defect_error_m", "mae"), high=1.0, factor=100, unit="cm"),
    Goal(figure="merged defects, 3D MAE", run="castle, gcp, exact boxes", path=("defect_error_m", "mae"), high=1.2,
         factor=100, unit="cm"),
    Goal(figure="merged defects, p95", run="castle, gcp, exact boxes", path=("defect_error_m", "p95"), high=3.0,
         factor=100, unit="cm"),
    Goal(figure="merged defects, 3D MAE", run="castle, model, exact boxes", path=("defect_error_m", "mae"), high=3.0,
         factor=100, unit="cm"),
    *(Goal(figure=f"merged defects, {key}", run=f"demo {campaign}, gcp, exact boxes", path=("defect_error_m", key),
           high=high, factor=100, unit="cm")
      for campaign in ("2026-04", "2026-10") for key, high in (("mae", 1.0), ("p95", 3.0))),
    *(Goal(figure="merging, pairwise F1", run=f"{run}, {boxes} boxes", path=("merge", "f1"), low=low)
      for run in ("castle, published cameras", "castle, gcp", "demo 2026-04, gcp", "demo 2026-10, gcp")
      for boxes, low in (("exact", 0.99), ("noisy", 0.97))),
    *(Goal(figure=f"element right, {of}", run=run, path=(key,), low=0.98)
      for of, key in (("observations", "element_correct_share"), ("defects", "element_correct_share_defects"))
      for run in ("castle, published cameras, exact boxes", "castle, gcp, exact boxes")),
    *(goal for run in ("castle, published cameras with noise, exact boxes", "castle, gcp, exact boxes",
                       "castle, model, exact boxes", "demo 2026-04, gcp, exact boxes")
      for goal in _list_coverage_goals(run, _SINGLE, _DEFECTS)),
]  # fmt: skip


@dataclass
class RegistrationReport:
    """Rows of the table, printed one by one, and their figures by run."""

    figures: dict[str, dict[str, Any]] = field(default_factory=dict)

    def add(self, run: str, figures: dict[str, Any], seconds: float) -> None:
        """Print the row of a run immediately, so that an interrupted benchmark has printed its completed runs."""
        if not self.figures:
            print(f"\n| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
        self.figures[run] = figures
        print(f"| {' | '.join(_format_cells(run, figures, seconds))} |", flush=True)

    def print_goals(self) -> None:
        """Print the goals whose runs were measured."""
        print("\n| goal | run | limit | measured | met |\n|---|---|---|---|---|")
        for goal in GOALS:
            if goal.run in self.figures:
                print(f"| {goal.figure} | {goal.run} | {' | '.join(_format_goal(goal, self.figures[goal.run]))} |")


def _format_goal(goal: Goal, figures: dict[str, Any]) -> tuple[str, str, str]:
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


def _format_cells(run: str, figures: dict[str, Any], seconds: float) -> list[str]:
    def format_cm(key: str, name: str) -> str:
        value = figures[key][name]
        return "-" if value is None else f"{100 * value:.2f}"

    def format_number(value: float | None, digits: int = 2) -> str:
        return "-" if value is None else f"{value:.{digits}f}"

    points, consistency = figures["check_points"], figures["covariance_consistency"]
    element_shares = ("element_correct_share", "element_correct_share_defects")
    shares = ("coverage_2sigma", _SINGLE, _DEFECTS)
    return [
        run,
        f"{figures['photographs']['localised']}/{figures['photographs']['total']}",
        format_cm("camera_error_m", "mean"),
        format_cm("ray_error_m", "mean"),
        f"{format_cm('observation_error_m', 'mean')} / {format_cm('observation_error_m', 'median')}",
        f"{format_cm('defect_error_m', 'mae')} / {format_cm('defect_error_m', 'p95')}",
        format_number(figures["merge"]["f1"], 4),
        " / ".join(format_number(figures[key], 3) for key in element_shares),
        f"{points['lost']} / {points['duplicated']} / {points['false_defects']}",
        f"{points['near_apart']}/{points['near_pairs']}",
        " / ".join(format_number(figures[key]) for key in shares),
        f"{format_number(consistency['observations']['nees'])} / {format_number(consistency['defects']['nees'])}",
        f"{seconds:.0f}",
    ]
