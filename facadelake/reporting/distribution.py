"""Distribution of defects by class, facade and storey (the paper's Fig. 19): bar chart and tables."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from facadelake.building.facades import collect_facades
from facadelake.reporting.drawing.palette import escape_mathtext, get_class_colour, get_class_hatch
from facadelake.reporting.elevations.storeys import find_storey_bases
from facadelake.reporting.inspection import Inspection

_DPI = 150
NO_STOREY = "no storey"
_NO_AZIMUTH_DEG = 999.0  # sorts facades without a direction last
_PANELS_PER_ROW = 6
_PANEL_IN, _STOREY_IN, _LINE_IN = 1.75, 0.34, 0.2


@dataclass(frozen=True, kw_only=True)
class Distribution:
    """Counts and areas of defects by (facade, storey, class); facades, storeys and classes in the order of display."""

    facades: tuple[str, ...]
    storeys: tuple[str, ...]
    classes: tuple[str, ...]
    counts: Counter[tuple[str, str, str]]
    areas_m2: Counter[tuple[str, str, str]]

    def count_defects(self, facade: str | None = None, defect_class: str | None = None) -> int:
        """Number of defects of a facade and a class; None: all."""
        return sum(n for (f, _, c), n in self.counts.items() if facade in (None, f) and defect_class in (None, c))


def compute_distribution(inspection: Inspection) -> Distribution:
    """Facades clockwise from north, then those without a direction; storeys from the top down."""
    rows = inspection.defects.select(["defect_class", "facade", "storey", "area_m2"]).to_pylist()
    keys = [(row["facade"], row["storey"] or NO_STOREY, row["defect_class"]) for row in rows]
    areas: Counter[tuple[str, str, str]] = Counter()
    for key, row in zip(keys, rows, strict=True):
        areas[key] += row["area_m2"]
    occurring = {storey for _, storey, _ in keys}
    of_model = [base.name for base in find_storey_bases(inspection.building)][::-1]
    return Distribution(
        facades=tuple(_sort_clockwise({facade for facade, _, _ in keys}, inspection)),
        storeys=tuple(of_model + sorted(occurring - set(of_model))),
        classes=tuple(sorted({defect_class for _, _, defect_class in keys})),
        counts=Counter(keys),
        areas_m2=areas,
    )


def _sort_clockwise(names: set[str], inspection: Inspection) -> list[str]:
    """Facades by their outward azimuth; those without one, such as "level", last."""
    facades = collect_facades(inspection.building.elements)
    azimuth_deg = {name: facades.get_azimuth_deg(name) for name in names}
    return sorted(names, key=lambda name: (_NO_AZIMUTH_DEG if (turn := azimuth_deg[name]) is None else turn, name))


def write_distribution(distribution: Distribution, path: Path) -> Path:
    """Write a CSV with one line per facade, storey and class with defects: their number and area in square metres."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["facade", "storey", "defect_class", "defects", "area_m2"])
        for facade in distribution.facades:
            for storey in distribution.storeys:
                for defect_class in distribution.classes:
                    if count := distribution.counts[facade, storey, defect_class]:
                        area = distribution.areas_m2[facade, storey, defect_class]
                        writer.writerow([facade, storey, defect_class, count, f"{area:.4f}"])
    return path


def format_distribution_title(inspection: Inspection) -> str:
    """Title of the chart."""
    count = len(inspection.defects)
    defects = "1 defect" if count == 1 else f"{count} defects"
    return f"{inspection.building_name}, {inspection.campaign_id}: {defects} by facade and storey"


