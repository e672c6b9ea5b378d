"""Histories of photographs: the campaigns of the demo and of the castle pair, inspected by the command line."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.foundation import DEMO, ROOT, SHARED, run_facadelake
from benchmarks.history_report import Goal, HistoryReport
from benchmarks.known_looks import count_known_looks
from schemas.vocabulary import LookVerdict

PAIR = SHARED / "castle-pair"
_PAIR_PORTFOLIO = """\
buildings:
  - id: castle
    name: Castle pair
    model: {shared}/castle/castle.ifc
    photographs: {shared}/castle-pair/{{campaign}}/images
    campaigns: ["2026-04", "2026-10"]
    detector:
      kind: coco
      file: {shared}/castle-pair/{{campaign}}/detections.coco.json
      alternatives:
        exact: {shared}/castle-pair/{{campaign}}/detections.coco.json
        noisy: {shared}/castle-pair/{{campaign}}/detections_noisy.coco.json
    severity_rules: width_and_extent_v1
"""
_GOALS = {  # IDF1, states right
    ("demo", "exact"): (0.99, 0.98),
    ("demo", "noisy"): (0.96, 0.94),
    ("castle-pair", "exact"): (0.98, 0.95),
    ("castle-pair", "noisy"): (0.93, 0.90),
}


def measure_demo(report: HistoryReport, work: Path) -> None:
    """The demo with all its campaigns, each with the control that ``auto`` selects."""
    if not DEMO.is_dir():
        run_facadelake("demo", "--lake", str(work / "demo-exact"))
    campaigns = sorted(path.name for path in (DEMO / "campaigns").iterdir())
    _measure(report, work, "demo", "demo", campaigns, DEMO, portfolio=None)


def measure_pair(report: HistoryReport, work: Path) -> None:
    """The castle pair, without control points: the first campaign by its model, the second in the first one's frame."""
    portfolio = work / "castle-pair.yaml"
    portfolio.write_text(_PAIR_PORTFOLIO.format(shared=SHARED), encoding="utf-8")
    _measure(report, work, "castle-pair", "castle", ["2026-04", "2026-10"], PAIR, portfolio=portfolio)


def _measure(
    report: HistoryReport,
    work: Path,
    name: str,
    building: str,
    campaigns: Sequence[str],
    truth: Path,
    *,
    portfolio: Path | None,
) -> None:
    """Inspect the campaigns with exact and with noisy boxes, each into a lake of its own, and evaluate both."""
    options = ["--portfolio", str(portfolio)] if portfolio else []
    for boxes in ("exact", "noisy"):
        lake = work / f"{name}-{boxes}"
        if boxes == "noisy" and not lake.exists():
            lake.mkdir(parents=True)
            (lake / "cache").symlink_to((work / f"{name}-exact" / "cache").resolve())  # the block is the same
        for campaign in campaigns:
            run_facadelake("inspect", building, campaign, "--detections", boxes, "--lake", str(lake), *options)
        plots = work / "pictures" / f"{name}-{boxes}"
        text, _ = run_facadelake(
            "evaluate", building, "--history", "--truth", str(truth), "--json", "--plots", str(plots), "--lake",
            str(lake), *options,
        )  # fmt: skip
        figures: dict[str, Any] = json.loads(text)
        idf1, states = _GOALS[name, boxes]
        report.add_history(f"{name}, {boxes} boxes", figures, idf1=idf1, states=states)
        print(f"<!-- pictures of wrong states: {plots} -->", flush=True)
        known = count_known_looks(portfolio or ROOT / "data" / "portfolio.yaml", building, lake, truth)
        _add_known_looks(report, f"{name}, {boxes} boxes", known)


def _add_known_looks(report: HistoryReport, run: str, known: Counter[tuple[str, LookVerdict]]) -> None:
    """Rows of what looks say of known places: ``gone`` of what is there is a false repair where the detector misses it,
    ``same`` recovers it."""
    for place in sorted({place for place, _ in known}):
        of_place = {verdict: known[place, verdict] for verdict in LookVerdict if known[place, verdict]}
        total = sum(of_place.values())
        verdicts = ", ".join(f"{verdict} {count}" for verdict, count in of_place.items())
        high = 0.0 if place.startswith("there") else math.inf
        report.add(
            run, Goal(figure=f"looks say gone: {place}", high=high), known[place, LookVerdict.GONE] / total, verdicts
        )
        if place == "there":
            share = known[place, LookVerdict.SAME] / total
            report.add(run, Goal(figure="looks say same: there, as if not detected", low=0.8), share, verdicts)
