"""The sheet round an elevation: axes in metres, storey lines, defects with their numbers, scale, legend, title."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon, Rectangle

from facadelake.core.arrays import UInt8Image
from facadelake.reporting.drawing.labels import place_labels
from facadelake.reporting.drawing.palette import escape_mathtext, get_class_colour, get_class_dashes
from facadelake.reporting.elevations.facades import Facade
from facadelake.reporting.elevations.marks import DefectMark
from facadelake.reporting.elevations.rectification import RectifiedElevation
from facadelake.reporting.elevations.storeys import StoreyBase

DPI = 150
_MAX_WIDTH_PX, _MIN_HEIGHT_PX, _MAX_HEIGHT_PX = 2400, 820, 1800
_LEFT_IN, _RIGHT_IN, _TOP_IN, _BOTTOM_IN = 0.75, 1.35, 0.8, 0.95
_MIN_AXES_IN = 4.6  # narrower facades leave no room for the title
_SIDE_BY_SIDE_IN = 10.5  # in a narrower sheet the classes stand in a row of their own, below the bars
_ROW_IN = 0.3


@dataclass(frozen=True, kw_only=True)
class ElevationLabels:
    """What is written round every elevation of a campaign."""

    building_name: str
    campaign_id: str
    control: str
    storeys: tuple[StoreyBase, ...]


def draw_elevation(
    scene: ElevationLabels, rectified: RectifiedElevation, background: UInt8Image, marks: Sequence[DefectMark],
    others: Sequence[DefectMark], covered: float,
) -> Figure:  # fmt: skip
    """The finished sheet.

    ``background`` has the relief's cells; ``marks`` are the facade's own, ``others`` those of other facades that it
    shows; ``covered`` is the share of its surface that photographs show.
    """
    facade, (rows, columns) = rectified.relief.facade, rectified.relief.shape
    scale = min(_MAX_WIDTH_PX / columns, _MAX_HEIGHT_PX / rows, max(1.0, _MIN_HEIGHT_PX / rows))
    width_in, height_in = columns * scale / DPI, rows * scale / DPI
    spare_in = max(0.0, _MIN_AXES_IN - width_in)
    wide_in = _LEFT_IN + width_in + spare_in + _RIGHT_IN
    bars_in = 0.32 if wide_in >= _SIDE_BY_SIDE_IN else 0.32 + _ROW_IN * (2 if others else 1)  # above the lower edge
    bottom_in = _BOTTOM_IN + bars_in - 0.32
    total_in = (wide_in, _TOP_IN + height_in + bottom_in)
    figure = Figure(figsize=total_in, dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_axes(
        (
            (_LEFT_IN + spare_in / 2) / total_in[0],
            bottom_in / total_in[1],
            width_in / total_in[0],
            height_in / total_in[1],
        )
    )
    zero = scene.storeys[0].z_site_m if scene.storeys else facade.v_min_m
    width_m, low, high = (
        columns * rectified.relief.cell_m,
        facade.v_max_m - rows * rectified.relief.cell_m,
        facade.v_max_m,
    )
    if scale < 1:
        background = cv2.resize(
            background, (round(columns * scale), round(rows * scale)), interpolation=cv2.INTER_AREA
        ).astype(np.uint8)
    axes.imshow(background, extent=(0.0, width_m, low - zero, high - zero), interpolation="nearest", aspect="auto")
    axes.set_xlim(0.0, width_m)
    axes.set_ylim(low - zero, high - zero)
    axes.tick_params(labelsize=8)
    axes.set_xlabel("metres along the facade, from its left as seen from outside", fontsize=8)
    axes.set_ylabel(f"metres above {scene.storeys[0].name if scene.storeys else 'the lowest point'}", fontsize=8)
    _draw_storey_lines(axes, scene, zero, width_m)
    _draw_defects(axes, facade, marks, others, zero, px_per_m=scale / rectified.relief.cell_m)
    _draw_deviations(figure, axes, facade, [*marks, *others], zero, total_in, bars_in)
    _draw_scale_bar(figure, axes, width_m, total_in, bars_in)
    _write_title(figure, scene, facade, marks, len(others), covered, rectified.relief.cell_m, total_in)
    return figure


def _draw_storey_lines(axes: Axes, scene: ElevationLabels, zero: float, width_m: float) -> None:
    low, high = axes.get_ylim()
    for storey in scene.storeys:
        level = storey.z_site_m - zero
        if low <= level <= high:
            axes.axhline(level, color="white", linewidth=1.6, alpha=0.7)
            axes.axhline(level, color="#202020", linewidth=0.7, dashes=(8, 4))
            axes.annotate(
                f"{storey.name}\n{level:+.2f} m", (width_m, level), xytext=(5, 0), textcoords="offset points",
                fontsize=7.5, va="bottom", annotation_clip=False,
            )  # fmt: skip


def _draw_defects(
    axes: Axes, facade: Facade, marks: Sequence[DefectMark], others: Sequence[DefectMark], zero: float, px_per_m: float
) -> None:
    """Outlines and numbers: filled labels for the facade's own, hollow ones for those counted on another facade."""
    everyone = [*marks, *others]
    if not everyone:
        return
    origin = [facade.u_min_m, zero]
    for mark in everyone:
        dashes, colour = get_class_dashes(mark.defect_class), get_class_colour(mark.defect_class)
        for ring in mark.outlines_site_m:
            uv = facade.uvw_from_site(ring)[:, :2] - origin
            axes.add_patch(Polygon(uv, closed=True, fill=False, edgecolor="white", linewidth=2.4))
            axes.add_patch(Polygon(uv, closed=True, fill=False, edgecolor=colour, linewidth=1.5, linestyle=dashes))
    corners = [facade.uvw_from_site(mark.corners_site_m)[:, :2] - origin for mark in everyone]
    boxes = np.array([[*uv.min(axis=0), *uv.max(axis=0)] for uv in corners])
    # A 6.5 point label at 150 dpi: 18 px high, 9 px a character, with its frame.
    sizes = np.array([[12 + 9.0 * len(mark.label), 18.0] for mark in everyone])
    bounds = np.array([axes.get_xlim(), axes.get_ylim()]).T.ravel() * px_per_m
    middles = place_labels(boxes * px_per_m, sizes, bounds) / px_per_m
    for place, (mark, box, middle) in enumerate(zip(everyone, boxes, middles, strict=True)):
        colour = get_class_colour(mark.defect_class)
        nearest = np.clip(middle, box[:2], box[2:])
        if np.linalg.norm((nearest - middle) * px_per_m / sizes[place]) > 0.75:
            axes.plot(*np.array([nearest, middle]).T, color="white", linewidth=2.0, solid_capstyle="butt", zorder=3)
            axes.plot(*np.array([nearest, middle]).T, color=colour, linewidth=0.8, zorder=3.1)
        ink, ground, rim = ("white", colour, "white") if place < len(marks) else (colour, "white", colour)
        axes.text(
            middle[0], middle[1], mark.label, fontsize=6.5, color=ink, ha="center", va="center_baseline", zorder=4,
            bbox={"boxstyle": "round,pad=0.18", "facecolor": ground, "edgecolor": rim, "linewidth": 0.6},
        )  # fmt: skip


