"""The campaign from above: the building model, the cameras with their viewing directions, and the defects."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from facadelake.building import BuildingModel
from facadelake.core.arrays import Float64Array, Float64x3
from facadelake.reporting.drawing.palette import escape_mathtext, get_class_colour
from facadelake.reporting.inspection import Inspection
from schemas.vocabulary import PhotoOutcome

_DPI = 150
_WIDTH_IN = 9.0
_MARGIN_M = 4.0


def draw_plan(inspection: Inspection, path: Path) -> Path:
    """Write the plan as a PNG: metres east and north of the site's origin, north up; returns ``path``."""
    figure = Figure(figsize=(_WIDTH_IN, _WIDTH_IN), dpi=_DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    low, high = draw_model(axes, inspection.building, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    centres = np.array([posed.centre_site_m[:2] for posed in inspection.posed.values()]).reshape(-1, 2)
    low, high = np.vstack([low, centres]).min(axis=0), np.vstack([high, centres]).max(axis=0)
    low, high = low - _MARGIN_M, high + _MARGIN_M
    _draw_cameras(axes, inspection, float(np.max(high - low)))
    _draw_unlocalised(axes, inspection, low, high)
    _draw_defects(axes, inspection)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    height_to_width = (high - low)[1] / (high - low)[0]
    figure.set_size_inches(_WIDTH_IN, float(np.clip(_WIDTH_IN * height_to_width * 0.95 + 1.2, 4.0, 14.0)))
    axes.set_xlabel("east (m)", fontsize=8)
    axes.set_ylabel("north (m)", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.grid(color="#e4e4e4", linewidth=0.6)
    axes.set_axisbelow(True)
    title = f"{inspection.building_name}, {inspection.campaign_id}: plan, north up"
    axes.set_title(escape_mathtext(title), fontsize=11, weight="bold", loc="left")
    figure.legend(loc="outside lower left", fontsize=8, frameon=False, ncols=4)
    figure.savefig(path, dpi=_DPI)
    return path


def _draw_cameras(axes: Axes, inspection: Inspection, extent_m: float) -> None:
    """Draw the localised cameras with arrows: the horizontal component of their viewing directions."""
    roles = dict(
        zip(inspection.photos.column("photo_id").to_pylist(), inspection.photos.column("role").to_pylist(), strict=True)
    )
    groups: dict[str, list[tuple[float, float, float, float]]] = {}
    for photo_id, posed in inspection.posed.items():
        forward = posed.site_from_cam.rotation[:, 2]
        groups.setdefault(roles.get(photo_id) or "no role", []).append((*posed.centre_site_m[:2], *forward[:2]))
    length = 0.035 * extent_m
    for role, colour in (("multiview", "#202020"), ("closerange", "#8a5a00"), ("no role", "#606060")):
        rows = np.array(groups.get(role, [])).reshape(-1, 4)
        if len(rows):
            x, y, dx, dy = rows.T
            axes.quiver(
                x, y, dx * length, dy * length, angles="xy", scale_units="xy", scale=1, color=colour, width=0.0022,
                headwidth=5, headlength=6, headaxislength=5, zorder=3,
            )  # fmt: skip
            label = f"camera, {role} ({len(rows)})"
            axes.plot(x, y, "o", color=colour, markersize=3.2, zorder=3, label=label, linestyle="none")


def _draw_unlocalised(axes: Axes, inspection: Inspection, low: Float64Array, high: Float64Array) -> None:
    """Draw crosses at the GPS positions of photographs that were not localised."""
    unlocalised = [
        row
        for row in inspection.photos.to_pylist()
        if row["photo_outcome"] == PhotoOutcome.ACCEPTED and row["photo_id"] not in inspection.posed
    ]
    if not unlocalised:
        return
    origin = inspection.building.origin
    with_position = [
        row for row in unlocalised if row["prior_lon_deg"] is not None and row["prior_lat_deg"] is not None
    ]
    geo = [[row["prior_lon_deg"], row["prior_lat_deg"], origin.height_ellipsoidal_m] for row in with_position]
    site = origin.site_from_geo(np.array(geo).reshape(-1, 3))[:, :2]
    inside = ((site >= low) & (site <= high)).all(axis=1)
    outside = len(unlocalised) - int(inside.sum())
    not_shown = f", {outside} not shown" if outside else ""
    label = f"photograph not localised ({len(unlocalised)}{not_shown})"
    axes.plot(*site[inside].T, "x", color="#b00020", markersize=7, label=label, linestyle="none", zorder=4)


def _draw_defects(axes: Axes, inspection: Inspection) -> None:
    counts = Counter(inspection.defects.column("defect_class").to_pylist())
    classes = np.array(inspection.defects.column("defect_class").to_pylist(), dtype=object)
    x = np.array(inspection.defects.column("x_site_m").to_pylist(), dtype=np.float64)
    y = np.array(inspection.defects.column("y_site_m").to_pylist(), dtype=np.float64)
    for (defect_class, count), marker in zip(sorted(counts.items()), "os^Dv*", strict=False):
        own = classes == defect_class
        axes.plot(
            x[own], y[own], marker, color=get_class_colour(defect_class), markersize=4.5, markeredgecolor="white",
            markeredgewidth=0.4, label=f"{defect_class} ({count})", linestyle="none", zorder=5,
        )  # fmt: skip


def draw_model(
    axes: Axes, building: BuildingModel, right: Float64x3, up: Float64x3
) -> tuple[Float64Array, Float64Array]:
    """Draw an orthographic view of the model's triangles, shaded by depth, the nearest last.

    Args:
        axes: axes to draw into; metres.
        building: building model.
        right: unit vector in site that points to the right in the view.
        up: unit vector in site that points up in the view.

    Returns:
        Lower left and upper right corner (2,) of the model in the view, metres.
    """
    corners = building.vertices_site_m[building.triangles]
    flat, near = corners @ np.column_stack([right, up]), corners @ np.cross(right, up)
    is_area = np.abs(shapely.area(shapely.polygons(flat))) > 1e-4
    order = np.argsort(near[is_area].max(axis=1))
    depth = near[is_area].max(axis=1)[order]
    share = (depth - depth.min()) / max(float(np.ptp(depth)), 1e-6) if len(depth) else depth
    shade = 0.90 - 0.18 * share
    axes.add_collection(
        PolyCollection(flat[is_area][order], facecolors=np.column_stack([shade] * 3), edgecolors="face", linewidths=0.3)
    )
    return flat.reshape(-1, 2).min(axis=0), flat.reshape(-1, 2).max(axis=0)
