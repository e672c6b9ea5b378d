"""Georeference: the block onto the globe by control points, by the building's model or by GPS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.camera import PosedCamera
from facadelake.errors import GeoreferenceError
from facadelake.frames import Array, Similarity
from facadelake.geodesy import SiteOrigin
from facadelake.pose.control_points import ControlPoints, control_in_site, has_own_heights, match_photo_names
from facadelake.pose.gps import GpsPriors, align_to_gps, check_against_gps, gps_priors
from facadelake.pose.model_alignment import SurfaceLike, align_to_model
from facadelake.pose.reconstruction import Reconstruction
from facadelake.pose.similarity_fit import robust_similarity
from facadelake.pose.triangulation import View, intersect
from facadelake.tables import table_of_rows
from schemas.vocabulary import ControlKind

# Survey, marking and the block's own bending together; a control point farther off (3.5 times) is a blunder.
_CONTROL_SIGMA_M = 0.15
_LEAST_CONTROL_POINTS = 3
# No photograph of a building is taken from farther; swapped axes and wrong zones are off by hundreds of kilometres.
_FARTHEST_M = 10_000.0


@dataclass(frozen=True, kw_only=True, eq=False)
class PointResidual:
    """What is left at one control point or GPS prior: its place and ``given - adjusted`` (3,), metres in site."""

    name: str
    xyz_site_m: Array
    residual_site_m: Array
    used: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class Georeferenced:
    """The campaign on the globe: transform, posed cameras by photo_id, residuals, and the passport's row."""

    control: ControlKind
    site_from_sfm: Similarity
    cameras: Mapping[str, PosedCamera]
    residuals: tuple[PointResidual, ...]
    row: Mapping[str, Any]

    def table(self) -> pa.Table:
        """Table `georeference`, one row."""
        return table_of_rows("georeference", [self.row])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Placement:
    """What one way of control found."""

    site_from_sfm: Similarity
    points_used: int
    points_total: int
    distance_m: Array
    residuals: tuple[PointResidual, ...]
    remarks: Sequence[str]


def georeference(
    reconstruction: Reconstruction,
    photos: pa.Table,
    *,
    origin: SiteOrigin,
    map_crs: str,
    vertical_datum: str,
    control: ControlKind | None,
    control_points: ControlPoints | None,
    surface: SurfaceLike | None,
) -> Georeferenced:
    """Place the block in site.

    ``control`` None chooses: control points where 3 or more can be used, else GPS. MODEL starts from GPS and needs
    ``surface``. ``vertical_datum`` ("ellipsoidal" or a vertical CRS) is what control heights without a datum mean.
    Raises GeoreferenceError where the chosen control cannot place the block.
    """
    priors = gps_priors(reconstruction, photos, origin)
    remarks: list[str] = []
    if control is None:
        control, why = _chosen(reconstruction, control_points)
        remarks.append(why)
    if control is ControlKind.GCP:
        placement = _by_control_points(reconstruction, control_points, origin, vertical_datum)
        if priors.sigma_m.size and float(np.median(priors.sigma_m)) > 1.0:  # RTK bends less than the block: no judge
            centres = reconstruction.centres_sfm[priors.photo]
            check_against_gps(placement.site_from_sfm, centres, priors, by="control points")
    elif control is ControlKind.GPS:
        placement = _by_gps(reconstruction, priors)
    else:
        placement = _by_model(reconstruction, priors, surface)
    site_from_sfm = placement.site_from_sfm
    _refuse_far_away(site_from_sfm.apply(reconstruction.centres_sfm), control, origin)
    row: dict[str, Any] = {
        "control": control,
        "map_crs": map_crs,
        "vertical_datum": vertical_datum,
        "points_used": placement.points_used,
        "points_total": placement.points_total,
        "scale": site_from_sfm.scale,
        "residual_mean_m": float(placement.distance_m.mean()),
        "residual_rmse_m": float(np.sqrt((placement.distance_m**2).mean())),
        "residual_max_m": float(placement.distance_m.max()),
    }
    if len(priors.photo):
        offset = np.median(priors.xyz_site_m - site_from_sfm.apply(reconstruction.centres_sfm[priors.photo]), axis=0)
        row |= {f"gps_offset_{axis}_m": float(v) for axis, v in zip(("east", "north", "up"), offset, strict=True)}
        if priors.datum_unknown and control is not ControlKind.GPS:
            remarks.append("GPS heights do not name their datum; gps_offset_up_m says how far they are off")
    row["remarks"] = "; ".join([*remarks, *placement.remarks])
    return Georeferenced(
        control=control,
        site_from_sfm=site_from_sfm,
        cameras={
            photo.photo_id: PosedCamera(
                camera=photo.camera,
                site_from_cam=Similarity(
                    rotation=site_from_sfm.rotation @ photo.sfm_from_cam.rotation,
                    translation=site_from_sfm.apply(photo.sfm_from_cam.translation),
                ),
            )
            for photo in reconstruction.photos
        },
        residuals=placement.residuals,
        row=row,
    )