def _draw_deviations(
    figure: Figure, axes: Axes, facade: Facade, marks: Sequence[DefectMark], zero: float, total_in: tuple[float, float],
    bars_in: float,
) -> None:  # fmt: skip
    """A dot where a defect's place was measured off the model, its colour how far; the colours' bar under the axes."""
    measured = [(mark, mark.deviation_m) for mark in marks if mark.deviation_m is not None]
    if not measured:
        return
    uv = facade.uvw_from_site(np.array([mark.centre_site_m for mark, _ in measured]))[:, :2] - [facade.u_min_m, zero]
    millimetres = np.array([1000.0 * deviation for _, deviation in measured])
    reach = next((n for n in (10, 20, 50, 100, 200, 500) if n >= np.abs(millimetres).max()), 1000)
    dots = axes.scatter(
        uv[:, 0], uv[:, 1], c=millimetres, cmap="PuOr", vmin=-reach, vmax=reach, s=16, edgecolors="black",
        linewidths=0.5, zorder=3.5,
    )  # fmt: skip
    box = axes.get_position()
    width = 1.7 / total_in[0]
    # The middle, but left of the scale bar and its number where the facade is narrow.
    middle = min((box.x0 + box.x1) / 2, box.x1 - max(box.width / 4, 0.4 / total_in[0]) - 1.35 / total_in[0])
    bar = figure.add_axes((middle - width / 2, bars_in / total_in[1], width, 0.07 / total_in[1]))
    figure.colorbar(dots, cax=bar, orientation="horizontal", ticks=[-reach, 0, reach])
    bar.tick_params(labelsize=7, length=2, pad=1)
    figure.text(
        middle,
        (bars_in + 0.1) / total_in[1],
        "dots: mm behind (-), before (+) the model",
        fontsize=7,
        ha="center",
        va="bottom",
    )


