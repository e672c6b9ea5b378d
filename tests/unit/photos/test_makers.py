"""Packets in the form of each maker, converted to one convention."""

import math
from dataclasses import replace

import pytest

from facadelake.photos.attitude_prior import apply_dji_pitch, derive_attitude_prior, is_dji_pitch
from facadelake.photos.drone_xmp import DroneMetadata, parse_drone_metadata
from facadelake.photos.exif import ExifMetadata
from facadelake.photos.position_prior import derive_position_prior
from facadelake.photos.position_sigma import PositionSigma
from facadelake.photos.xmp import parse_packet

RDF = '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'


def packet(description: str) -> bytes:
    """An XMP packet, padded as cameras do, around rdf:Description."""
    return (
        f'<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>\n<x:xmpmeta xmlns:x="adobe:ns:meta/">{RDF}'
        f'{description}</rdf:RDF></x:xmpmeta>{" " * 200}<?xpacket end="w"?>'
    ).encode()


def read(description: str) -> DroneMetadata:
    """The metadata of the packet."""
    metadata = parse_drone_metadata(parse_packet(packet(description)))
    assert metadata is not None
    return metadata


# Zenmuse P1 on a Matrice 300 without a fix, as owners post it.
DJI_P1 = """<rdf:Description rdf:about="DJI Meta Data" xmlns:tiff="http://ns.adobe.com/tiff/1.0/"
 xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" tiff:Make="DJI" tiff:Model="ZenmuseP1" drone-dji:Version="1.4"
 drone-dji:GpsStatus="Normal" drone-dji:AltitudeType="RtkAlt" drone-dji:GpsLatitude="+29.282190206"
 drone-dji:GpsLongitude="-94.922448090" drone-dji:AbsoluteAltitude="+14.687" drone-dji:RelativeAltitude="+39.839"
 drone-dji:GimbalRollDegree="+0.00" drone-dji:GimbalYawDegree="+57.20" drone-dji:GimbalPitchDegree="-12.50"
 drone-dji:FlightRollDegree="+5.00" drone-dji:FlightYawDegree="+55.90" drone-dji:FlightPitchDegree="-7.40"
 drone-dji:CamReverse="0" drone-dji:GimbalReverse="0" drone-dji:RtkFlag="16" drone-dji:RtkStdLon="0.92389"
 drone-dji:RtkStdLat="1.08331" drone-dji:RtkStdHgt="2.54741" drone-dji:DroneSerialNumber="1ZNBJ7R0010078"/>"""

# Autel EVO II (XT705): DJI's namespace under another prefix, DJI's misspelling included.
AUTEL_NEW = """<rdf:Description rdf:about="DJI Meta Data" xmlns:tiff="http://ns.adobe.com/tiff/1.0/"
 xmlns:drone="http://www.dji.com/drone-dji/1.0/" tiff:Make="Autel Robotics" tiff:Model="XT705"
 drone:AbsoluteAltitude="+513.00" drone:RelativeAltitude="+66.10" drone:GpsLatitude="47.64368732"
 drone:GpsLongtitude="16.47592717" drone:GimbalRollDegree="+0.00" drone:GimbalYawDegree="-150.10"
 drone:GimbalPitchDegree="-30.00" drone:FlightYawDegree="-148.96" drone:CalibratedFocalLength="4404.166667"
 drone:RtkFlag="50" drone:RtkStdLon="0.01370" drone:RtkStdLat="0.01439" drone:RtkStdHgt="0.02969"/>"""

# Autel's older firmware: Pix4D's schema, the namespace without a closing slash.
AUTEL_OLD = """<rdf:Description rdf:about="Autel Robotics Meta Data" xmlns:Camera="http://pix4d.com/camera/1.0"
 Camera:Pitch="70.5" Camera:Yaw="-140.25" Camera:Roll="0.5"/>"""

