"""The coverage layer of an elevation: how small a crack would have been found, and what was not imaged and why."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import matplotlib as mpl
import numpy as np
import pyarrow as pa
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import BoundaryNorm, Colormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from facadelake.core.arrays import BoolArray, Float64Array, Float64N, UInt8Image
from facadelake.publish import COLOUR_MAP, NOT_IMAGED_FILLS, NOT_SEARCHED_FILL, choose_limits_mm
from facadelake.reporting.drawing.palette import escape_mathtext
from facadelake.reporting.elevations.facades import Facade
from facadelake.reporting.elevations.figure import DPI, ElevationLabels, draw_scale_bar, draw_storey_lines
from schemas.vocabulary import CoverageOutcome

_MAX_WIDTH_PX, _MAX_HEIGHT_PX, _MIN_WIDTH_PX = 2000, 1500, 900
_LEFT_IN, _RIGHT_IN, _TOP_IN, _BOTTOM_IN = 0.75, 1.35, 0.8, 1.05
_BAR_IN = 0.42
_OPACITY = 0.6


@dataclass(frozen=True, kw_only=True, eq=False)
class FacadeCoverage:
    """The cells of table ``coverage`` in one view of a facade: corners (n, 4, 2) in u, v, outcome, value in mm.

    ``value_mm``: the smallest crack width found, or where ``is_crack_width`` is false, because it is unknown in the
    campaign, the longest side of a pixel on the surface; NaN where not imaged.
    """

    corners_uv_m: Float64Array
    outcome: np.ndarray
    searched: BoolArray
    value_mm: Float64N
    is_crack_width: bool

    def __len__(self) -> int:
        return len(self.outcome)


def select_coverage(coverage: pa.Table, facade: Facade) -> FacadeCoverage:
    """The cells of one view of a facade from table ``coverage`` of a campaign."""
    own = coverage.filter(pa.array([code == facade.code for code in coverage.column("facade").to_pylist()], pa.bool_()))
    xyz = np.column_stack([own.column(name).to_numpy() for name in ("x_site_m", "y_site_m", "z_site_m")])
    w = facade.uvw_from_site(xyz)[:, 2]
    own = own.filter(pa.array((w >= facade.far_w_m - 1e-3) & (w <= facade.near_w_m)))
    u_min, u_max, v_min, v_max = (own.column(name).to_numpy() for name in ("u_min_m", "u_max_m", "v_min_m", "v_max_m"))
    found = own.column("found_crack_width_mm").to_numpy()
    is_crack_width = bool(coverage.column("found_crack_width_mm").null_count < len(coverage))
    cosine = np.cos(np.radians(own.column("incidence_deg").to_numpy()))
    return FacadeCoverage(
        corners_uv_m=np.stack(
            [np.column_stack(corner) for corner in ((u_min, v_min), (u_max, v_min), (u_max, v_max), (u_min, v_max))],
            axis=1,
        ),
        outcome=np.array(own.column("coverage_outcome").to_pylist(), dtype=np.str_),
        searched=own.column("searched_count").to_numpy() > 0,
        value_mm=found if is_crack_width else own.column("gsd_mm").to_numpy() / cosine,
        is_crack_width=is_crack_width,
    )


def draw_coverage(
    labels: ElevationLabels, facade: Facade, background: UInt8Image, cell_m: float, cells: FacadeCoverage
) -> Figure:
    """Draw the sheet of an elevation's coverage.

    Args:
        labels: title and storey levels.
        facade: the facade.
        background: picture (rows, columns, RGB) of the elevation, one pixel per ``cell_m``.
        cell_m: size of a pixel of the background, metres.
        cells: the cells of coverage.
    """
    rows, columns = background.shape[:2]
    scale = min(_MAX_WIDTH_PX / columns, _MAX_HEIGHT_PX / rows, 1.0)
    width_in, height_in = columns * scale / DPI, rows * scale / DPI
    spare_in = max(0.0, _MIN_WIDTH_PX / DPI - width_in)
    total_in = (_LEFT_IN + width_in + spare_in + _RIGHT_IN, _TOP_IN + height_in + _BOTTOM_IN)
    figure = Figure(figsize=total_in, dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    left_in = _LEFT_IN + spare_in / 2
    axes = figure.add_axes(
        (left_in / total_in[0], _BOTTOM_IN / total_in[1], width_in / total_in[0], height_in / total_in[1])
    )
    left_m, right_m = facade.u_min_m, facade.u_min_m + columns * cell_m
    low_m, high_m = facade.v_max_m - rows * cell_m, facade.v_max_m
    size = (max(1, round(columns * scale)), max(1, round(rows * scale)))
    grey = cv2.cvtColor(cv2.resize(background, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY)
    pale = (128 + grey.astype(np.uint16) // 2).astype(np.uint8)
    axes.imshow(pale, extent=(left_m, right_m, low_m, high_m), cmap="gray", vmin=0, vmax=255, aspect="auto")
    axes.set_xlim(left_m, right_m)
    axes.set_ylim(low_m, high_m)
    axes.tick_params(labelsize=8)
    axes.set_xlabel("u (m): to the right as seen from outside, from the site's origin", fontsize=8)
    axes.set_ylabel("v (m): up, from the site's origin", fontsize=8)
    imaged = cells.outcome == str(CoverageOutcome.IMAGED)
    valued = imaged & np.isfinite(cells.value_mm)
    handles: list[Patch] = []
    if valued.any():
        norm, colours = _choose_scale(cells.value_mm[valued])
        axes.add_collection(
            PolyCollection(cells.corners_uv_m[valued], facecolors=colours(norm(cells.value_mm[valued])), alpha=_OPACITY)
        )
        bar = figure.add_axes((0.3 / total_in[0], _BAR_IN / total_in[1], 2.2 / total_in[0], 0.08 / total_in[1]))
        figure.colorbar(ScalarMappable(norm, colours), cax=bar, orientation="horizontal", alpha=_OPACITY)
        bar.tick_params(labelsize=7, length=2, pad=1)
        meaning = "smallest crack found (90 %), mm" if cells.is_crack_width else "pixel on the surface, mm"
        figure.text(0.3 / total_in[0], (_BAR_IN + 0.11) / total_in[1], meaning, fontsize=7, va="bottom")
    kinds = [(cells.outcome == str(word), fill) for word, fill in NOT_IMAGED_FILLS.items()]
    kinds.append((imaged & ~cells.searched, NOT_SEARCHED_FILL))
    with mpl.rc_context({"hatch.linewidth": 0.6}):
        for of_kind, fill in kinds:
            if of_kind.any():
                face = "none" if fill is NOT_SEARCHED_FILL else fill.colour
                axes.add_collection(
                    PolyCollection(
                        cells.corners_uv_m[of_kind], facecolors=face, edgecolors="white", linewidths=0.0,
                        hatch=fill.hatch, alpha=0.85,
                    )
                )  # fmt: skip
                handles.append(Patch(facecolor=fill.colour, edgecolor="black", hatch=fill.hatch, label=fill.meaning))
        draw_storey_lines(axes, labels)
        draw_scale_bar(figure, axes, right_m - left_m, total_in, _BAR_IN)
        _write_title(figure, labels, facade, handles, total_in)
        figure.draw_without_rendering()
    return figure


def _choose_scale(value_mm: Float64N) -> tuple[BoundaryNorm, Colormap]:
    """Classes of round millimetres that contain nearly all values; small, which is good, is light."""
    bounds = choose_limits_mm(value_mm)
    colours = mpl.colormaps[f"{COLOUR_MAP}_r"].resampled(max(2, len(bounds) - 1))
    return BoundaryNorm(bounds.tolist(), colours.N, clip=True), colours


def _write_title(
    figure: Figure, labels: ElevationLabels, facade: Facade, handles: list[Patch], total_in: tuple[float, float]
) -> None:
    left, height = 0.2 / total_in[0], total_in[1]
    title = f"{escape_mathtext(labels.building_name)} — {facade.title}: coverage"
    figure.text(left, 1 - 0.18 / height, title, fontsize=12, weight="bold", va="top")
    subtitle = escape_mathtext(f"campaign {labels.campaign_id} · cells of 0.25 m · dark: coarse")
    figure.text(left, 1 - 0.47 / height, subtitle, fontsize=8.5, va="top", color="#303030")
    if handles:
        figure.legend(
            handles=handles, loc="lower left", bbox_to_anchor=(left, 0.0), ncols=len(handles), fontsize=7.5,
            frameon=False, handlelength=2.2, columnspacing=1.2, borderaxespad=0.3,
        )  # fmt: skip
