"""What a campaign has to judge imported poses by: surveyed points that are marked in its photographs, and GPS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from facadelake.core.arrays import Float64Array
from facadelake.core.camera import PosedCamera
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.photo_names import PhotoNames
from facadelake.georeferencing.gcp.control_points import SurveyedPoints, transform_to_site
from facadelake.georeferencing.passport import PassportPoint
from facadelake.georeferencing.site_frame import SiteFrame
from facadelake.georeferencing.triangulation import ImageRay, intersect_rays
from schemas.vocabulary import HeightDatum, PointKind, PositionSource

_AXES = ("east", "north", "up")
_MIN_PRIORS = 3
# No flight's GPS errs so far as a whole (heights shift by 15 m); geoid and ellipsoid lie further apart in most places.
_MAX_GPS_OFFSET_M = 20.0
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True, kw_only=True, eq=False)
class ImportValidation:
    """Points of the passport, its columns that they fill, and what is to be said of them."""

    points: tuple[PassportPoint, ...]
    columns: Mapping[str, Any]
    remarks: tuple[str, ...]

    @property
    def held_out_m(self) -> Float64Array:
        """Distances (n,) of surveyed points from where the imported poses see them."""
        return np.array([np.linalg.norm(p.residual_site_m) for p in self.points if p.kind is PointKind.CHECK])


def validate_imported_poses(
    posed: Mapping[str, PosedCamera],
    photos: Sequence[Mapping[str, Any]],
    surveyed: Sequence[SurveyedPoints],
    place: SiteFrame,
) -> ImportValidation:
    """Surveyed points against their intersection by the imported cameras, and the photographs' GPS against the centres.

    All are check points: nothing of them holds the poses. ``photos`` are accepted rows of table ``photos``. A point
    that fewer than two posed photographs mark at a useful angle is left out.
    """
    checks = [point for file in surveyed for point in _build_check_points(posed, file, place)]
    gps = _build_gps_points(posed, photos, place.origin)
    columns: dict[str, Any] = {"check_points": len(checks)}
    remarks = []
    if checks:
        off_m = np.array([np.linalg.norm(point.residual_site_m) for point in checks])
        columns |= {"check_residual_mean_m": float(off_m.mean()), "check_residual_max_m": float(off_m.max())}
    if len(gps) >= _MIN_PRIORS:
        left = np.array([point.residual_site_m for point in gps])
        offset = np.median(left, axis=0)
        scatter = _MAD_TO_SIGMA * np.median(np.abs(left - offset), axis=0) / np.sqrt(len(left))
        columns |= {f"gps_offset_{axis}_m": float(value) for axis, value in zip(_AXES, offset, strict=True)}
        columns["gps_offset_sigma_m"] = float(scatter.max())
        worst = int(np.argmax(np.abs(offset)))
        if abs(offset[worst]) > _MAX_GPS_OFFSET_M:
            remarks.append(
                f"the photographs' GPS lies {offset[worst]:+.0f} m {_AXES[worst]} of the poses: is a height datum or a "
                "CRS of the poses another than stated?"
            )
        datums = {row["prior_height_datum"] for row in photos if row["prior_source"] != PositionSource.NONE}
        if datums != {HeightDatum.ELLIPSOIDAL}:
            remarks.append("GPS heights do not all name the ellipsoid; gps_offset_up_m says how far they are off")
    return ImportValidation(points=(*checks, *gps), columns=columns, remarks=tuple(remarks))


def _build_check_points(
    posed: Mapping[str, PosedCamera], surveyed: SurveyedPoints, place: SiteFrame
) -> list[PassportPoint]:
    names = PhotoNames(posed)
    given = transform_to_site(surveyed, origin=place.origin, vertical_datum=place.vertical_datum)
    points = []
    for point, xyz in zip(surveyed.points, given, strict=True):
        views = []
        for sighting in point.marks:
            photo_id = names.match(sighting.photo_name).photo_id
            if photo_id is not None:
                camera = posed[photo_id]
                xy = np.array([sighting.x_px, sighting.y_px])
                views.append(ImageRay(camera=camera.camera, world_from_cam=camera.site_from_cam, xy_img=xy))
        found = intersect_rays(views)
        if found is not None:
            points.append(
                PassportPoint(
                    name=point.name,
                    kind=PointKind.CHECK,
                    xyz_site_m=xyz,
                    residual_site_m=xyz - found.xyz_world,
                    used=False,
                )
            )
    return points


def _build_gps_points(
    posed: Mapping[str, PosedCamera], photos: Sequence[Mapping[str, Any]], origin: SiteOrigin
) -> list[PassportPoint]:
    rows = [
        row
        for row in photos
        if row["photo_id"] in posed
        and row["prior_source"] != PositionSource.NONE
        and None not in (row["prior_lon_deg"], row["prior_lat_deg"], row["prior_height_m"])
    ]
    geo = np.array([[row["prior_lon_deg"], row["prior_lat_deg"], row["prior_height_m"]] for row in rows])
    given = origin.site_from_geo(geo.reshape(-1, 3))
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
