"""Metadata of the photographs: EXIF with a GPS directory, and DJI's XMP."""

from __future__ import annotations

from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from facadelake.demo.photographs.flight import DemoExposure
from facadelake.demo.recipe import Optics

EXIF_IFD, GPS_IFD = 0x8769, 0x8825
XMP_HEAD = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description rdf:about="" xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" '
)
XMP_TAIL = "/></rdf:RDF></x:xmpmeta>"


def _dms_from_deg(angle_deg: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    """Degrees, minutes and seconds of the absolute value of an angle; seconds to 1e-5 (0.3 mm)."""
    units = round(abs(angle_deg) * 3600 * 10**5)
    minutes, seconds = divmod(units, 60 * 10**5)
    degrees, minutes = divmod(minutes, 60)
    return IFDRational(degrees, 1), IFDRational(minutes, 1), IFDRational(seconds, 10**5)


def encode_exif(exposure: DemoExposure, optics: Optics) -> bytes:
    """The EXIF block of a photograph: maker, time, nominal optics, position in WGS84 with ellipsoidal height."""
    lon, lat, height = (float(x) for x in exposure.tag_lon_lat_height)
    exif = Image.Exif()
    exif[0x010F], exif[0x0110], exif[0x0131] = "DJI", "FC-DEMO", "Facadelake demo"
    time = exposure.taken_at.strftime("%Y:%m:%d %H:%M:%S")
    exif[0x0132] = time
    detail = exif.get_ifd(EXIF_IFD)
    detail[0x9003] = detail[0x9004] = time
    detail[0x9011] = exposure.taken_at.strftime("%z")[:3] + ":" + exposure.taken_at.strftime("%z")[3:]
    detail[0x920A] = IFDRational(round(optics.focal_mm * 1000), 1000)
    detail[0xA405] = round(optics.focal_mm * 36.0 / (optics.width_px * optics.pitch_um / 1000))
    detail[0xA002], detail[0xA003] = optics.width_px, optics.height_px
    detail[0xA20E] = detail[0xA20F] = IFDRational(round(1e4 / optics.pitch_um * 1000), 1000)
    detail[0xA210] = 3  # unit of the two tags above: pixels per centimetre
    gps = exif.get_ifd(GPS_IFD)
    gps[0] = b"\x02\x03\x00\x00"
    gps[1], gps[2] = "N" if lat >= 0 else "S", _dms_from_deg(lat)
    gps[3], gps[4] = "E" if lon >= 0 else "W", _dms_from_deg(lon)
    gps[5], gps[6] = b"\x00" if height >= 0 else b"\x01", IFDRational(round(abs(height) * 1000), 1000)
    return bytes(exif.tobytes())


def encode_xmp(exposure: DemoExposure, takeoff_height_m: float) -> bytes:
    """DJI's XMP packet: position, gimbal and aircraft attitude; no RTK tags, as for a receiver without RTK."""
    lon, lat, height = (float(x) for x in exposure.tag_lon_lat_height)
    yaw, pitch, roll = (float(x) for x in exposure.tag_yaw_pitch_roll_deg)
    yaw = (yaw + 180) % 360 - 180
    tags = {
        "GpsStatus": "Normal",
        "AltitudeType": "GpsFusionAlt",
        "GpsLatitude": f"{lat:.8f}",
        "GpsLongitude": f"{lon:.8f}",
        "AbsoluteAltitude": f"{height:+.3f}",
        "RelativeAltitude": f"{height - takeoff_height_m:+.3f}",
        "GimbalRollDegree": f"{roll:+.2f}",
        "GimbalYawDegree": f"{yaw:+.2f}",
        "GimbalPitchDegree": f"{pitch:+.2f}",
        "FlightRollDegree": "+0.00",
        "FlightYawDegree": f"{yaw:+.2f}",
        "FlightPitchDegree": "+0.00",
    }
    return (XMP_HEAD + " ".join(f'drone-dji:{k}="{v}"' for k, v in tags.items()) + XMP_TAIL).encode()
