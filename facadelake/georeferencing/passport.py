"""The points of a campaign's passport: control points, check points and GPS positions with their residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import shapely

from facadelake.core.arrays import Float64x3
from facadelake.core.geodesy import SITE_AXES, SiteOrigin
from facadelake.core.tables import table_from_rows
from facadelake.georeferencing.adjustment.adjusted_block import AdjustedBlock, compute_held_out_residuals
from facadelake.georeferencing.gps.priors import GpsPriors
from facadelake.georeferencing.initial_placement import InitialPlacement
from facadelake.sfm import Reconstruction
from schemas.vocabulary import PointKind


@dataclass(frozen=True, kw_only=True, eq=False)
class PassportPoint:
    """A point of the passport: given coordinates (3,) and residual ``given - adjusted`` (3,), metres in site."""

    name: str
    kind: PointKind
    xyz_site_m: Float64x3
    residual_site_m: Float64x3
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
                **{f"residual_{axis}_m": float(r) for axis, r in zip(SITE_AXES, point.residual_site_m, strict=True)},
                "point_used": point.used,
                "geometry": shapely.to_wkb(shapely.Point(lon, lat, height), output_dimension=3, flavor="iso"),
            }
        )
    return table_from_rows("georeference_points", rows)


def build_control_points(placement: InitialPlacement, adjusted: AdjustedBlock) -> list[PassportPoint]:
    """Control points as adjusted, the same as if each had been left out, and check points."""
    marked = placement.marked
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
    reconstruction: Reconstruction, priors: GpsPriors, adjusted: AdjustedBlock, placement: InitialPlacement
) -> list[PassportPoint]:
    """GPS priors against the adjusted camera centres.

    Args:
        reconstruction: the block, for the photographs' names.
        priors: the GPS priors.
        adjusted: the adjusted block.
        placement: its initial placement, for the priors that took part.

    Returns:
        one point for each prior.
    """
    cameras = adjusted.cameras
    return [
        PassportPoint(
            name=reconstruction.photos[photo].photo_id,
            kind=PointKind.GPS,
            xyz_site_m=xyz,
            residual_site_m=xyz - cameras[photo].centre_site_m,
            used=bool(used),
        )
        for photo, xyz, used in zip(priors.photo, priors.xyz_site_m, placement.gps_used, strict=True)
    ]
