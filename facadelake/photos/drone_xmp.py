"""XMP metadata of drones, by maker, converted to one convention.

The attitude is that of the camera (the gimbal, not the aircraft) in north-east-down (NED): yaw clockwise from north,
pitch above the horizon (-90 is nadir), roll clockwise. The tags and their meaning:

- DJI: user manuals of Mavic 3E/3M, Zenmuse P1 and Matrice 4 ("Photo file", XMP fields): Gimbal*Degree are NED, order
  ZYX; RtkFlag 0 none, 16 single, 32 to 49 float, 50 fixed; RtkStd* metres; CalibratedFocalLength is the lens's design
  value, DewarpData the camera's own calibration (fx, fy, cx, cy, k1, k2, p1, p2, k3; cx, cy from the photograph's
  centre); DewarpFlag 1: already undistorted. Early firmware writes GpsLongtitude (sic).
- Autel, newer firmware: DJI's tags in DJI's namespace (prefix ``drone``), with GpsLongtitude.
- Parrot: developer.parrot.com, "Embedded photo metadata": Camera*Degree are NED; Camera:Pitch follows Pix4D (its
  example has 38.0 beside CameraPitchDegree -52.0); GPSXYAccuracy and GPSZAccuracy are one sigma; the position is in
  the exif schema.
- Skydio: "Camera and metadata overview": CameraOrientationNED is a structure (Roll, Pitch, Yaw), written as attributes
  or as elements; CalibratedFocalLengthX is the factory calibration of the individual drone.
- Pix4D's Camera schema (Autel's older firmware, senseFly, Sentera, some Parrot): pitch 0 at nadir, 90 at the horizon.
  Autel's XL715 writes DJI's convention into it; see ``facadelake.photos.attitude_prior.is_dji_pitch``.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

from facadelake.photos.gps_block import parse_gps_altitude
from facadelake.photos.xmp import XmpPacket, find_step

DJI = "http://www.dji.com/drone-dji/1.0"
SKYDIO = "https://www.skydio.com/drone-skydio/1.0"
PARROT = "http://www.parrot.com/drone-parrot/1.0"
CAMERA_SCHEMAS = ("http://pix4d.com/camera/1.0", "http://ns.sensefly.com/Camera/1.0")
EXIF_SCHEMA = "http://ns.adobe.com/exif/1.0"
# RtkFlag of a fixed solution, and those of a float one: 32 to 49 in DJI's manuals, 34 in the older ones.
RTK_FIXED = 50
RTK_FLOAT = range(32, 50)
_XMP_ANGLE = re.compile(r"(\d+),(\d+(?:\.\d+)?)(?:,(\d+(?:\.\d+)?))?([NSEW])")


@dataclass(frozen=True, kw_only=True)
class DewarpCalibration:
    """DJI's calibration of the individual camera, px of the full photograph; the centre is relative to its centre."""

    fx_px: float
    fy_px: float
    centre_x_px: float
    centre_y_px: float
    k1: float
    k2: float
    p1: float
    p2: float
    k3: float


@dataclass(frozen=True, kw_only=True)
class DroneMetadata:
    """XMP metadata of a drone; NaN, empty or None where a value is missing.

    Latitude and longitude in degrees (WGS 84), altitudes in metres (the datum of the absolute altitude depends on the
    drone: see ``facadelake.photos.position_prior``), attitude of the camera in degrees (north-east-down),
    ``stated_sigma_*`` as stated by the maker. ``position_step_deg`` and ``altitude_step_m`` are the resolutions as
    written; ``position_problem`` says why a position cannot be right although it is valid. ``camera_pitch_deg`` is
    Camera:Pitch as written, where the attitude comes from it. ``body`` is the serial number of the aircraft.
    """

    maker: str
    body: str = ""
    flight_id: str = ""
    lat_deg: float = math.nan
    lon_deg: float = math.nan
    absolute_altitude_m: float = math.nan
    relative_altitude_m: float = math.nan
    altitude_type: str = ""
    gps_status: str = ""
    rtk_flag: int | None = None
    rtk_std_lon_m: float = math.nan
    rtk_std_lat_m: float = math.nan
    rtk_std_height_m: float = math.nan
    position_problem: str = ""
    position_step_deg: float = math.nan
    altitude_step_m: float = math.nan
    stated_sigma_horizontal_m: float = math.nan
    stated_sigma_vertical_m: float = math.nan
    yaw_deg: float = math.nan
    pitch_deg: float = math.nan
    roll_deg: float = math.nan
    attitude_tags: str = ""
    camera_pitch_deg: float = math.nan
    stated_sigma_yaw_deg: float = math.nan
    stated_sigma_tilt_deg: float = math.nan
    upside_down: bool = False
    aircraft_yaw_deg: float = math.nan
    calibrated_focal_px: float = math.nan
    calibrated_width_px: float = math.nan
    factory_calibrated: bool = False
    dewarp: DewarpCalibration | None = None
    dewarped: bool = False