# ANAFI Ai: the values of Parrot's own documentation.
PARROT = """<rdf:Description rdf:about="" xmlns:drone-parrot="http://www.parrot.com/drone-parrot/1.0/"
 xmlns:Camera="http://pix4d.com/camera/1.0/" xmlns:exif="http://ns.adobe.com/exif/1.0/">
 <exif:GPSLatitude>48,21.1367729995753N</exif:GPSLatitude><exif:GPSLongitude>2,49.15540455031244E</exif:GPSLongitude>
 <exif:GPSAltitude>4971569/65536</exif:GPSAltitude><exif:GPSAltitudeRef>0</exif:GPSAltitudeRef>
 <Camera:GPSXYAccuracy>845389/2097152</Camera:GPSXYAccuracy><Camera:GPSZAccuracy>5117051/8388608</Camera:GPSZAccuracy>
 <Camera:Roll>-0.041258</Camera:Roll><Camera:Pitch>38.011101</Camera:Pitch><Camera:Yaw>146.781036</Camera:Yaw>
 <Camera:AboveGroundAltitude>11485529/262144</Camera:AboveGroundAltitude>
 <Camera:FlightUUID>E424837D31F3240CFB94681E1D293DE3</Camera:FlightUUID>
 <drone-parrot:CameraRollDegree>-0.052789</drone-parrot:CameraRollDegree>
 <drone-parrot:CameraPitchDegree>-51.988888</drone-parrot:CameraPitchDegree>
 <drone-parrot:CameraYawDegree>146.848038</drone-parrot:CameraYawDegree>
 <drone-parrot:SerialNumber>PI040416BA8G059745</drone-parrot:SerialNumber></rdf:Description>"""

SKYDIO_HEAD = '<rdf:Description rdf:about="" xmlns:drone-skydio="https://www.skydio.com/drone-skydio/1.0/"'
SKYDIO_ATTRIBUTES = f"""{SKYDIO_HEAD} drone-skydio:Latitude="32.4187" drone-skydio:Longitude="-110.924547"
 drone-skydio:AbsoluteAltitude="1034.441910" drone-skydio:CalibratedFocalLengthX="2376.5625"
 drone-skydio:CalibratedOpticalCenterX="2027.5"><drone-skydio:CameraOrientationNED drone-skydio:Roll="0.186841"
 drone-skydio:Pitch="-7.468572" drone-skydio:Yaw="127.444323"/><drone-skydio:CameraOrientationFLU
 drone-skydio:Roll="1.0" drone-skydio:Pitch="2.0" drone-skydio:Yaw="3.0"/></rdf:Description>"""
SKYDIO_ELEMENTS = f"""{SKYDIO_HEAD}><drone-skydio:Latitude>32.4187</drone-skydio:Latitude>
 <drone-skydio:Longitude>-110.924547</drone-skydio:Longitude>
 <drone-skydio:AbsoluteAltitude>1034.441910</drone-skydio:AbsoluteAltitude>
 <drone-skydio:CalibratedFocalLengthX>2376.5625</drone-skydio:CalibratedFocalLengthX>
 <drone-skydio:CalibratedOpticalCenterX>2027.5</drone-skydio:CalibratedOpticalCenterX>
 <drone-skydio:CameraOrientationFLU rdf:parseType="Resource"><drone-skydio:Yaw>3.0</drone-skydio:Yaw>
 </drone-skydio:CameraOrientationFLU>
 <drone-skydio:CameraOrientationNED rdf:parseType="Resource"><drone-skydio:Roll>0.186841</drone-skydio:Roll>
 <drone-skydio:Pitch>-7.468572</drone-skydio:Pitch><drone-skydio:Yaw>127.444323</drone-skydio:Yaw>
 </drone-skydio:CameraOrientationNED></rdf:Description>"""

# senseFly eBee X with a Duet T, RTK.
SENSEFLY = """<rdf:Description rdf:about="" xmlns:Camera="http://ns.sensefly.com/Camera/1.0/"><Camera:Pitch>13.811229
 </Camera:Pitch><Camera:Roll>-6.932620</Camera:Roll><Camera:Yaw>-146.946594</Camera:Yaw>
 <Camera:GPSXYAccuracy>0.024764</Camera:GPSXYAccuracy><Camera:GPSZAccuracy>0.036845</Camera:GPSZAccuracy>
 <Camera:IMURollAccuracy>5</Camera:IMURollAccuracy><Camera:IMUPitchAccuracy>4</Camera:IMUPitchAccuracy>
 <Camera:IMUYawAccuracy>10</Camera:IMUYawAccuracy></rdf:Description>"""


