"""Poses that photographs outside the block have by their own word: GPS, corrected by what the block found GPS to be
off by, and the gimbal's attitude."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Float64Array, Similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.georeferencing.georeference import Georeferenced
from facadelake.georeferencing.gps.alignment import ATTITUDE_SIGMA_DEG, rotation_of_attitude
from schemas.vocabulary import PointKind, PositionSource

_FEWEST_RESIDUALS = 3
_MAD_TO_SIGMA = 1.4826
_TILT_SIGMA_DEG = 2.0


@dataclass(frozen=True, kw_only=True, eq=False)
class PriorPose:
    """A pose by prior alone, with its covariance (6, 6; centre in m, attitude in rad about the camera's axes)."""

    posed: PosedCamera
    covariance: Float64Array


def prior_pose(row: Mapping[str, Any], placed: Georeferenced, origin: SiteOrigin) -> PriorPose | None:
    """The pose that a row of table ``photos`` states, or None where it lacks position, height, attitude or lens."""
    stated = ("prior_lon_deg", "prior_lat_deg", "prior_height_m", "prior_yaw_deg", "prior_pitch_deg", "prior_roll_deg")
    if row["prior_source"] == PositionSource.NONE or any(row[name] is None for name in stated):
        return None
    camera = _lens(row, placed)
    if camera is None:
        return None
    given = origin.site_from_geo(np.array([[row["prior_lon_deg"], row["prior_lat_deg"], row["prior_height_m"]]]))[0]
    sigma_m = np.array([row["prior_sigma_horizontal_m"]] * 2 + [row["prior_sigma_vertical_m"]], dtype=np.float64)
    left = np.array([p.residual_site_m for p in placed.points if p.kind is PointKind.GPS and p.used]).reshape(-1, 3)
    if len(left) >= _FEWEST_RESIDUALS:
        # Its neighbours in the block show what GPS has in common (taken out) and how it scatters (left over).
        given = given - np.median(left, axis=0)
        scatter = _MAD_TO_SIGMA * np.median(np.abs(left - np.median(left, axis=0)), axis=0)
        sigma_m = np.hypot(np.maximum(scatter, 0.1 * sigma_m), np.sqrt(np.diag(placed.frame_covariance_m2)))
    rotation = rotation_of_attitude(row["prior_yaw_deg"], row["prior_pitch_deg"], row["prior_roll_deg"])
    yaw = np.radians(row["prior_sigma_yaw_deg"] or ATTITUDE_SIGMA_DEG)
    tilt = np.radians(row["prior_sigma_tilt_deg"] or _TILT_SIGMA_DEG)
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.diag(sigma_m**2)
    covariance[3:, 3:] = rotation.T @ np.diag([tilt**2, tilt**2, yaw**2]) @ rotation
    return PriorPose(
        posed=PosedCamera(camera=camera, site_from_cam=Similarity(rotation=rotation, translation=given)),
        covariance=covariance,
    )


def _lens(row: Mapping[str, Any], placed: Georeferenced) -> Camera | None:
    """The adjusted lens of a photograph of the same size and like focal length, else what the photograph states."""
    width, height, focal = row["image_width_px"], row["image_height_px"], row["prior_focal_px"]
    for other in placed.cameras.values():
        same_size = (other.camera.width_px, other.camera.height_px) == (width, height)
        if same_size and (focal is None or abs(other.camera.fx_px / focal - 1) < 0.1):
            return other.camera
    if focal is None:
        return None
    return Camera(width_px=width, height_px=height, fx_px=focal, fy_px=focal, cx_px=width / 2, cy_px=height / 2)
