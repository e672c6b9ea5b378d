"""Table ``poses``: the pose of each accepted photograph, by its GPS prior where the photograph is outside the block."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import shapely

from facadelake.core.arrays import Float64Array, Float64x3
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.pose_table import columns_from_camera
from facadelake.core.tables import table_from_rows
from facadelake.georeferencing.georeferenced_campaign import GeoreferencedCampaign
from facadelake.georeferencing.gps.priors import ATTITUDE_SIGMA_DEG, rotation_from_attitude
from facadelake.sfm import Reconstruction, group_by_camera
from schemas.vocabulary import PhotoOutcome, PointKind, PoseSource, PositionSource

_MIN_RESIDUALS = 3
_MAD_TO_SIGMA = 1.4826
_TILT_SIGMA_DEG = 2.0


def build_poses_table(
    campaign: GeoreferencedCampaign, reconstruction: Reconstruction, photos: pa.Table, *, origin: SiteOrigin
) -> pa.Table:
    """Table ``poses``: one row for each accepted photograph, with a pose or with the reason why it has none.

    Args:
        campaign: the georeferenced campaign.
        reconstruction: its block, for tie points, reprojection errors and reasons.
        photos: table ``photos``.
        origin: origin of the site frame.

    Returns:
        the table. Quaternions are site_from_cam with ``qw`` >= 0; the geometry is a WKB point in EPSG:4979.
    """
    localised = {photo.photo_id: photo for photo in reconstruction.photos}
    reason_of = {photo.photo_id: photo.reason for photo in reconstruction.unlocalised}
    rows: list[dict[str, Any]] = []
    accepted = [row for row in photos.to_pylist() if row["photo_outcome"] == PhotoOutcome.ACCEPTED]
    cameras = find_adjusted_cameras(accepted, campaign.cameras, reconstruction)
    for row in accepted:
        photo_id = row["photo_id"]
        columns: dict[str, Any] = {
            "photo_id": photo_id,
            "image_width_px": row["image_width_px"],
            "image_height_px": row["image_height_px"],
        }
        if photo_id in localised:
            photo = localised[photo_id]
            columns |= {
                "pose_source": photo.source,
                "reprojection_error_px": photo.reprojection_error_px,
                "tie_points": photo.tie_points,
            }
            pose = build_pose_columns(campaign.cameras[photo_id], campaign.covariance[photo_id], origin)
            rows.append(columns | pose)
            continue
        columns |= {"reason": reason_of.get(photo_id, "not part of the reconstruction"), "tie_points": 0}
        prior = pose_from_prior(row, campaign, cameras.get(photo_id) or _build_stated_camera(row), origin)
        if prior is None:
            rows.append(columns | {"pose_source": PoseSource.UNLOCALISED})
        else:
            pose = build_pose_columns(prior.posed, prior.covariance, origin)
            rows.append(columns | {"pose_source": PoseSource.PRIOR} | pose)
    return table_from_rows("poses", rows)


def widen_poses(poses: pa.Table, error_m: Float64x3) -> pa.Table:
    """Table ``poses`` with an error (3,: east, north, up) of all positions added to covariances and sigmas."""
    if not np.any(error_m):
        return poses
    rows = poses.to_pylist()
    for row in rows:
        if row["covariance"] is None:
            continue
        covariance = np.reshape(row["covariance"], (6, 6))
        covariance[:3, :3] += np.diag(np.square(error_m))
        row |= _build_covariance_columns(covariance)
    return table_from_rows("poses", rows)


def build_pose_columns(posed: PosedCamera, covariance: Float64Array, origin: SiteOrigin) -> dict[str, Any]:
    """Centre in site and EPSG:4979, attitude, intrinsics, and the ``covariance`` (6, 6) with its sigmas, as columns."""
    lon, lat, height = origin.geo_from_site(posed.centre_site_m[None])[0].tolist()
    return {
        **columns_from_camera(posed),
        "lon_deg": lon,
        "lat_deg": lat,
        "height_ellipsoidal_m": height,
        **_build_covariance_columns(covariance),
        "geometry": shapely.to_wkb(shapely.Point(lon, lat, height), output_dimension=3, flavor="iso"),
    }


def _build_covariance_columns(covariance: Float64Array) -> dict[str, Any]:
    """The covariance (6, 6) of centre and attitude, the sigmas of the centre, and the largest one of the attitude."""
    east, north, up = np.sqrt(np.diag(covariance)[:3]).tolist()
    attitude = float(np.degrees(np.sqrt(np.linalg.eigvalsh(covariance[3:, 3:])[-1])))
    return {
        "covariance": covariance.ravel().tolist(),
        "sigma_east_m": east,
        "sigma_north_m": north,
        "sigma_up_m": up,
        "sigma_attitude_deg": attitude,
    }


@dataclass(frozen=True, kw_only=True, eq=False)
class PriorPose:
    """A pose from priors alone, with its covariance (6, 6; centre in m, attitude in rad about the camera's axes)."""

    posed: PosedCamera
    covariance: Float64Array


def pose_from_prior(
    row: Mapping[str, Any], campaign: GeoreferencedCampaign, camera: Camera | None, origin: SiteOrigin
) -> PriorPose | None:
    """The pose that a row of table ``photos`` states.

    The median GPS residual of the block's photographs is subtracted, and their scatter is its sigma.

    Args:
        row: the row.
        campaign: the georeferenced campaign.
        camera: the photograph's camera; None where it is unknown.
        origin: origin of the site frame.

    Returns:
        the pose, or None where the photograph lacks position, height, attitude or camera.
    """
    needed = ("prior_lon_deg", "prior_lat_deg", "prior_height_m", "prior_yaw_deg", "prior_pitch_deg", "prior_roll_deg")
    if row["prior_source"] == PositionSource.NONE or any(row[name] is None for name in needed):
        return None
    if camera is None:
        return None
    centre = origin.site_from_geo(np.array([[row["prior_lon_deg"], row["prior_lat_deg"], row["prior_height_m"]]]))[0]
    sigma_m = np.array([row["prior_sigma_horizontal_m"]] * 2 + [row["prior_sigma_vertical_m"]], dtype=np.float64)
    residual = np.array([p.residual_site_m for p in campaign.points if p.kind is PointKind.GPS and p.used])
    residual = residual.reshape(-1, 3)
    if len(residual) >= _MIN_RESIDUALS:
        centre = centre - np.median(residual, axis=0)
        scatter = _MAD_TO_SIGMA * np.median(np.abs(residual - np.median(residual, axis=0)), axis=0)
        sigma_m = np.hypot(np.maximum(scatter, 0.1 * sigma_m), np.sqrt(np.diag(campaign.frame_covariance_m2)))
    rotation = rotation_from_attitude(row["prior_yaw_deg"], row["prior_pitch_deg"], row["prior_roll_deg"])
    yaw = np.radians(row["prior_sigma_yaw_deg"] or ATTITUDE_SIGMA_DEG)
    tilt = np.radians(row["prior_sigma_tilt_deg"] or _TILT_SIGMA_DEG)
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.diag(sigma_m**2)
    covariance[3:, 3:] = rotation.T @ np.diag([tilt**2, tilt**2, yaw**2]) @ rotation
    return PriorPose(
        posed=PosedCamera(camera=camera, site_from_cam=Similarity(rotation=rotation, translation=centre)),
        covariance=covariance,
    )


def find_adjusted_cameras(
    rows: Sequence[dict[str, Any]], posed: Mapping[str, PosedCamera], reconstruction: Reconstruction
) -> Mapping[str, Camera]:
    """The adjusted camera of each photograph by photo_id, where photographs by its own camera are in the block.

    Two lenses of one drone have the same size: photographs belong together as in the reconstruction, not by size.

    Args:
        rows: rows of table ``photos`` of the accepted photographs.
        posed: the adjusted cameras of the block's photographs by photo_id.
        reconstruction: the block.

    Returns:
        the cameras, without those that only photographs with a zoom that the metadata do not state have.
    """
    _, group_of = group_by_camera(list(rows))
    groups = {row["photo_id"]: group for row, group in zip(rows, group_of, strict=True)}
    adjusted: dict[int, Camera] = {}
    for photo in reconstruction.photos:
        if photo.focal_factor == 1.0 and photo.photo_id in groups:
            adjusted.setdefault(groups[photo.photo_id], posed[photo.photo_id].camera)
    return {photo_id: adjusted[group] for photo_id, group in groups.items() if group in adjusted}


def _build_stated_camera(row: Mapping[str, Any]) -> Camera | None:
    """The camera of the metadata, without distortion; None where they state no focal length."""
    width, height, focal = row["image_width_px"], row["image_height_px"], row["prior_focal_px"]
    if focal is None:
        return None
    return Camera(width_px=width, height_px=height, fx_px=focal, fy_px=focal, cx_px=width / 2, cy_px=height / 2)
