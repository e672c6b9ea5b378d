"""DJI packets in both forms, sigmas and height datums."""

import math

import pytest

from facadelake.photos.drone_xmp import DroneMetadata, parse_drone_metadata
from facadelake.photos.exif import ExifMetadata
from facadelake.photos.position_prior import derive_position_prior
from facadelake.photos.position_sigma import (
    SIGMA_DRONE,
    SIGMA_HANDHELD,
    SIGMA_RTK_FIXED,
    SIGMA_RTK_FLOAT,
    PositionSigma,
)
from facadelake.photos.xmp import parse_packet
from schemas.vocabulary import HeightDatum, PositionSource

HEAD = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description rdf:about="" xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"'
)
ATTRIBUTES = (
    HEAD
    + ' drone-dji:GpsLatitude="+48.5" drone-dji:GpsLongtitude="8.25" drone-dji:RtkFlag="50"/></rdf:RDF></x:xmpmeta>'
)
ELEMENTS = (
    HEAD + "><drone-dji:GpsLatitude>48.5</drone-dji:GpsLatitude><drone-dji:GpsLongitude> 8.25 </drone-dji:GpsLongitude>"
    "<drone-dji:RtkFlag>50</drone-dji:RtkFlag></rdf:Description></rdf:RDF></x:xmpmeta>"
)
BOMB = '<!DOCTYPE x [<!ENTITY a "aaaa">]>'


def drone(text: str) -> DroneMetadata:
    """The packet with these attributes."""
    parsed = parse_drone_metadata(parse_packet((HEAD + f" {text}/></rdf:RDF></x:xmpmeta>").encode()))
    assert parsed is not None
    return parsed


@pytest.mark.parametrize("packet", [ATTRIBUTES, ELEMENTS, "<?xpacket?>" + ATTRIBUTES + " " * 50 + "\0"])
def test_both_forms_and_the_misspelt_longitude(packet: str) -> None:
    metadata = parse_drone_metadata(parse_packet(packet.encode()))
    assert metadata is not None
    assert (metadata.lat_deg, metadata.lon_deg, metadata.rtk_flag) == (48.5, 8.25, 50)
    assert math.isnan(metadata.absolute_altitude_m)


@pytest.mark.parametrize(
    "packet",
    [b"", b"<x:xmpmeta", HEAD.encode() + b"></x:xmpmeta>", HEAD.encode() + b"/></rdf:RDF></x:xmpmeta>",
     BOMB.encode() + b"<x:xmpmeta>&a;</x:xmpmeta>"],
)  # fmt: skip
def test_a_missing_broken_or_malicious_packet_has_no_metadata(packet: bytes) -> None:
    assert parse_drone_metadata(parse_packet(packet)) is None


PLACE = 'drone-dji:GpsLatitude="48.50000000" drone-dji:GpsLongitude="8.25000000" drone-dji:AbsoluteAltitude="200.000"'


@pytest.mark.parametrize(
    ("rtk", "sigma", "datum"),
    [
        ("", SIGMA_DRONE, HeightDatum.UNKNOWN),
        ('drone-dji:AltitudeType="RtkAlt"', SIGMA_DRONE, HeightDatum.UNKNOWN),
        ('drone-dji:RtkFlag="16"', SIGMA_DRONE, HeightDatum.UNKNOWN),
        ('drone-dji:RtkFlag="34"', SIGMA_RTK_FLOAT, HeightDatum.UNKNOWN),
        ('drone-dji:RtkFlag="50"', SIGMA_RTK_FIXED, HeightDatum.ELLIPSOIDAL),
        (
            'drone-dji:RtkFlag="50" drone-dji:RtkStdLon=".011" drone-dji:RtkStdLat=".014" drone-dji:RtkStdHgt=".021"',
            PositionSigma(horizontal_m=0.014, vertical_m=0.021),
            HeightDatum.ELLIPSOIDAL,
        ),
        (
            'drone-dji:RtkFlag="16" drone-dji:RtkStdLon=".011" drone-dji:RtkStdLat=".014" drone-dji:RtkStdHgt=".021"',
            SIGMA_DRONE,  # standard deviations without a fix mean nothing
            HeightDatum.UNKNOWN,
        ),
    ],
)
def test_sigma_and_datum_need_evidence(rtk: str, sigma: PositionSigma, datum: HeightDatum) -> None:
    prior = derive_position_prior(
        drone(f"{PLACE} {rtk}"), ExifMetadata(lat_deg=48.5, lon_deg=8.25, altitude_m=200.0, altitude_ref=0)
    )
    assert (prior.source, prior.height_m, prior.sigma, prior.height_datum) == (PositionSource.XMP, 200.0, sigma, datum)


@pytest.mark.parametrize(
    ("stated", "sigma", "datum"),
    [
        ({"altitude_ref": 0}, SIGMA_HANDHELD, HeightDatum.UNKNOWN),
        ({"altitude_ref": 2}, SIGMA_HANDHELD, HeightDatum.ELLIPSOIDAL),
        ({"position_error_m": 4.0}, PositionSigma(horizontal_m=4.0, vertical_m=8.0), HeightDatum.UNKNOWN),
    ],
)
def test_a_handheld_position(stated: dict[str, float], sigma: PositionSigma, datum: HeightDatum) -> None:
    prior = derive_position_prior(None, ExifMetadata(lat_deg=55.0, lon_deg=13.0, altitude_m=37.0, **stated))
    assert (prior.source, prior.sigma, prior.height_datum) == (PositionSource.EXIF, sigma, datum)
