"""Attitude priors: the viewing direction of the camera, its standard deviations and its evidence."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from facadelake.photos.drone_xmp import DroneMetadata
from facadelake.photos.exif import ExifMetadata

# A drone's heading comes from a magnetometer fused with its motion: some degrees, more near steel and concrete.
SIGMA_YAW_DRONE_DEG = 5.0
# The gimbal stabilises to hundredths of a degree, but its horizon is known to about a degree.
SIGMA_TILT_DRONE_DEG = 1.0
# Without an attitude of the gimbal the aircraft's heading is used: cameras point within some tens of degrees of it.
SIGMA_YAW_AIRCRAFT_DEG = 30.0
# A phone's compass: iOS states 10 to 25 deg; a magnetic direction adds the declination, which is unknown here.
SIGMA_YAW_COMPASS_DEG = 15.0
SIGMA_YAW_MAGNETIC_DEG = 25.0


@dataclass(frozen=True, kw_only=True)
class AttitudePrior:
    """Yaw clockwise from north, pitch above the horizon, roll clockwise, in degrees; NaN where unknown.

    ``sigma_tilt_deg`` is the standard deviation of the vertical direction in the camera frame. Towards nadir and zenith
    yaw and roll rotate about the same axis, and only their sum is defined: ``sigma_yaw_deg`` grows there, up to 180.
    """

    yaw_deg: float = math.nan
    pitch_deg: float = math.nan
    roll_deg: float = math.nan
    sigma_yaw_deg: float = math.nan
    sigma_tilt_deg: float = math.nan
    evidence: str = ""
    warning: str = ""


NO_ATTITUDE = AttitudePrior()


def derive_attitude_prior(drone: DroneMetadata | None, exif: ExifMetadata) -> AttitudePrior:
    """The attitude of the gimbal, else the yaw of the camera's compass, else the yaw of the aircraft, else none."""
    prior = _read_gimbal_attitude(drone) if drone is not None else NO_ATTITUDE
    if math.isfinite(prior.yaw_deg):
        return prior
    if 0 <= exif.direction_deg <= 360:
        magnetic = exif.direction_magnetic
        return replace(
            prior,
            yaw_deg=_wrap_angle(exif.direction_deg),
            sigma_yaw_deg=SIGMA_YAW_MAGNETIC_DEG if magnetic else SIGMA_YAW_COMPASS_DEG,
            evidence=f"EXIF GPSImgDirection ({'magnetic' if magnetic else 'true'} north)",
        )
    if drone is not None and 0 < abs(drone.aircraft_yaw_deg) <= 360:
        return replace(
            prior,
            yaw_deg=_wrap_angle(drone.aircraft_yaw_deg),
            sigma_yaw_deg=SIGMA_YAW_AIRCRAFT_DEG,
            evidence="XMP FlightYawDegree (the aircraft's)",
        )
    return prior


def _read_gimbal_attitude(drone: DroneMetadata) -> AttitudePrior:
    angles = (drone.yaw_deg, drone.pitch_deg, drone.roll_deg)
    if not all(math.isfinite(angle) for angle in angles):
        return NO_ATTITUDE
    if angles == (0.0, 0.0, 0.0):
        # Written by payloads without a link to the aircraft (issue 772 of DJI's Mobile SDK V5) and by Autel.
        return AttitudePrior(warning=f"no attitude: {drone.attitude_tags} are all 0, the value of an unknown attitude")
    if drone.upside_down:
        return AttitudePrior(warning="no attitude: the camera was mounted upside down (CamReverse, GimbalReverse)")
    if not -180 <= drone.pitch_deg <= 90 or max(map(abs, angles)) > 360:
        return AttitudePrior(warning=f"no attitude: yaw, pitch, roll {angles} are out of range")
    sigma_yaw = drone.stated_sigma_yaw_deg if drone.stated_sigma_yaw_deg > 0 else SIGMA_YAW_DRONE_DEG
    sigma_tilt = drone.stated_sigma_tilt_deg if drone.stated_sigma_tilt_deg > 0 else SIGMA_TILT_DRONE_DEG
    cos_pitch = abs(math.cos(math.radians(drone.pitch_deg)))
    return AttitudePrior(
        yaw_deg=_wrap_angle(drone.yaw_deg),
        pitch_deg=drone.pitch_deg,
        roll_deg=drone.roll_deg,
        sigma_yaw_deg=min(180.0, sigma_yaw / max(cos_pitch, 1e-9)),
        sigma_tilt_deg=min(180.0, sigma_tilt),
        evidence=f"XMP {drone.attitude_tags}",
    )


def _wrap_angle(angle_deg: float) -> float:
    """The angle in (-180, 180]; unchanged where it lies in the range already."""
    return angle_deg if -180 < angle_deg <= 180 else 180 - (180 - angle_deg) % 360


def is_dji_pitch(camera_pitches_deg: Iterable[float]) -> bool:
    """Whether the Camera:Pitch values of one camera (NaN: missing) follow DJI's convention, 0 at the horizon.

    Autel's XL715 does so (issue 62 of OpenAthenaIOS). In Pix4D's convention pitch is 0 at nadir and 90 at the horizon;
    below 0 the camera would point backwards under the aircraft. Therefore one clearly negative value decides.
    """
    return any(pitch < -1.0 for pitch in camera_pitches_deg)


def apply_dji_pitch(drone: DroneMetadata) -> DroneMetadata:
    """The metadata with Camera:Pitch interpreted in DJI's convention."""
    return replace(drone, pitch_deg=drone.camera_pitch_deg, attitude_tags="Camera:Yaw/Pitch/Roll, pitch as DJI's")