def test_dji_the_gimbals_attitude_not_the_aircrafts() -> None:
    metadata = read(DJI_P1)
    assert (metadata.yaw_deg, metadata.pitch_deg, metadata.roll_deg) == (57.2, -12.5, 0.0)
    assert (metadata.lat_deg, metadata.lon_deg) == (29.282190206, -94.92244809)
    assert (metadata.absolute_altitude_m, metadata.relative_altitude_m) == (14.687, 39.839)
    assert (metadata.body, metadata.gps_status, metadata.rtk_flag) == ("1ZNBJ7R0010078", "Normal", 16)


def test_dji_without_a_fix_has_a_drones_sigma_whatever_altitude_type_says() -> None:
    prior = derive_position_prior(read(DJI_P1), ExifMetadata())
    assert (prior.sigma, prior.height_datum) == (PositionSigma(horizontal_m=3.0, vertical_m=5.0), "unknown")
    assert prior.evidence == (
        "XMP position, a drone's receiver without corrections (RtkFlag 16); XMP RtkAlt height of unknown datum"
    )


def test_an_invalid_gps_status_of_dji_discards_the_position() -> None:
    prior = derive_position_prior(read(DJI_P1.replace('GpsStatus="Normal"', 'GpsStatus="Invalid"')), ExifMetadata())
    assert (prior.source, prior.reason) == ("none", "XMP: GpsStatus is Invalid; EXIF: no position")


@pytest.mark.parametrize("flag", [32, 34, 49])
def test_all_flags_from_32_to_49_are_float(flag: int) -> None:
    prior = derive_position_prior(read(DJI_P1.replace('RtkFlag="16"', f'RtkFlag="{flag}"')), ExifMetadata())
    assert prior.sigma == PositionSigma(horizontal_m=1.08331, vertical_m=2.54741)  # as stated: worse than assumed
    assert f"RtkFlag {flag} (float)" in prior.evidence
    better = replace(read(DJI_P1), rtk_flag=flag, rtk_std_lon_m=0.1, rtk_std_lat_m=0.1, rtk_std_height_m=0.2)
    prior = derive_position_prior(better, ExifMetadata())
    assert prior.sigma == PositionSigma(horizontal_m=0.5, vertical_m=1.0)


def test_autels_newer_firmware_writes_djis_tags() -> None:
    metadata = read(AUTEL_NEW)
    assert (metadata.lat_deg, metadata.lon_deg) == (47.64368732, 16.47592717)
    assert (metadata.yaw_deg, metadata.pitch_deg, metadata.rtk_flag) == (-150.1, -30.0, 50)
    assert metadata.calibrated_focal_px == 4404.166667
    assert derive_position_prior(metadata, ExifMetadata()).sigma == PositionSigma(
        horizontal_m=0.01439, vertical_m=0.02969
    )


def test_autels_older_firmware_measures_pitch_from_nadir() -> None:
    metadata = read(AUTEL_OLD)
    assert (metadata.yaw_deg, metadata.pitch_deg, metadata.roll_deg) == (-140.25, -19.5, 0.5)
    assert math.isnan(metadata.lat_deg)  # the position is in EXIF alone


def test_a_negative_camera_pitch_implies_djis_convention() -> None:
    """Autel's XL715 writes 0 at the horizon; one photograph below it decides for all of that camera."""
    level, down = (read(AUTEL_OLD.replace("70.5", pitch)) for pitch in ("0.0", "-30.0"))
    assert not is_dji_pitch([70.5, 0.0, math.nan])
    assert is_dji_pitch([level.camera_pitch_deg, down.camera_pitch_deg])
    assert [apply_dji_pitch(metadata).pitch_deg for metadata in (level, down)] == [0.0, -30.0]


def test_parrot_writes_one_attitude_in_two_conventions() -> None:
    """Parrot's documentation gives both for one photograph: they must come out alike."""
    metadata = read(PARROT)
    assert (metadata.yaw_deg, metadata.pitch_deg, metadata.roll_deg) == (146.848038, -51.988888, -0.052789)
    camera = read(PARROT.replace("drone-parrot:Camera", "drone-parrot:Other"))
    assert camera.attitude_tags == "Camera:Yaw/Pitch/Roll"
    assert (camera.yaw_deg, camera.pitch_deg, camera.roll_deg) == pytest.approx(
        (metadata.yaw_deg, metadata.pitch_deg, metadata.roll_deg), rel=0, abs=0.1
    )  # deg


