"""Validation of imported poses: residuals at surveyed points marked in the photographs, and offsets from their GPS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from facadelake.core.arrays import Float64N, Float64Nx3, Float64x3, Int64Array
from facadelake.core.camera import PosedCamera
from facadelake.core.geodesy import SITE_AXES
from facadelake.georeferencing.datum_shift import site_from_crs
from facadelake.georeferencing.gcp.control_points import SurveyedPoints, transform_to_site
from facadelake.georeferencing.passport import PassportPoint
from facadelake.georeferencing.placement_checks import PlacementCheck
from facadelake.georeferencing.site_frame import SiteFrame
from facadelake.georeferencing.triangulation import ImageRay, intersect_rays
from schemas.vocabulary import HeightDatum, PlacementStatement, PointKind, PositionSource

COVERED = "the sigmas contain the mean deviation of the check points"
_MIN_PRIORS = 3
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True, kw_only=True, eq=False)
class ImportValidation:
    """Points of the passport, the columns of table ``georeference`` that they give, and remarks.

    ``gps_residual_m`` (n, 3): GPS minus camera centre; ``gps_sigma_m`` (n, 3); ``gps_flight`` (n,);
    ``gps_datum_unknown``: a height has no stated datum.
    """

    points: tuple[PassportPoint, ...]
    gps_residual_m: Float64Nx3
    gps_sigma_m: Float64Nx3
    gps_flight: Int64Array
    gps_datum_unknown: bool
    columns: Mapping[str, Any]
    remarks: tuple[str, ...]

    @property
    def held_out_m(self) -> Float64N:
        """Distances (n,) of surveyed points from their intersection by the imported cameras."""
        return np.array([np.linalg.norm(p.residual_site_m) for p in self.points if p.kind is PointKind.CHECK])

    def find_common_error_m(self, checks: Sequence[PlacementCheck]) -> Float64x3:
        """Mean deviation (3,) of the surveyed points where ``checks`` have them contradict the poses, else zeros.

        It is an error common to all poses, which their sigmas then contain.
        """
        if not any(check.disagrees and check.statement is PlacementStatement.SURVEYED_POINTS for check in checks):
            return np.zeros(3)
        residuals = [point.residual_site_m for point in self.points if point.kind is PointKind.CHECK]
        return np.asarray(np.mean(residuals, axis=0))


def validate_imported_poses(
    posed: Mapping[str, PosedCamera],
    photos: Sequence[Mapping[str, Any]],
    surveyed: Sequence[SurveyedPoints],
    site_frame: SiteFrame,
) -> ImportValidation:
    """Compare surveyed points with their intersection by the imported cameras, and GPS with the camera centres.

    Args:
        posed: the posed cameras in site, by photo_id.
        photos: the accepted rows of table ``photos``.
        surveyed: control and check points with their marks; all are check points here. A point that fewer than two
            posed photographs mark at a useful angle is left out.
        site_frame: the building's site frame.

    Returns:
        points, columns and remarks; the poses are not changed.
    """
    checks = [point for file in surveyed for point in _build_check_points(posed, file, site_frame)]
    located = [
        row
        for row in photos
        if row["photo_id"] in posed
        and row["prior_source"] != PositionSource.NONE
        and None not in (row["prior_lon_deg"], row["prior_lat_deg"], row["prior_height_m"])
    ]
    gps = _build_gps_points(posed, located, site_frame)
    columns: dict[str, Any] = {"check_points": len(checks)}
    remarks = []
    if checks:
        distance_m = np.array([np.linalg.norm(point.residual_site_m) for point in checks])
        columns |= {
            "check_residual_mean_m": float(distance_m.mean()),
            "check_residual_max_m": float(distance_m.max()),
        }
    if len(gps) >= _MIN_PRIORS:
        residual = np.array([point.residual_site_m for point in gps])
        offset = np.median(residual, axis=0)
        scatter = _MAD_TO_SIGMA * np.median(np.abs(residual - offset), axis=0) / np.sqrt(len(residual))
        columns |= {f"gps_offset_{axis}_m": float(value) for axis, value in zip(SITE_AXES, offset, strict=True)}
        columns["gps_offset_sigma_m"] = float(scatter.max())
        datums = {row["prior_height_datum"] for row in photos if row["prior_source"] != PositionSource.NONE}
        if datums != {HeightDatum.ELLIPSOIDAL}:
            remarks.append("not all GPS heights are stated as ellipsoidal; gps_offset_up_m is their offset")
    return ImportValidation(
        points=(*checks, *gps),
        gps_residual_m=np.array([point.residual_site_m for point in gps]).reshape(-1, 3),
        gps_sigma_m=np.array(
            [[*[row["prior_sigma_horizontal_m"]] * 2, row["prior_sigma_vertical_m"]] for row in located]
        ).reshape(-1, 3),
        gps_datum_unknown=any(row["prior_height_datum"] != HeightDatum.ELLIPSOIDAL for row in located),
        gps_flight=np.array([row["flight"] or 0 for row in located], dtype=np.int64),
        columns=columns,
        remarks=tuple(remarks),
    )


def _build_check_points(
    posed: Mapping[str, PosedCamera], surveyed: SurveyedPoints, site_frame: SiteFrame
) -> list[PassportPoint]:
    given = transform_to_site(surveyed, site_frame)
    points = []
    for point, xyz in zip(surveyed.points, given, strict=True):
        rays = []
        for mark in point.marks:
            camera = posed.get(mark.photo_name)
            if camera is not None:
                xy = np.array([mark.x_px, mark.y_px])
                rays.append(ImageRay(camera=camera.camera, world_from_cam=camera.site_from_cam, xy_img=xy))
        intersection = intersect_rays(rays)
        if intersection is not None and np.isfinite(xyz).all():
            points.append(
                PassportPoint(
                    name=point.name,
                    kind=PointKind.CHECK,
                    xyz_site_m=xyz,
                    residual_site_m=xyz - intersection.xyz_world,
                    used=False,
                )
            )
    return points


def _build_gps_points(
    posed: Mapping[str, PosedCamera], rows: Sequence[Mapping[str, Any]], site_frame: SiteFrame
) -> list[PassportPoint]:
    """GPS of the ``rows`` of table ``photos``, against the imported camera centres."""
    geo = np.array([[row["prior_lon_deg"], row["prior_lat_deg"], row["prior_height_m"]] for row in rows])
    given = site_from_crs(geo.reshape(-1, 3), site_frame.gnss_crs, site_frame)
    return [
        PassportPoint(
            name=row["photo_id"],
            kind=PointKind.GPS,
            xyz_site_m=xyz,
            residual_site_m=xyz - posed[row["photo_id"]].centre_site_m,
            used=False,
        )
        for row, xyz in zip(rows, given, strict=True)
    ]