def _refuse_far_away(centres_site_m: Array, control: ControlKind, origin: SiteOrigin) -> None:
    """Raise GeoreferenceError where the cameras came to lie at another place than the building (site's origin)."""
    middle_m = np.median(centres_site_m, axis=0)
    away_m = float(np.linalg.norm(middle_m))
    if away_m > _FARTHEST_M:
        lon, lat, _ = origin.geo_from_site(middle_m[None])[0]
        raise GeoreferenceError(
            f"the photographs come to lie {away_m / 1000:.0f} km from the building model (limit "
            f"{_FARTHEST_M / 1000:.0f} km) by {control}, near lon {lon:.3f}, lat {lat:.3f}; are latitude and longitude "
            "(or east and north) swapped, is a CRS or UTM zone wrong, or do photographs and model belong to different "
            "buildings?"
        )


def _views(reconstruction: Reconstruction, control_points: ControlPoints) -> list[list[View]]:
    """The sightings of each control point in photographs of the block."""
    by_id = {photo.photo_id: photo for photo in reconstruction.photos}
    names = [sighting.photo_name for point in control_points.points for sighting in point.sightings]
    photo_of = match_photo_names(names, list(by_id))
    return [
        [
            View(
                camera=by_id[photo_of[sighting.photo_name]].camera,
                world_from_cam=by_id[photo_of[sighting.photo_name]].sfm_from_cam,
                xy_img=np.array([sighting.x_px, sighting.y_px]),
            )
            for sighting in point.sightings
            if sighting.photo_name in photo_of
        ]
        for point in control_points.points
    ]


def _chosen(reconstruction: Reconstruction, control_points: ControlPoints | None) -> tuple[ControlKind, str]:
    if control_points is None:
        return ControlKind.GPS, "chosen by itself: no control points were given"
    usable = sum(intersect(views) is not None for views in _views(reconstruction, control_points) if len(views) >= 2)
    if usable >= _LEAST_CONTROL_POINTS:
        return ControlKind.GCP, f"chosen by itself: {usable} control points can be used"
    return (
        ControlKind.GPS,
        f"chosen by itself: {usable} of {len(control_points.points)} control points of {control_points.source} can be "
        f"used ({_LEAST_CONTROL_POINTS} are needed)",
    )


