"""The sheet of an elevation: axes in metres, storey lines, defects with labels, scale bar, legend, title."""

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
_MIN_AXES_IN = 4.6  # least width of the axes with the margin beside them, for the title
_SIDE_BY_SIDE_IN = 10.5  # in narrower sheets the legend is in a row below the bars
_ROW_IN = 0.3


@dataclass(frozen=True, kw_only=True)
class ElevationLabels:
    """Title and storey levels common to all elevations of a campaign."""

    building_name: str
    campaign_id: str
    control: str
    storeys: tuple[StoreyBase, ...]


def draw_elevation(
    labels: ElevationLabels, rectified: RectifiedElevation, background: UInt8Image, marks: Sequence[DefectMark],
    others: Sequence[DefectMark], covered: float, hidden: float,
) -> Figure:  # fmt: skip
    """Draw the sheet of one elevation.

    Args:
        labels: title and storey levels.
        rectified: the elevation.
        background: picture (rows, columns, RGB) of the elevation, one pixel per cell.
        marks: defects of the facade.
        others: defects of other facades that are visible in the elevation.
        covered: share of the surface that photographs show.
        hidden: share in the view of photographs that something hides; it is hatched.
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
    left_m, right_m = facade.u_min_m, facade.u_min_m + columns * rectified.relief.cell_m
    low_m, high_m = facade.v_max_m - rows * rectified.relief.cell_m, facade.v_max_m
    if scale < 1:
        background = cv2.resize(
            background, (round(columns * scale), round(rows * scale)), interpolation=cv2.INTER_AREA
        ).astype(np.uint8)
    axes.imshow(background, extent=(left_m, right_m, low_m, high_m), interpolation="nearest", aspect="auto")
    axes.set_xlim(left_m, right_m)
    axes.set_ylim(low_m, high_m)
    axes.tick_params(labelsize=8)
    axes.set_xlabel("u (m): to the right as seen from outside, from the site's origin", fontsize=8)
    axes.set_ylabel("v (m): up, from the site's origin", fontsize=8)
    draw_storey_lines(axes, labels)
    _draw_defects(axes, facade, marks, others, px_per_m=scale / rectified.relief.cell_m)
    _draw_deviations(figure, axes, facade, [*marks, *others], total_in, bars_in)
    draw_scale_bar(figure, axes, right_m - left_m, total_in, bars_in)
    _write_title(figure, labels, facade, marks, len(others), (covered, hidden), rectified.relief.cell_m, total_in)
    return figure


def draw_storey_lines(axes: Axes, labels: ElevationLabels) -> None:
    """Draw the base level of each storey that is in view, with its name beside the axes."""
    low, high = axes.get_ylim()
    right = axes.get_xlim()[1]
    for storey in labels.storeys:
        level = storey.z_site_m
        if low <= level <= high:
            axes.axhline(level, color="white", linewidth=1.6, alpha=0.7)
            axes.axhline(level, color="#202020", linewidth=0.7, dashes=(8, 4))
            axes.annotate(
                f"{escape_mathtext(storey.name)}\n{level:+.2f} m", (right, level), xytext=(5, 0),
                textcoords="offset points", fontsize=7.5, va="bottom", annotation_clip=False,
            )  # fmt: skip


def _draw_defects(
    axes: Axes,
    facade: Facade,
    marks: Sequence[DefectMark],
    others: Sequence[DefectMark],
    px_per_m: float,
) -> None:
    """Draw outlines and labels: filled labels for the facade's own defects, hollow ones for other facades' defects."""
    all_marks = [*marks, *others]
    if not all_marks:
        return
    for mark in all_marks:
        dashes, colour = get_class_dashes(mark.defect_class), get_class_colour(mark.defect_class)
        for ring in mark.outlines_site_m:
            uv = facade.uvw_from_site(ring)[:, :2]
            axes.add_patch(Polygon(uv, closed=True, fill=False, edgecolor="white", linewidth=2.4))
            axes.add_patch(Polygon(uv, closed=True, fill=False, edgecolor=colour, linewidth=1.5, linestyle=dashes))
    corners = [facade.uvw_from_site(mark.corners_site_m)[:, :2] for mark in all_marks]
    boxes = np.array([[*uv.min(axis=0), *uv.max(axis=0)] for uv in corners])
    # A 6.5 point label at 150 dpi with its frame: 18 px high, 9 px per character.
    sizes = np.array([[12 + 9.0 * len(mark.label), 18.0] for mark in all_marks])
    bounds = np.array([axes.get_xlim(), axes.get_ylim()]).T.ravel() * px_per_m
    centres = place_labels(boxes * px_per_m, sizes, bounds) / px_per_m
    for index, (mark, box, centre) in enumerate(zip(all_marks, boxes, centres, strict=True)):
        colour = get_class_colour(mark.defect_class)
        nearest = np.clip(centre, box[:2], box[2:])
        if np.linalg.norm((nearest - centre) * px_per_m / sizes[index]) > 0.75:
            axes.plot(*np.array([nearest, centre]).T, color="white", linewidth=2.0, solid_capstyle="butt", zorder=3)
            axes.plot(*np.array([nearest, centre]).T, color=colour, linewidth=0.8, zorder=3.1)
        text_colour, fill, edge = ("white", colour, "white") if index < len(marks) else (colour, "white", colour)
        axes.text(
            centre[0], centre[1], mark.label, fontsize=6.5, color=text_colour, ha="center", va="center_baseline",
            zorder=4,
            bbox={"boxstyle": "round,pad=0.18", "facecolor": fill, "edgecolor": edge, "linewidth": 0.6},
        )  # fmt: skip


def _draw_deviations(
    figure: Figure, axes: Axes, facade: Facade, marks: Sequence[DefectMark],
    total_in: tuple[float, float], bars_in: float,
) -> None:  # fmt: skip
    """Draw a dot for each triangulated defect, coloured by its deviation from the model, with a colour bar."""
    measured = [(mark, mark.deviation_m) for mark in marks if mark.deviation_m is not None]
    if not measured:
        return
    uv = facade.uvw_from_site(np.array([mark.centre_site_m for mark, _ in measured]))[:, :2]
    millimetres = np.array([1000.0 * deviation for _, deviation in measured])
    limit_mm = next((n for n in (10, 20, 50, 100, 200, 500) if n >= np.abs(millimetres).max()), 1000)
    dots = axes.scatter(
        uv[:, 0], uv[:, 1], c=millimetres, cmap="PuOr", vmin=-limit_mm, vmax=limit_mm, s=16, edgecolors="black",
        linewidths=0.5, zorder=3.5,
    )  # fmt: skip
    box = axes.get_position()
    width = 1.7 / total_in[0]
    # Centred below the axes, but left of the scale bar where the facade is narrow.
    centre = min((box.x0 + box.x1) / 2, box.x1 - max(box.width / 4, 0.4 / total_in[0]) - 1.35 / total_in[0])
    bar = figure.add_axes((centre - width / 2, bars_in / total_in[1], width, 0.07 / total_in[1]))
    figure.colorbar(dots, cax=bar, orientation="horizontal", ticks=[-limit_mm, 0, limit_mm])
    bar.tick_params(labelsize=7, length=2, pad=1)
    figure.text(
        centre,
        (bars_in + 0.1) / total_in[1],
        "dots: deviation from model, mm (+ outward)",
        fontsize=7,
        ha="center",
        va="bottom",
    )


def draw_scale_bar(figure: Figure, axes: Axes, width_m: float, total_in: tuple[float, float], bars_in: float) -> None:
    """Draw a scale bar below the axes, at most a quarter of the facade long.

    Args:
        figure: the sheet.
        axes: the facade.
        width_m: width of the facade, metres.
        total_in: size of the sheet, inches.
        bars_in: height of the bar above the lower edge of the sheet, inches.
    """
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
    figure: Figure,
    labels: ElevationLabels,
    facade: Facade,
    marks: Sequence[DefectMark],
    others: int,
    shares: tuple[float, float],
    cell_m: float,
    total_in: tuple[float, float],
) -> None:
    left, height = 0.2 / total_in[0], total_in[1]
    covered, hidden = shares
    seen = f"photographs cover {100 * covered:.0f} %"
    if hidden >= 0.001:
        seen += f", {100 * hidden:.1f} % hidden (hatched)"
    title = f"{escape_mathtext(labels.building_name)} — {facade.title} (azimuth {facade.azimuth_deg:.0f}°)"
    figure.text(left, 1 - 0.18 / height, title, fontsize=12, weight="bold", va="top")
    count = "no defects" if not marks else f"{len(marks)} defect{'s' if len(marks) != 1 else ''}"
    subtitle = figure.text(
        left, 1 - 0.47 / height,
        escape_mathtext(
            f"campaign {labels.campaign_id} · georeferenced by {labels.control} · {count} · "
            f"resolution {1000 * cell_m:.0f} mm · {seen}"
        ),
        fontsize=8.5, va="top", color="#303030",
    )  # fmt: skip
    available_px = figure.bbox.width * (1 - 2 * left)
    subtitle.set_fontsize(8.5 * min(1.0, available_px / subtitle.get_window_extent().width))
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
        note = f"hollow label: defect of another facade ({others})"
        figure.text(left, 0.12 / height, note, fontsize=8, va="bottom", color="#303030")
    if handles:
        corner = (left, (0.32 if others else 0.12) / height)
        figure.legend(
            handles=handles, loc="lower left", bbox_to_anchor=corner, ncols=len(handles), fontsize=8,
            frameon=False, handlelength=2.2, columnspacing=1.4, borderaxespad=0.0,
        )  # fmt: skip
