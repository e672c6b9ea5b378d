"""How many defects of each class lie on each facade and storey (the paper's Fig. 19)."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from facadelake.pictures.inspection import Inspection
from facadelake.pictures.palette import class_colour
from facadelake.pictures.storeys import storey_levels

_DPI = 150
_COMPASS_ORDER = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
NO_STOREY = "no storey"


def facade_order(names: set[str]) -> list[str]:
    """Facades clockwise from north, then whatever else there is, by name."""
    return [n for n in _COMPASS_ORDER if n in names] + sorted(names - set(_COMPASS_ORDER))


def storey_order(inspection: Inspection) -> list[str]:
    """Storeys of the model and of the defects, the top one first, as they stand."""
    names = [level.name for level in storey_levels(inspection.building)][::-1]
    found = {name or NO_STOREY for name in inspection.defects.column("storey").to_pylist()}
    return names + sorted(found - set(names))


def draw_distribution(inspection: Inspection, path: Path) -> Path:
    """Write a PNG with a row of bars a storey, the top storey at the top, and a group of bars a facade."""
    rows = inspection.defects.select(["defect_class", "facade", "storey"]).to_pylist()
    counts = Counter((row["storey"] or NO_STOREY, row["facade"], row["defect_class"]) for row in rows)
    storeys = storey_order(inspection) or [NO_STOREY]
    facades = facade_order({row["facade"] for row in rows}) or ["none"]
    classes = sorted({row["defect_class"] for row in rows})
    width_in = max(6.0, 1.6 + 0.5 * len(facades) * max(len(classes), 1))
    figure = Figure(figsize=(width_in, 1.1 + 1.35 * len(storeys)), dpi=_DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    panels = np.atleast_1d(figure.subplots(len(storeys), 1, sharex=True, sharey=True))
    top = max(counts.values(), default=1)
    bar = 0.8 / max(len(classes), 1)
    for axes, storey in zip(panels, storeys, strict=True):
        for i, name in enumerate(classes):
            at = np.arange(len(facades)) + (i - (len(classes) - 1) / 2) * bar
            heights = [counts[(storey, facade, name)] for facade in facades]
            bars = axes.bar(at, heights, bar * 0.92, color=class_colour(name), label=name)
            axes.bar_label(bars, labels=[str(n) if n else "" for n in heights], fontsize=7.5, padding=1)
        axes.set_ylim(0, top * 1.22)
        axes.set_ylabel(storey.replace("$", r"\$"), rotation=0, ha="right", va="center", fontsize=9)
        axes.set_xticks(range(len(facades)), facades, fontsize=9)
        axes.set_yticks([])
        axes.spines[["top", "right", "left"]].set_visible(False)
        axes.tick_params(axis="x", length=0)
    if classes:
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower right", ncols=len(classes), fontsize=8.5, frameon=False)
    title = f"{inspection.building_name}, {inspection.campaign_id}: {len(rows)} defects by storey and facade"
    figure.suptitle(title.replace("$", r"\$"), fontsize=11, weight="bold", x=0.02, ha="left")
    figure.savefig(path, dpi=_DPI)
    return path