def _by_control_points(
    reconstruction: Reconstruction, control_points: ControlPoints | None, origin: SiteOrigin, vertical_datum: str
) -> _Placement:
    if control_points is None:
        raise GeoreferenceError("georeference by control points was asked for, but none were given; add a gcp_list.txt")
    given = control_in_site(control_points, origin=origin, vertical_datum=vertical_datum)
    names, source, target, lost = [], [], [], []
    for point, xyz_site, views in zip(
        control_points.points, given, _views(reconstruction, control_points), strict=True
    ):
        found = intersect(views) if len(views) >= 2 else None
        if found is None:
            lost.append(point.name)
            continue
        names.append(point.name)
        source.append(found.xyz_world)
        target.append(xyz_site)
    if len(names) < _LEAST_CONTROL_POINTS:
        raise GeoreferenceError(
            f"{len(names)} of {len(given)} control points of {control_points.source} can be used, "
            f"{_LEAST_CONTROL_POINTS} are needed; each must be marked in 2 or more localised photographs whose names "
            f"match the files (not usable: {', '.join(lost) or 'none'})"
        )
    xyz_sfm, xyz_site = np.array(source), np.array(target)
    fit = robust_similarity(xyz_sfm, xyz_site, np.full(xyz_site.shape, _CONTROL_SIGMA_M))
    if 2 * fit.used.sum() <= len(names):
        raise GeoreferenceError(
            f"only {int(fit.used.sum())} of {len(names)} control points of {control_points.source} agree with one "
            "another (more than half must): check their coordinates, CRS and marks, or georeference by gps"
        )
    remarks = []
    if lost:
        remarks.append(f"control points not usable (fewer than 2 agreeing marks): {', '.join(lost)}")
    if not fit.used.all():
        blunders = [name for name, good in zip(names, fit.used, strict=True) if not good]
        remarks.append(f"control points left out as gross errors: {', '.join(blunders)}")
    if not has_own_heights(control_points.crs):
        remarks.append(f"the control points' heights name no datum: taken in the model's ({vertical_datum})")
    return _Placement(
        site_from_sfm=fit.target_from_source,
        points_used=int(fit.used.sum()),
        points_total=len(given),
        distance_m=np.linalg.norm(fit.residual[fit.used], axis=1),
        residuals=_point_residuals(names, xyz_site, fit.residual, fit.used.tolist()),
        remarks=remarks,
    )


def _point_residuals(
    names: Sequence[str], xyz: Array, residual: Array, used: Sequence[bool]
) -> tuple[PointResidual, ...]:
    return tuple(
        PointResidual(name=name, xyz_site_m=at, residual_site_m=left, used=good)
        for name, at, left, good in zip(names, xyz, residual, used, strict=True)
    )


def _by_gps(reconstruction: Reconstruction, priors: GpsPriors) -> _Placement:
    aligned = align_to_gps(reconstruction, priors)
    names = [reconstruction.photos[i].photo_id for i in priors.photo]
    return _Placement(
        site_from_sfm=aligned.site_from_sfm,
        points_used=int(aligned.used.sum()),
        points_total=len(names),
        distance_m=np.linalg.norm(aligned.residual_m[aligned.used], axis=1),
        residuals=_point_residuals(names, priors.xyz_site_m, aligned.residual_m, aligned.used.tolist()),
        remarks=[*aligned.remarks, "the error common to all GPS positions (metres) cannot be seen from them"],
    )


def _by_model(reconstruction: Reconstruction, priors: GpsPriors, surface: SurfaceLike | None) -> _Placement:
    if surface is None:
        raise GeoreferenceError("georeference by the model was asked for, but the model's surface was not given")
    start = align_to_gps(reconstruction, priors)
    aligned = align_to_model(start.site_from_sfm, reconstruction, priors, surface)
    names = [reconstruction.photos[i].photo_id for i in priors.photo]
    left = priors.xyz_site_m - aligned.site_from_sfm.apply(reconstruction.centres_sfm[priors.photo])
    return _Placement(
        site_from_sfm=aligned.site_from_sfm,
        points_used=len(aligned.residual_m),
        points_total=aligned.points_offered,
        distance_m=aligned.residual_m,
        residuals=_point_residuals(names, priors.xyz_site_m, left, start.used.tolist()),
        remarks=aligned.remarks,
    )