def draw_distribution(distribution: Distribution, title: str, path: Path) -> Path:
    """Write a PNG: one panel per facade with one stacked bar per storey, the top storey first; totals below."""
    facades, storeys = distribution.facades or ("none",), distribution.storeys or (NO_STOREY,)
    rows = -(-len(facades) // _PANELS_PER_ROW)
    across = min(len(facades), _PANELS_PER_ROW)
    names_in = 0.35 + 0.085 * max(len(storey) for storey in storeys)
    panel_in = max(_PANEL_IN, 5.0 / across)
    width = names_in + across * panel_in + 0.3
    panels_in = rows * (len(storeys) * _STOREY_IN + 0.55)
    table_in = (len(distribution.classes) + 3) * _LINE_IN
    height = 0.65 + panels_in + 0.35 + table_in
    figure = Figure(figsize=(width, height), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    longest = max(
        (sum(distribution.counts[f, s, c] for c in distribution.classes) for f in facades for s in storeys), default=1
    )
    for index, facade in enumerate(facades):
        row, column = divmod(index, _PANELS_PER_ROW)
        left, top = names_in + column * panel_in, 0.85 + row * (len(storeys) * _STOREY_IN + 0.55)
        panel_height_in = len(storeys) * _STOREY_IN
        axes = figure.add_axes(
            (
                left / width,
                1 - (top + panel_height_in) / height,
                (panel_in - 0.2) / width,
                panel_height_in / height,
            )
        )
        _draw_panel(axes, distribution, facade, storeys, max(longest, 1), named=column == 0)
    figure.text(0.12 / width, 1 - 0.12 / height, escape_mathtext(title), fontsize=11, weight="bold", va="top")
    handles = [
        Patch(facecolor=get_class_colour(name), hatch=get_class_hatch(name), edgecolor="white", label=name)
        for name in distribution.classes
    ]
    if handles:
        corner = (0.06 / width, 1 - 0.32 / height)
        figure.legend(
            handles=handles, loc="upper left", bbox_to_anchor=corner, ncols=len(handles), fontsize=8.5, frameon=False,
            borderaxespad=0.0,
        )  # fmt: skip
    _write_totals(figure, distribution, width, height, table_in)
    figure.savefig(path, dpi=_DPI)
    return path


def _draw_panel(
    axes: Axes, distribution: Distribution, facade: str, storeys: Sequence[str], longest: int, *, named: bool
) -> None:
    """Draw the bars of one facade, the top storey at the top."""
    positions = np.arange(len(storeys))[::-1]
    ends = np.zeros(len(storeys))
    for name in distribution.classes:
        counts = np.array([distribution.counts[facade, storey, name] for storey in storeys])
        axes.barh(
            positions, counts, 0.72, left=ends, color=get_class_colour(name), hatch=get_class_hatch(name),
            edgecolor="white", linewidth=0.6,
        )  # fmt: skip
        ends += counts
    for position, end in zip(positions, ends, strict=True):
        axes.text(end + 0.02 * longest, position, f"{end:.0f}" if end else "", fontsize=8, va="center")
    axes.set_title(escape_mathtext(facade), fontsize=9.5, loc="left", pad=4)
    axes.set_xlim(0, longest * 1.2)
    axes.set_ylim(-0.6, len(storeys) - 0.4)
    axes.set_yticks(positions, [escape_mathtext(storey) if named else "" for storey in storeys], fontsize=8.5)
    axes.set_xticks([])
    axes.tick_params(axis="y", length=0)
    axes.spines[["top", "right", "bottom"]].set_visible(False)


def _write_totals(figure: Figure, distribution: Distribution, width: float, height: float, table_in: float) -> None:
    """Write the table of totals by class and facade below the panels."""
    facades = distribution.facades
    heads = [*facades, "all"]
    rows: list[tuple[str, list[int]]] = [
        (name, [distribution.count_defects(facade, name) for facade in (*facades, None)])
        for name in distribution.classes
    ]
    rows.append(("all", [distribution.count_defects(facade) for facade in (*facades, None)]))
    first = 0.3 + 0.085 * max(len(name) for name, _ in rows)
    step = min((width - first - 0.3) / len(heads), 1.1)

    def write(x: float, y: float, text: str, *, bold: bool = False, right: bool = True) -> None:
        figure.text(
            x / width, y / height, escape_mathtext(text), fontsize=8.5, ha="right" if right else "left", va="center",
            weight="bold" if bold else "normal",
        )  # fmt: skip

    y = table_in
    for column, head in enumerate(heads, start=1):
        write(first + column * step, y, head, bold=True)
    for name, numbers in rows:
        y -= _LINE_IN
        write(0.12, y, name, bold=name == "all", right=False)
        for column, number in enumerate(numbers, start=1):
            write(first + column * step, y, str(number) if number else "–", bold=name == "all")
