"""The passport's two views: from above and from the south, with what is known of each camera and point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection

from facadelake.core.arrays import Float64Array
from facadelake.reporting.drawing.palette import POINT_STYLES
from facadelake.reporting.inspection import Inspection
from facadelake.reporting.passport.facts import AXES
from facadelake.reporting.plan import draw_model
from schemas.vocabulary import PointKind

# Chi-square with 2 degrees of freedom: 95 % of the errors across a view lie inside an ellipse of this size.
_CHI_SQUARE_95 = 5.991
_MARGIN_M = 3.0
_CAMERA_COLOUR = "#202020"
EAST, NORTH, UP = np.eye(3)


@dataclass(frozen=True, kw_only=True, eq=False)
class PassportGeometry:
    """Cameras, and points of the passport by kind, in site: what a view shows.

    ``covariance_m2`` (n, 3, 3) is NaN for a camera that states none. ``points``: (kind, given (k, 3), residual (k, 3)),
    residuals are given minus adjusted.
    """

    centres_m: Float64Array
    covariance_m2: Float64Array
    points: tuple[tuple[str, Float64Array, Float64Array], ...]

    @property
    def surveyed(self) -> tuple[tuple[str, Float64Array, Float64Array], ...]:
        """The points on the ground: all but GPS."""
        return tuple(group for group in self.points if group[0] != PointKind.GPS)


def collect_geometry(inspection: Inspection) -> PassportGeometry:
    """What the passport of an inspection shows."""
    rows = [row for row in inspection.poses.to_pylist() if row["photo_id"] in inspection.posed]
    unknown = [np.nan] * 36
    covariance = np.array([row["covariance"] or unknown for row in rows], dtype=np.float64).reshape(-1, 6, 6)
    points = inspection.georeference_points.to_pylist()
    groups = []
    for kind in PointKind:
        mine = [row for row in points if row["point_kind"] == kind]
        if mine:
            groups.append(
                (str(kind), _stack_columns(mine, "{}_site_m", "xyz"), _stack_columns(mine, "residual_{}_m", AXES))
            )
    return PassportGeometry(
        centres_m=_stack_columns(rows, "{}_site_m", "xyz"), covariance_m2=covariance[:, :3, :3], points=tuple(groups)
    )


def _stack_columns(rows: Sequence[dict[str, Any]], name: str, words: Sequence[str]) -> Float64Array:
    return np.array([[row[name.format(word)] for word in words] for row in rows], dtype=np.float64).reshape(-1, 3)


@dataclass(frozen=True, kw_only=True)
class DrawingScales:
    """How many times larger than the plan ellipses and residuals are drawn; metres are drawn smaller."""

    ellipses: float
    residuals: float


def choose_scales(place: PassportGeometry, extent_m: float) -> DrawingScales:
    """Round factors that draw a middling ellipse and residual at a few hundredths of the view."""
    stated = place.covariance_m2[np.isfinite(place.covariance_m2).all(axis=(1, 2))]
    # The middle axis: GPS knows heights ten times worse than the rest.
    sigma = float(np.sqrt(np.median(np.linalg.eigvalsh(stated)[:, 1]))) if len(stated) else np.nan
    lengths = [np.linalg.norm(residual, axis=1) for _, _, residual in place.surveyed]
    residual = float(np.percentile(np.concatenate(lengths), 75)) if lengths else np.nan
    return DrawingScales(
        ellipses=_round_factor(0.02 * extent_m, float(np.sqrt(_CHI_SQUARE_95)) * sigma),
        residuals=_round_factor(0.05 * extent_m, residual),
    )


def _round_factor(room_m: float, length_m: float) -> float:
    """The largest of ..., 0.5, 1, 2, 5, 10, ... by which ``length_m`` stays within ``room_m``; 1 for no length."""
    if not length_m > 0:
        return 1.0
    wanted = min(room_m / length_m, 1e6)
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(step for step in (1, 2, 5) if step * power <= wanted) * power)


def compute_extent(inspection: Inspection, place: PassportGeometry) -> tuple[Float64Array, Float64Array]:
    """Corners (3,) of what the views show: model, cameras and surveyed points, with a margin."""
    given = [points for _, points, _ in place.surveyed]
    everything = np.vstack([inspection.building.vertices_site_m, place.centres_m, *given])
    return everything.min(axis=0) - _MARGIN_M, everything.max(axis=0) + _MARGIN_M


def draw_view(
    axes: Axes,
    inspection: Inspection,
    place: PassportGeometry,
    up: Float64Array,
    corners: tuple[Float64Array, Float64Array],
    scales: DrawingScales,
) -> None:
    """One view with east to the right and ``up`` (3,) upwards."""
    view = np.column_stack([EAST, up])
    draw_model(axes, inspection.building, EAST, up)
    centres = place.centres_m @ view
    for kind, given, residual in place.points:
        colour, marker = POINT_STYLES[kind]
        at, found = given @ view, (given - residual) @ view
        if kind == PointKind.GPS:
            axes.add_collection(LineCollection(list(np.stack([at, found], axis=1)), colors=colour, linewidths=0.7))
            axes.plot(*at.T, marker, color=colour, markersize=3, linestyle="none", zorder=3)
            continue
        away = (found - at) * scales.residuals
        axes.quiver(
            *at.T, *away.T, angles="xy", scale_units="xy", scale=1, color=colour, width=0.0035, headwidth=4,
            headlength=5, headaxislength=4.5, zorder=6,
        )  # fmt: skip
        if kind != PointKind.HELD_OUT:  # they are control points, drawn already
            axes.plot(*at.T, marker, color=colour, markersize=6.5, markeredgecolor="white", linestyle="none", zorder=5)
    _draw_ellipses(axes, centres, np.einsum("ia,nij,jb->nab", view, place.covariance_m2, view), scales.ellipses)
    axes.plot(*centres.T, "o", color=_CAMERA_COLOUR, markersize=2.2, linestyle="none", zorder=4)
    low, high = (corner @ view for corner in corners)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.tick_params(labelsize=8)
    axes.grid(color="#e4e4e4", linewidth=0.6)
    axes.set_axisbelow(True)


def _draw_ellipses(axes: Axes, centres: Float64Array, covariance_m2: Float64Array, times: float) -> None:
    known = np.isfinite(covariance_m2).all(axis=(1, 2))
    if not known.any():
        return
    variance, direction = np.linalg.eigh(covariance_m2[known])
    half = times * np.sqrt(_CHI_SQUARE_95 * np.clip(variance, 0.0, None))
    axes.add_collection(
        EllipseCollection(
            2 * half[:, 1], 2 * half[:, 0], np.degrees(np.arctan2(direction[:, 1, 1], direction[:, 0, 1])),
            units="xy", offsets=centres[known], offset_transform=axes.transData, facecolors="#56b4e955",
            edgecolors="#0072b2", linewidths=0.7, zorder=3.5,
        )
    )  # fmt: skip
