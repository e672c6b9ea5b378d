"""The sheet of the passport: plan view, view from the south, facts and residuals."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from facadelake.core.arrays import Float64Array
from facadelake.core.geodesy import SITE_AXES
from facadelake.reporting.drawing.palette import POINT_STYLES
from facadelake.reporting.inspection import Inspection
from facadelake.reporting.passport.facts import (
    Fact,
    FactStatus,
    format_length,
    list_passport_facts,
    summarise_passport,
)
from facadelake.reporting.passport.views import (
    NORTH,
    UP,
    DrawingScales,
    PassportGeometry,
    choose_scales,
    collect_geometry,
    compute_extent,
    draw_view,
)
from schemas.vocabulary import PointKind

_DPI = 150
_VIEW_IN, _VIEW_HEIGHT_IN = 7.2, 7.9
_TOP_IN, _RIGHT_IN, _LEAST_HEIGHT_IN = 0.95, 6.5, 10.8
_LINE_IN = 0.155
_STATUS_COLOURS = {
    FactStatus.GOOD: "#00664a",
    FactStatus.CHECK: "#8a5a00",
    FactStatus.POOR: "#a32d00",
    FactStatus.NONE: "#202020",
}
_KIND_LABELS = {
    PointKind.CONTROL: "control point, adjusted",
    PointKind.HELD_OUT: "control point, held out",
    PointKind.CHECK: "check point",
    PointKind.GPS: "GPS position of a photograph (true scale)",
}


def draw_passport(inspection: Inspection, path: Path) -> Path:
    """Write the passport as a PNG: plan view and view from the south on the left, facts and residuals on the right."""
    row = inspection.georeference.to_pylist()[0]
    facts = list_passport_facts(row, inspection.poses, placement_sigma_max_m=inspection.placement_sigma_max_m)
    geometry = collect_geometry(inspection)
    corners = compute_extent(inspection, geometry)
    wide, deep, high = corners[1] - corners[0]
    per_m = min(_VIEW_IN / wide, _VIEW_HEIGHT_IN / (deep + high))
    scales = choose_scales(geometry, float(max(wide, deep)))

    height_in = max(_TOP_IN + (deep + high) * per_m + 1.8, _LEAST_HEIGHT_IN)
    width_in = 0.75 + _VIEW_IN + _RIGHT_IN
    figure = Figure(figsize=(width_in, height_in), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)

    def axes_at(left: float, top: float, width: float, height: float) -> Axes:
        return figure.add_axes((left / width_in, 1 - (top + height) / height_in, width / width_in, height / height_in))

    _write_heading(figure, inspection, row, facts, height_in)
    left = 0.75 + (_VIEW_IN - wide * per_m) / 2
    plan = axes_at(left, _TOP_IN, wide * per_m, deep * per_m)
    draw_view(plan, inspection, geometry, NORTH, corners, scales)
    plan.set_ylabel("north (m)", fontsize=8)
    side = axes_at(left, _TOP_IN + deep * per_m + 0.35, wide * per_m, high * per_m)
    draw_view(side, inspection, geometry, UP, corners, scales)
    side.set_ylabel("up (m)", fontsize=8)
    side.set_xlabel("east of the site's origin (m); top: plan view, bottom: view from the south", fontsize=8)
    _draw_legend(figure, geometry, scales)
    _draw_scale_bars(plan, geometry, scales, float(wide), row_m=0.16 / per_m)

    right = 0.75 + _VIEW_IN + 0.35
    bottom = _write_facts(figure, facts, right, width_in, height_in)
    panels = [("surveyed points: adjusted minus surveyed position (mm)", geometry.surveyed, 1000.0, False)]
    gps = tuple(group for group in geometry.points if group[0] == PointKind.GPS)
    panels.append(("GPS position minus adjusted camera (m); bar: median", gps, 1.0, True))
    each = (height_in - bottom - 0.35) / len(panels)
    for k, (title, groups, unit, common) in enumerate(panels):
        axes = axes_at(right + 0.5, bottom + k * each + 0.3, _RIGHT_IN - 1.1, each - 0.65)
        _draw_residuals(axes, groups, unit, common=common)
        axes.set_title(title, fontsize=8.5, loc="left")
    figure.savefig(path, dpi=_DPI)
    return path


def _write_heading(
    figure: Figure, inspection: Inspection, row: dict[str, Any], facts: tuple[Fact, ...], height: float
) -> None:
    status, sentence = summarise_passport(row, facts)
    title = f"{inspection.building_name}, {inspection.campaign_id}: passport"
    figure.text(0.012, 1 - 0.12 / height, title, fontsize=13, weight="bold", va="top", parse_math=False)
    for k, line in enumerate(textwrap.wrap(sentence, 150)[:2]):
        figure.text(
            0.012, 1 - (0.45 + 0.22 * k) / height, line, fontsize=10.5, weight="bold", va="top", parse_math=False,
            color=_STATUS_COLOURS[status],
        )  # fmt: skip


def _write_facts(figure: Figure, facts: tuple[Fact, ...], left: float, width: float, height: float) -> float:
    """Write the facts one below the other; returns their lower end, inches from the top of the sheet."""
    top = _TOP_IN
    for fact in facts:
        colour = _STATUS_COLOURS[fact.status]
        status = fact.status.upper() if fact.status else ""
        figure.text(left / width, 1 - top / height, status, fontsize=8, weight="bold", color=colour, va="top")
        figure.text((left + 0.55) / width, 1 - top / height, fact.name, fontsize=8.5, weight="bold", va="top")
        lines = textwrap.wrap(fact.value, 56)
        if fact.limit:
            lines += textwrap.wrap(f"limit {fact.limit}", 56)
        for k, line in enumerate(lines):
            figure.text(
                (left + 2.45) / width, 1 - (top + _LINE_IN * k) / height, line, fontsize=8.5, va="top",
                parse_math=False, color="#606060" if line.startswith("limit ") else "#202020",
            )  # fmt: skip
        top += _LINE_IN * len(lines) + 0.12
    return top


def _draw_legend(figure: Figure, geometry: PassportGeometry, scales: DrawingScales) -> None:
    handles = [
        Line2D([], [], color="#202020", marker="o", markersize=4, linestyle="none", label="camera"),
        Line2D(
            [], [], color="#0072b2", marker="o", markersize=9, markerfacecolor="#56b4e955", linestyle="none",
            label=f"95 % confidence ellipse, {_format_factor(scales.ellipses)}",
        ),
    ]  # fmt: skip
    for kind, given, _ in geometry.points:
        colour, marker = POINT_STYLES[kind]
        label = f"{_KIND_LABELS[PointKind(kind)]} ({len(given)})"
        handles.append(Line2D([], [], color=colour, marker=marker, markersize=5, linestyle="none", label=label))
    if geometry.surveyed:
        label = f"residual, surveyed to adjusted position, {_format_factor(scales.residuals)}"
        handles.append(
            Line2D([], [], color="#606060", marker=r"$\rightarrow$", markersize=10, linestyle="none", label=label)
        )
    figure.legend(handles=handles, loc="lower left", fontsize=8, frameon=False, ncols=2)


def _format_factor(factor: float) -> str:
    if factor == 1:
        return "true scale"
    return f"enlarged {factor:g} times" if factor > 1 else f"reduced {1 / factor:g} times"


def _draw_scale_bars(
    axes: Axes, geometry: PassportGeometry, scales: DrawingScales, wide_m: float, row_m: float
) -> None:
    """Draw scale bars of the plan, the ellipses and the residuals in the plan's lower left corner."""
    low_x, low_y = axes.get_xlim()[0], axes.get_ylim()[0]
    bars = [(1.0, "#202020", "plan"), (scales.ellipses, "#0072b2", "ellipses")]
    if geometry.surveyed:
        bars.append((scales.residuals, "#606060", "residuals"))
    for k, (factor, colour, name) in enumerate(bars):
        fitting = [p * 10.0**e for e in range(-3, 4) for p in (1, 2, 5) if p * 10.0**e * factor <= wide_m / 8]
        length = max(fitting, default=0.001)
        y = low_y + row_m * (0.6 + k)
        axes.add_patch(
            Rectangle(
                (low_x + row_m * 0.5, y), length * factor, row_m * 0.3, facecolor=colour, edgecolor="white", zorder=7
            )
        )
        axes.text(
            low_x + row_m * 0.7 + length * factor, y + row_m * 0.15, f"{name}: {format_length(length)}", fontsize=7.5,
            va="center", zorder=7, bbox={"facecolor": "#ffffffc0", "edgecolor": "none", "pad": 0.8},
        )  # fmt: skip