def _parse_dewarp(text: str) -> DewarpCalibration | None:
    """Parse ``2022-03-02;fx,fy,cx,cy,k1,k2,p1,p2,k3``; None for other texts and for zeros (an uncalibrated camera)."""
    parts = text.rpartition(";")[2].split(",")
    try:
        fx, fy, cx, cy, k1, k2, p1, p2, k3 = (float(part) for part in parts)
    except ValueError:
        return None
    if not (fx > 0 and fy > 0 and all(math.isfinite(x) for x in (fx, fy, cx, cy, k1, k2, p1, p2, k3))):
        return None
    return DewarpCalibration(fx_px=fx, fy_px=fy, centre_x_px=cx, centre_y_px=cy, k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)


def _find_finer(first: float, second: float) -> float:
    """The finer of two resolutions: trailing zeros may be left out of one of the numbers."""
    return min(filter(math.isfinite, (first, second)), default=math.nan)


def _read_dji(xmp: XmpPacket) -> DroneMetadata:
    flag = xmp.get_number(DJI, "RtkFlag")
    # Without a fix of RTK their values have no meaning.
    read_std = xmp.get_sigma if flag == RTK_FIXED or flag in RTK_FLOAT else xmp.get_number
    return DroneMetadata(
        maker="DJI",
        body=xmp.get_text(DJI, "DroneSerialNumber", "DroneID", "CameraSerialNumber"),
        lat_deg=xmp.get_number(DJI, "GpsLatitude"),
        lon_deg=xmp.get_number(DJI, "GpsLongitude", "GpsLongtitude"),
        absolute_altitude_m=xmp.get_number(DJI, "AbsoluteAltitude"),
        relative_altitude_m=xmp.get_number(DJI, "RelativeAltitude"),
        altitude_type=xmp.get_text(DJI, "AltitudeType"),
        gps_status=xmp.get_text(DJI, "GpsStatus"),
        rtk_flag=int(flag) if math.isfinite(flag) else None,
        rtk_std_lon_m=read_std(DJI, "RtkStdLon"),
        rtk_std_lat_m=read_std(DJI, "RtkStdLat"),
        rtk_std_height_m=read_std(DJI, "RtkStdHgt"),
        position_step_deg=_find_finer(
            xmp.get_step(DJI, "GpsLatitude"), xmp.get_step(DJI, "GpsLongitude", "GpsLongtitude")
        ),
        altitude_step_m=xmp.get_step(DJI, "AbsoluteAltitude"),
        yaw_deg=xmp.get_number(DJI, "GimbalYawDegree"),
        pitch_deg=xmp.get_number(DJI, "GimbalPitchDegree"),
        roll_deg=xmp.get_number(DJI, "GimbalRollDegree"),
        attitude_tags="Gimbal*Degree",
        upside_down=1 in (xmp.get_number(DJI, "CamReverse"), xmp.get_number(DJI, "GimbalReverse")),
        aircraft_yaw_deg=xmp.get_number(DJI, "FlightYawDegree"),
        calibrated_focal_px=xmp.get_number(DJI, "CalibratedFocalLength"),
        calibrated_width_px=2 * xmp.get_number(DJI, "CalibratedOpticalCenterX"),
        dewarp=_parse_dewarp(xmp.get_text(DJI, "DewarpData")),
        dewarped=xmp.get_number(DJI, "DewarpFlag") == 1,
    )


def _read_skydio(xmp: XmpPacket) -> DroneMetadata:
    ned = "CameraOrientationNED"
    return DroneMetadata(
        maker="Skydio",
        lat_deg=xmp.get_number(SKYDIO, "Latitude"),
        lon_deg=xmp.get_number(SKYDIO, "Longitude"),
        absolute_altitude_m=xmp.get_number(SKYDIO, "AbsoluteAltitude"),
        relative_altitude_m=xmp.get_number(SKYDIO, "RelativeAltitude"),
        position_step_deg=_find_finer(xmp.get_step(SKYDIO, "Latitude"), xmp.get_step(SKYDIO, "Longitude")),
        altitude_step_m=xmp.get_step(SKYDIO, "AbsoluteAltitude"),
        yaw_deg=xmp.get_number(SKYDIO, f"{ned}/Yaw"),
        pitch_deg=xmp.get_number(SKYDIO, f"{ned}/Pitch"),
        roll_deg=xmp.get_number(SKYDIO, f"{ned}/Roll"),
        attitude_tags=ned,
        calibrated_focal_px=xmp.get_number(SKYDIO, "CalibratedFocalLengthX"),
        # The documented centre of a 4056 px wide photograph is 2027.5: pixel centres are counted from 0.
        calibrated_width_px=2 * xmp.get_number(SKYDIO, "CalibratedOpticalCenterX") + 1,
        factory_calibrated=True,
    )


