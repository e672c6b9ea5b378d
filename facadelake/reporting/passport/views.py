"""The passport's views: model, cameras with confidence ellipses, and points with residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection

from facadelake.core.arrays import Float64Array, Float64Nx2, Float64Nx3, Float64Nx3x3, Float64x3
from facadelake.core.geodesy import SITE_AXES
from facadelake.reporting.drawing.palette import POINT_STYLES
from facadelake.reporting.inspection import Inspection
from facadelake.reporting.plan import draw_model
from schemas.vocabulary import PointKind

# 95 % quantile of chi-square with 2 degrees of freedom: squared half axes of a confidence ellipse in sigmas.
_CHI_SQUARE_95 = 5.991
_MARGIN_M = 3.0
_CAMERA_COLOUR = "#202020"
EAST, NORTH, UP = np.eye(3)


@dataclass(frozen=True, kw_only=True, eq=False)
class PassportGeometry:
    """Cameras and points of a passport in site.

    ``covariance_m2`` is NaN for cameras without covariance. ``points``: kind, given positions (k, 3) and residuals
    (k, 3), given minus adjusted.
    """

    centres_m: Float64Nx3
    covariance_m2: Float64Nx3x3
    points: tuple[tuple[str, Float64Nx3, Float64Nx3], ...]

    @property
    def surveyed(self) -> tuple[tuple[str, Float64Nx3, Float64Nx3], ...]:
        """The surveyed points: all kinds except GPS positions."""
        return tuple(group for group in self.points if group[0] != PointKind.GPS)


def collect_geometry(inspection: Inspection) -> PassportGeometry:
    """Cameras and points of a campaign's passport."""
    rows = [row for row in inspection.poses.to_pylist() if row["photo_id"] in inspection.posed]
    missing = [np.nan] * 36
    covariance = np.array([row["covariance"] or missing for row in rows], dtype=np.float64).reshape(-1, 6, 6)
    points = inspection.georeference_points.to_pylist()
    groups = []
    for kind in PointKind:
        of_kind = [row for row in points if row["point_kind"] == kind]
        if of_kind:
            groups.append(
                (
                    str(kind),
                    _collect_columns(of_kind, "{}_site_m", "xyz"),
                    _collect_columns(of_kind, "residual_{}_m", SITE_AXES),
                )
            )
    return PassportGeometry(
        centres_m=_collect_columns(rows, "{}_site_m", "xyz"), covariance_m2=covariance[:, :3, :3], points=tuple(groups)
    )


def _collect_columns(rows: Sequence[dict[str, Any]], name: str, parts: Sequence[str]) -> Float64Nx3:
    """Three columns as points; their names are ``name`` with each of ``parts``."""
    return np.array([[row[name.format(part)] for part in parts] for row in rows], dtype=np.float64).reshape(-1, 3)


@dataclass(frozen=True, kw_only=True)
class DrawingScales:
    """Factors by which ellipses and residuals are enlarged relative to the plan; below 1: reduced."""

    ellipses: float
    residuals: float


def choose_scales(geometry: PassportGeometry, extent_m: float) -> DrawingScales:
    """Round factors that draw a typical ellipse and residual at a few hundredths of the view."""
    covariance = geometry.covariance_m2[np.isfinite(geometry.covariance_m2).all(axis=(1, 2))]
    # The middle axis: with GPS the heights are ten times less accurate than the other axes.
    sigma = float(np.sqrt(np.median(np.linalg.eigvalsh(covariance)[:, 1]))) if len(covariance) else np.nan
    lengths = [np.linalg.norm(residual, axis=1) for _, _, residual in geometry.surveyed]
    residual = float(np.percentile(np.concatenate(lengths), 75)) if lengths else np.nan
    return DrawingScales(
        ellipses=_round_factor(0.02 * extent_m, float(np.sqrt(_CHI_SQUARE_95)) * sigma),
        residuals=_round_factor(0.05 * extent_m, residual),
    )


def _round_factor(target_m: float, length_m: float) -> float:
    """The largest of ..., 0.5, 1, 2, 5, ... by which ``length_m`` stays within ``target_m``; 1 for no length."""
    if not length_m > 0:
        return 1.0
    exact = min(target_m / length_m, 1e6)
    power = 10.0 ** np.floor(np.log10(exact))
    return float(max(step for step in (1, 2, 5) if step * power <= exact) * power)


def compute_extent(inspection: Inspection, geometry: PassportGeometry) -> tuple[Float64x3, Float64x3]:
    """Lower and upper corner in site of model, cameras and surveyed points, with a margin."""
    given = [positions for _, positions, _ in geometry.surveyed]
    points = np.vstack([inspection.building.vertices_site_m, geometry.centres_m, *given])
    return points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M


def draw_view(
    axes: Axes,
    inspection: Inspection,
    geometry: PassportGeometry,
    up: Float64x3,
    corners: tuple[Float64x3, Float64x3],
    scales: DrawingScales,
) -> None:
    """Draw one view with east to the right.

    Args:
        axes: axes to draw into; metres.
        inspection: the campaign.
        geometry: its cameras and points.
        up: unit vector in site that points up in the view.
        corners: lower and upper corner of the view in site.
        scales: factors of ellipses and residuals.
    """
    view = np.column_stack([EAST, up])
    draw_model(axes, inspection.building, EAST, up)
    centres = geometry.centres_m @ view
    for kind, given, residual in geometry.points:
        colour, marker = POINT_STYLES[kind]
        start, end = given @ view, (given - residual) @ view
        if kind == PointKind.GPS:
            axes.add_collection(LineCollection(list(np.stack([start, end], axis=1)), colors=colour, linewidths=0.7))
            axes.plot(*start.T, marker, color=colour, markersize=3, linestyle="none", zorder=3)
            continue
        arrow = (end - start) * scales.residuals
        axes.quiver(
            *start.T, *arrow.T, angles="xy", scale_units="xy", scale=1, color=colour, width=0.0035, headwidth=4,
            headlength=5, headaxislength=4.5, zorder=6,
        )  # fmt: skip
        if kind != PointKind.HELD_OUT:  # drawn as control points already
            axes.plot(
                *start.T, marker, color=colour, markersize=6.5, markeredgecolor="white", linestyle="none", zorder=5
            )
    _draw_ellipses(axes, centres, np.einsum("ia,nij,jb->nab", view, geometry.covariance_m2, view), scales.ellipses)
    axes.plot(*centres.T, "o", color=_CAMERA_COLOUR, markersize=2.2, linestyle="none", zorder=4)
    low, high = (corner @ view for corner in corners)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.tick_params(labelsize=8)
    axes.grid(color="#e4e4e4", linewidth=0.6)
    axes.set_axisbelow(True)


def _draw_ellipses(axes: Axes, centres: Float64Nx2, covariance_m2: Float64Array, factor: float) -> None:
    """Draw the 95 % confidence ellipses of points from their covariances (n, 2, 2) in the view."""
    is_finite = np.isfinite(covariance_m2).all(axis=(1, 2))
    if not is_finite.any():
        return
    variance, direction = np.linalg.eigh(covariance_m2[is_finite])
    half = factor * np.sqrt(_CHI_SQUARE_95 * np.clip(variance, 0.0, None))
    axes.add_collection(
        EllipseCollection(
            2 * half[:, 1], 2 * half[:, 0], np.degrees(np.arctan2(direction[:, 1, 1], direction[:, 0, 1])),
            units="xy", offsets=centres[is_finite], offset_transform=axes.transData, facecolors="#56b4e955",
            edgecolors="#0072b2", linewidths=0.7, zorder=3.5,
        )
    )  # fmt: skip