def _draw_scale_bar(figure: Figure, axes: Axes, width_m: float, total_in: tuple[float, float], bars_in: float) -> None:
    """A bar of two halves under the axes, about a sixth of the facade long."""
    length = next((n for n in (50.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.5) if n <= width_m / 4), 0.2)
    box = axes.get_position()
    per_m = box.width / width_m
    right, y = box.x1, bars_in / total_in[1]
    for i, colour in enumerate(("#202020", "white")):
        figure.add_artist(
            Rectangle(
                (right - length * per_m * (2 - i) / 2, y),
                length * per_m / 2,
                0.055 / total_in[1],
                facecolor=colour,
                edgecolor="#202020",
                linewidth=0.7,
            )
        )
    figure.text(right, y + 0.09 / total_in[1], f"{length:g} m", fontsize=8, ha="right", va="bottom")


def _write_title(
    figure: Figure, scene: ElevationLabels, facade: Facade, marks: Sequence[DefectMark], others: int, covered: float, cell_m: float,
    total_in: tuple[float, float],
) -> None:  # fmt: skip
    left, height = 0.2 / total_in[0], total_in[1]
    title = f"{escape_mathtext(scene.building_name)} — {facade.title} (faces {facade.azimuth_deg:.0f}°)"
    figure.text(left, 1 - 0.18 / height, title, fontsize=12, weight="bold", va="top")
    count = "no defects" if not marks else f"{len(marks)} defect{'s' if len(marks) != 1 else ''}"
    told = figure.text(
        left, 1 - 0.47 / height,
        f"campaign {escape_mathtext(scene.campaign_id)} · placed by {scene.control} · {count} · {1000 * cell_m:.0f} mm a cell · "
        f"photographs show {100 * covered:.0f} %",
        fontsize=8.5, va="top", color="#303030",
    )  # fmt: skip
    room = figure.bbox.width * (1 - 2 * left)
    told.set_fontsize(8.5 * min(1.0, room / told.get_window_extent().width))  # a narrow facade's sheet is narrow
    counts = Counter(mark.defect_class for mark in marks)
    handles = [
        Line2D(
            [],
            [],
            color=get_class_colour(name),
            linestyle=get_class_dashes(name),
            linewidth=2,
            label=f"{name} ({counts[name]})",
        )
        for name in sorted(counts)
    ]
    if others:
        note = f"hollow number: counted on another facade ({others})"
        figure.text(left, 0.12 / height, note, fontsize=8, va="bottom", color="#303030")
    if handles:
        corner = (left, (0.32 if others else 0.12) / height)
        figure.legend(
            handles=handles, loc="lower left", bbox_to_anchor=corner, ncols=len(handles), fontsize=8,
            frameon=False, handlelength=2.2, columnspacing=1.4, borderaxespad=0.0,
        )  # fmt: skip