def _read_angle(xmp: XmpPacket, name: str) -> float:
    """Signed degrees of ``48,21.1367729N`` (degrees, minutes) or ``48,21,8N``; NaN, with a warning, for other texts."""
    text = xmp.get_text(EXIF_SCHEMA, name)
    found = _XMP_ANGLE.fullmatch(text.upper())
    if found is None:
        if text:
            xmp.warnings.append(f"XMP {name} '{text[:40]}' is not of the form 48,21.1367729N; not used")
        return math.nan
    degrees = float(found[1]) + float(found[2]) / 60 + float(found[3] or 0) / 3600
    return -degrees if found[4] in "SW" else degrees


def _find_angle_step(xmp: XmpPacket, name: str) -> float:
    """Resolution as written of an angle, degrees; NaN where there is none."""
    found = _XMP_ANGLE.fullmatch(xmp.get_text(EXIF_SCHEMA, name).upper())
    if found is None:
        return math.nan
    return find_step(found[3]) / 3600 if found[3] else find_step(found[2]) / 60


def _read_altitude(xmp: XmpPacket) -> float:
    """The altitude of the exif schema, negative below its reference; NaN, with a warning, where that is not clear."""
    altitude = parse_gps_altitude(
        xmp.get_number(EXIF_SCHEMA, "GPSAltitude"), xmp.get_text(EXIF_SCHEMA, "GPSAltitudeRef") or None
    )
    if altitude.warning:
        xmp.warnings.append(f"XMP {altitude.warning}")
    return altitude.altitude_m


def _read_parrot(xmp: XmpPacket) -> DroneMetadata:
    return DroneMetadata(
        maker="Parrot",
        body=xmp.get_text(PARROT, "SerialNumber"),
        lat_deg=_read_angle(xmp, "GPSLatitude"),
        lon_deg=_read_angle(xmp, "GPSLongitude"),
        absolute_altitude_m=_read_altitude(xmp),
        position_step_deg=_find_finer(_find_angle_step(xmp, "GPSLatitude"), _find_angle_step(xmp, "GPSLongitude")),
        altitude_step_m=xmp.get_step(EXIF_SCHEMA, "GPSAltitude"),
        yaw_deg=xmp.get_number(PARROT, "CameraYawDegree"),
        pitch_deg=xmp.get_number(PARROT, "CameraPitchDegree"),
        roll_deg=xmp.get_number(PARROT, "CameraRollDegree"),
        attitude_tags="Camera*Degree",
    )


def _add_camera_schema(drone: DroneMetadata, xmp: XmpPacket, schema: str) -> DroneMetadata:
    """Add accuracies and flight of Pix4D's schema, and its attitude where the maker's own tags have none."""
    tilts = [xmp.get_number(schema, f"IMU{angle}Accuracy") for angle in ("Pitch", "Roll")]
    drone = replace(
        drone,
        flight_id=xmp.get_text(schema, "FlightUUID"),
        stated_sigma_horizontal_m=xmp.get_sigma(schema, "GPSXYAccuracy"),
        stated_sigma_vertical_m=xmp.get_sigma(schema, "GPSZAccuracy"),
        stated_sigma_yaw_deg=xmp.get_number(schema, "IMUYawAccuracy"),
        stated_sigma_tilt_deg=max((tilt for tilt in tilts if math.isfinite(tilt)), default=math.nan),
    )
    pitch = xmp.get_number(schema, "Pitch")
    if not math.isnan(drone.pitch_deg) or math.isnan(pitch):
        return drone
    return replace(
        drone,
        yaw_deg=xmp.get_number(schema, "Yaw"),
        pitch_deg=pitch - 90,
        roll_deg=xmp.get_number(schema, "Roll"),
        attitude_tags="Camera:Yaw/Pitch/Roll",
        camera_pitch_deg=pitch,
    )


def parse_drone_metadata(xmp: XmpPacket | None) -> DroneMetadata | None:
    """The metadata of a drone in an XMP packet; None where it has none. What is not readable is in its warnings."""
    if xmp is None:
        return None
    readers = ((DJI, _read_dji), (SKYDIO, _read_skydio), (PARROT, _read_parrot))
    drone = next((read(xmp) for namespace, read in readers if xmp.has_namespace(namespace)), None)
    for schema in CAMERA_SCHEMAS:
        if xmp.has_namespace(schema):
            return _add_camera_schema(drone or DroneMetadata(maker="Pix4D's Camera schema"), xmp, schema)
    return drone
