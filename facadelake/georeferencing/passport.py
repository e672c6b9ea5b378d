"""The passport of a placed campaign: its row, its points, and whether it is good enough to commit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import shapely

from facadelake.core.arrays import Float64Array
from facadelake.core.errors import GeoreferenceError
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import table_from_rows
from facadelake.georeferencing.adjustment.adjusted_block import AdjustedBlock, compute_held_out_residuals
from facadelake.georeferencing.adjustment.point_to_plane import RaySurface, match_points_to_surface
from facadelake.georeferencing.gps.priors import GpsPriors
from facadelake.georeferencing.initial_placement import InitialPlacement
from facadelake.sfm import Reconstruction
from schemas.vocabulary import ControlKind, PointKind

_MODEL_GATE_M = 0.5
_MIN_POINTS_FOR_DOMING = 200
# How far control points may lie (median) from a block placed by an earlier campaign, in its own sigmas and at least.
_MAX_FRAME_SIGMAS, _MIN_FRAME_TOLERANCE_M = 3.0, 0.05
_AXES = ("east", "north", "up")


@dataclass(frozen=True, kw_only=True, eq=False)
class PassportPoint:
    """A point that the passport rests on: where it was given, and ``given - adjusted`` (3,), metres in site."""

    name: str
    kind: PointKind
    xyz_site_m: Float64Array
    residual_site_m: Float64Array
    used: bool


def build_points_table(points: Sequence[PassportPoint], origin: SiteOrigin) -> pa.Table:
    """Table ``georeference_points``."""
    if not points:
        return table_from_rows("georeference_points", [])
    geo = origin.geo_from_site(np.array([point.xyz_site_m for point in points]))
    rows: list[dict[str, Any]] = []
    for point, (lon, lat, height) in zip(points, geo.tolist(), strict=True):
        x, y, z = point.xyz_site_m.tolist()
        rows.append(
            {
                "point_name": point.name,
                "point_kind": point.kind,
                "x_site_m": x,
                "y_site_m": y,
                "z_site_m": z,
                "lon_deg": lon,
                "lat_deg": lat,
                "height_ellipsoidal_m": height,
                **{f"residual_{axis}_m": float(left) for axis, left in zip(_AXES, point.residual_site_m, strict=True)},
                "point_used": point.used,
                "geometry": shapely.to_wkb(shapely.Point(lon, lat, height), output_dimension=3, flavor="iso"),
            }
        )
    return table_from_rows("georeference_points", rows)


@dataclass(frozen=True, kw_only=True)
class ModelComparison:
    """How the block lies on the model: the median distance of tie points from the faces they were seen on, and the
    sagitta of a common curvature with its sigma (NaN where too few points lie on walls)."""

    residual_m: float
    doming_m: float
    doming_sigma_m: float


def compare_with_model(adjusted: AdjustedBlock, surface: RaySurface) -> ModelComparison | None:
    """The test of the block against the model; None where its tie points do not meet the model.

    Doming: ``away = a + b u + c (u^2 - mean)`` along each wall's horizontal u, with one curvature c for all walls; the
    sagitta is c times the square of half the longest wall. Independent of the model only where the model did not hold
    the block.
    """
    state = adjusted.solution.state
    walls = match_points_to_surface(adjusted.tie_points, state, surface, gate_m=_MODEL_GATE_M, model_sigma_m=1.0)
    if not len(walls.point):
        return None
    xyz = state.xyz_site_m[walls.point]
    away = np.einsum("ij,ij->i", walls.normal_site, xyz) - walls.distance_m
    rows, left, longest = [], [], 0.0
    for wall in range(len(walls.wall_sigma_m)):
        own = walls.wall == wall
        normal = walls.normal_site[own].mean(axis=0)
        if np.hypot(normal[0], normal[1]) < 0.5:
            continue  # floors and roofs have no horizontal run
        along = np.array([-normal[1], normal[0], 0.0]) / np.hypot(normal[0], normal[1])
        u = xyz[own] @ along
        u = u - u.mean()
        plane = np.column_stack([np.ones(len(u)), u])
        bent = u**2 - (u**2).mean()
        # What offset and tilt of the wall explain is taken out of both sides.
        taken = np.linalg.lstsq(plane, np.column_stack([bent, away[own]]), rcond=None)[0]
        rows.append(bent - plane @ taken[:, 0])
        left.append(away[own] - plane @ taken[:, 1])
        longest = max(longest, float(np.ptp(u)))
    doming, sigma = np.nan, np.nan
    if rows and sum(map(len, rows)) >= _MIN_POINTS_FOR_DOMING:
        bends, aways = np.concatenate(rows), np.concatenate(left)
        core = np.abs(aways) < 3 * 1.4826 * np.median(np.abs(aways))
        bends, aways = bends[core], aways[core]
        curvature = float(bends @ aways / (bends @ bends))
        spread = float(np.std(aways - curvature * bends) / np.sqrt(bends @ bends))
        half = (longest / 2) ** 2
        doming, sigma = curvature * half, spread * half * float(np.sqrt(adjusted.tie_variance_factor))
    return ModelComparison(residual_m=float(np.median(np.abs(away))), doming_m=doming, doming_sigma_m=sigma)


def require_accuracy(
    *, control: ControlKind, sigma_m: Float64Array, limit_m: float, held_out_m: Float64Array, remedy: str
) -> None:
    """Refuse a placement that is not known to ``limit_m``: by its own sigma (3,), or at held-out points (k,).

    Raises GeoreferenceError: the campaign commits nothing.
    """
    worst = float(np.max(sigma_m))
    if worst > limit_m:
        axis = _AXES[int(np.argmax(sigma_m))]
        raise GeoreferenceError(
            f"placed by {control}, the campaign's position is known to {worst:.2f} m {axis} (one sigma), the limit is "
            f"{limit_m:g} m (tolerances.placement_sigma_max_m); {remedy}"
        )
    if len(held_out_m) and float(np.median(held_out_m)) > 3 * limit_m:
        raise GeoreferenceError(
            f"placed by {control}, held-out points lie {np.median(held_out_m):.2f} m (median) from where they were "
            f"surveyed, the limit is {3 * limit_m:g} m (three times tolerances.placement_sigma_max_m); check the "
            "coordinates, CRS and marks of the control points"
        )


def require_consistent_frame(held_out_m: Float64Array, sigma_m: float, words: str) -> None:
    """Control points must lie where a block that was placed by an earlier campaign has them."""
    limit_m = max(_MAX_FRAME_SIGMAS * sigma_m, _MIN_FRAME_TOLERANCE_M)
    if float(np.median(held_out_m)) > limit_m:
        raise GeoreferenceError(
            f"placed by {words}, control points lie {np.median(held_out_m):.2f} m off (median, limit {limit_m:.2f} m): "
            "the two campaigns' control does not agree; check both files of control points"
        )


def build_control_points(start: InitialPlacement, adjusted: AdjustedBlock) -> list[PassportPoint]:
    """Control points as fitted, the same left out in turn, and check points."""
    marked = start.marked
    if marked is None:
        return []
    points = [
        PassportPoint(
            name=name,
            kind=PointKind.CONTROL if np.isfinite(sigma).all() else PointKind.CHECK,
            xyz_site_m=given,
            residual_site_m=given - found,
            used=bool(np.isfinite(sigma).all()),
        )
        for name, given, found, sigma in zip(
            marked.names, marked.xyz_site_m, adjusted.marked_xyz_site_m, marked.sigma_m, strict=True
        )
    ]
    for row, residual in compute_held_out_residuals(adjusted, marked).items():
        points.append(
            PassportPoint(
                name=marked.names[row],
                kind=PointKind.HELD_OUT,
                xyz_site_m=marked.xyz_site_m[row],
                residual_site_m=residual,
                used=False,
            )
        )
    return points


def build_gps_points(
    reconstruction: Reconstruction, priors: GpsPriors, adjusted: AdjustedBlock, start: InitialPlacement
) -> list[PassportPoint]:
    cameras = adjusted.cameras
    return [
        PassportPoint(
            name=reconstruction.photos[photo].photo_id,
            kind=PointKind.GPS,
            xyz_site_m=xyz,
            residual_site_m=xyz - cameras[photo].centre_site_m,
            used=bool(used),
        )
        for photo, xyz, used in zip(priors.photo, priors.xyz_site_m, start.gps_used, strict=True)
    ]