def _draw_residuals(
    axes: Axes, groups: tuple[tuple[str, Float64Array, Float64Array], ...], unit: float, *, common: bool
) -> None:
    """Draw the signed residuals along each axis of site, with their medians where ``common``."""
    axes.set_yticks(range(3), SITE_AXES, fontsize=8)
    axes.set_ylim(2.6, -0.6)
    axes.tick_params(labelsize=8)
    axes.axvline(0.0, color="#202020", linewidth=0.8)
    axes.grid(axis="x", color="#e4e4e4", linewidth=0.6)
    axes.set_axisbelow(True)
    if not groups:
        axes.text(
            0.5,
            0.5,
            "not measured",
            transform=axes.transAxes,
            ha="center",
            va="center",
            fontsize=9,
            color="#606060",
        )
        axes.set_xticks([])
        return
    for k, (kind, _, residual) in enumerate(groups):
        colour, marker = POINT_STYLES[kind]
        values = residual * unit * (1.0 if common else -1.0)
        for axis in range(3):
            y = np.full(len(values), axis + 0.26 * (k - (len(groups) - 1) / 2))
            axes.plot(values[:, axis], y, marker, color=colour, markersize=4.5, alpha=0.8, linestyle="none")
            if common:
                axes.plot([np.median(values[:, axis])] * 2, [axis - 0.35, axis + 0.35], color="#202020", linewidth=1.6)
    largest = float(max(np.abs(residual).max() for _, _, residual in groups)) * unit
    axes.set_xlim(-1.1 * largest - 1e-9, 1.1 * largest + 1e-9)
