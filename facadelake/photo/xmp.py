"""DJI's XMP packet: position, attitude and RTK state, in the attribute form and the element form."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element, ParseError

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

DJI = "{http://www.dji.com/drone-dji/1.0/}"
_PACKET = re.compile(rb"<x:xmpmeta\b.*?</x:xmpmeta>", re.DOTALL)


@dataclass(frozen=True, kw_only=True)
class DroneMetadata:
    """What DJI's packet says; NaN where it says nothing.

    Latitude and longitude in degrees (WGS 84), altitude in metres (its datum depends on the drone: see
    ``facadelake.photo.prior``), gimbal angles in degrees, ``rtk_std_*`` in metres one sigma, ``rtk_flag`` 50 fixed,
    34 float, 16 single, None where absent, ``calibrated_focal_px`` for the stored size.
    """

    lat_deg: float
    lon_deg: float
    absolute_altitude_m: float
    gimbal_yaw_deg: float
    gimbal_pitch_deg: float
    gimbal_roll_deg: float
    rtk_flag: int | None
    rtk_std_lon_m: float
    rtk_std_lat_m: float
    rtk_std_height_m: float
    calibrated_focal_px: float


def _dji_values(root: Element) -> dict[str, str]:
    values: dict[str, str] = {}
    for element in root.iter():
        for name, text in element.attrib.items():
            if name.startswith(DJI):
                values.setdefault(name.removeprefix(DJI), text)
        if element.tag.startswith(DJI) and element.text:
            values.setdefault(element.tag.removeprefix(DJI), element.text)
    return values


def _number(values: Mapping[str, str], *names: str) -> float:
    for name in names:
        if name in values:
            try:
                return float(values[name].strip())
            except ValueError:
                continue
    return math.nan


def parse_drone_metadata(packet: bytes) -> DroneMetadata | None:
    """Read a DJI packet; None where there is none or it is no well-formed XML (the photograph may still be good).

    Early firmware misspells ``GpsLongtitude``; both spellings are read.
    """
    found = _PACKET.search(packet)
    if found is None:
        return None
    try:
        values = _dji_values(fromstring(found.group()))
    except (ParseError, DefusedXmlException):
        return None
    if not values:
        return None
    flag = _number(values, "RtkFlag")
    return DroneMetadata(
        lat_deg=_number(values, "GpsLatitude"),
        lon_deg=_number(values, "GpsLongitude", "GpsLongtitude"),
        absolute_altitude_m=_number(values, "AbsoluteAltitude"),
        gimbal_yaw_deg=_number(values, "GimbalYawDegree"),
        gimbal_pitch_deg=_number(values, "GimbalPitchDegree"),
        gimbal_roll_deg=_number(values, "GimbalRollDegree"),
        rtk_flag=int(flag) if math.isfinite(flag) else None,
        rtk_std_lon_m=_number(values, "RtkStdLon"),
        rtk_std_lat_m=_number(values, "RtkStdLat"),
        rtk_std_height_m=_number(values, "RtkStdHgt"),
        calibrated_focal_px=_number(values, "CalibratedFocalLength"),
    )