def test_parrots_position_is_in_the_exif_schema_with_its_own_estimate_of_accuracy() -> None:
    metadata = read(PARROT)
    assert metadata.lat_deg == pytest.approx(48 + 21.1367729995753 / 60, rel=0, abs=1e-12)  # deg
    assert metadata.lon_deg == pytest.approx(2 + 49.15540455031244 / 60, rel=0, abs=1e-12)  # deg
    assert metadata.absolute_altitude_m == pytest.approx(75.86, rel=0, abs=0.01)  # m
    assert (metadata.body, metadata.flight_id) == ("PI040416BA8G059745", "E424837D31F3240CFB94681E1D293DE3")
    prior = derive_position_prior(metadata, ExifMetadata(make="Parrot", model="ANAFI Ai"))
    assert prior.sigma == PositionSigma(horizontal_m=1.0, vertical_m=2.0)  # 0.40 and 0.61 m leave reflections out
    assert prior.evidence.startswith("XMP position, GPSXYAccuracy 0.403 m, GPSZAccuracy 0.61 m")
    assert prior.height_datum == "ellipsoidal"
    south = read(PARROT.replace("9995753N", "9995753S").replace("<exif:GPSAltitudeRef>0", "<exif:GPSAltitudeRef>1"))
    assert (south.lat_deg, south.absolute_altitude_m) == (-metadata.lat_deg, -metadata.absolute_altitude_m)


@pytest.mark.parametrize("form", [SKYDIO_ATTRIBUTES, SKYDIO_ELEMENTS])
def test_skydio_writes_structures_in_two_forms(form: str) -> None:
    metadata = read(form)
    assert (metadata.yaw_deg, metadata.pitch_deg, metadata.roll_deg) == (127.444323, -7.468572, 0.186841)
    assert (metadata.lat_deg, metadata.lon_deg, metadata.absolute_altitude_m) == (32.4187, -110.924547, 1034.44191)
    # the factory's centre 2027.5 of a 4056 px wide photograph counts from the centre of the first pixel
    assert (metadata.calibrated_focal_px, metadata.calibrated_width_px) == (2376.5625, 4056.0)
    assert derive_position_prior(metadata, ExifMetadata()).height_datum == "unknown"


def test_sensefly_states_all_sigmas() -> None:
    metadata = read(SENSEFLY)
    assert metadata.pitch_deg == pytest.approx(-76.188771, rel=0, abs=1e-9)  # deg
    prior = derive_position_prior(metadata, ExifMetadata(lat_deg=46.5, lon_deg=6.5, altitude_m=500.0))
    assert (prior.source, prior.sigma) == ("exif", PositionSigma(horizontal_m=0.024764, vertical_m=0.036845))
    attitude = derive_attitude_prior(metadata, ExifMetadata())
    assert attitude.sigma_tilt_deg == 5.0
    assert attitude.sigma_yaw_deg == pytest.approx(10 / math.cos(math.radians(76.188771)), rel=0, abs=1e-6)  # deg


def test_a_packet_of_an_editor_or_a_phone_is_no_drones() -> None:
    editor = parse_packet(packet('<rdf:Description xmlns:e="http://ns.adobe.com/exif/1.0/" e:A="1"/>'))
    assert parse_drone_metadata(editor) is None


def test_fractions_bad_numbers_and_deep_nesting() -> None:
    xmp = parse_packet(
        packet('<rdf:Description xmlns:n="urn:n/" n:a="527/100" n:b="1/0" n:c="inf" n:d="x" n:e=" +2 "/>')
    )
    assert xmp is not None
    assert [xmp.get_number("urn:n", name) for name in "ae"] == [5.27, 2.0]
    assert all(math.isnan(xmp.get_number("urn:n", name)) for name in "bcdz")
    deep = parse_packet(packet('<n:a xmlns:n="urn:n">' * 5000 + "1" + "</n:a>" * 5000))
    assert deep is not None
    assert len(deep.properties) == 0
