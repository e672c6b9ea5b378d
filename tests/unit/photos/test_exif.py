"""EXIF as cameras and phones write it: accuracy, direction, serial numbers, time, steps."""

import io
import math
from datetime import UTC, datetime

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from facadelake.photos.attitude_prior import derive_attitude_prior
from facadelake.photos.drone_xmp import DroneMetadata
from facadelake.photos.exif import ExifMetadata, read_exif
from facadelake.photos.position_prior import PositionPrior, derive_position_prior
from facadelake.photos.position_sigma import PositionSigma

Tags = dict[int, object]


def exif_of(gps: Tags | None = None, detail: Tags | None = None, head: Tags | None = None) -> ExifMetadata:
    """The block through a JPEG of 64 px, as a camera would have written it."""
    exif = Image.Exif()
    exif.update(head or {})
    exif.get_ifd(0x8769).update(detail or {})
    exif.get_ifd(0x8825).update(gps or {})
    out = io.BytesIO()
    Image.fromarray(np.zeros((48, 64, 3), dtype=np.uint8)).save(out, "JPEG", exif=exif)
    with Image.open(out) as image:
        return read_exif(image.getexif(), width_px=64)


def ratios(*values: tuple[int, int]) -> tuple[IFDRational, ...]:
    """EXIF rationals."""
    return tuple(IFDRational(*value) for value in values)


PLACE: Tags = {
    1: "S", 2: ratios((33, 1), (51, 1), (2412, 100)),
    3: "W", 4: ratios((70, 1), (39, 1), (4567, 100)),
    5: b"\0", 6: IFDRational(5701, 10),
}  # fmt: skip


def prior_of(**gps: object) -> PositionPrior:
    """The prior of PLACE with some tags (by ``t`` and number) added."""
    return derive_position_prior(None, exif_of(PLACE | {int(name[1:]): value for name, value in gps.items()}))


def test_a_phone_states_its_error_its_direction_and_its_lens() -> None:
    """An iPhone's tags."""
    exif = exif_of(
        PLACE | {16: "T", 17: IFDRational(2345678, 10000), 31: IFDRational(47, 10)},
        {
            36867: "2026:04:14 10:00:05",
            36881: "-03:00",
            37521: "125",
            42036: "iPhone 15 Pro back triple camera 6.765mm",
        },
        {271: "Apple", 272: "iPhone 15 Pro"},
    )
    assert (exif.make, exif.lens_model) == ("Apple", "iPhone 15 Pro back triple camera 6.765mm")
    assert exif.taken_at == datetime(2026, 4, 14, 13, 0, 5, 125000, tzinfo=UTC)
    prior = derive_position_prior(None, exif)
    assert (prior.lat_deg, prior.lon_deg) == pytest.approx((-33.8567, -70.662686), rel=0, abs=1e-6)  # deg
    assert prior.sigma == PositionSigma(horizontal_m=4.7, vertical_m=9.4)
    assert prior.evidence == "EXIF position, GPSHPositioningError 4.7 m; EXIF height of unknown datum"
    attitude = derive_attitude_prior(None, exif)
    assert attitude.yaw_deg == pytest.approx(234.5678 - 360, rel=0, abs=1e-6)  # deg
    assert attitude.evidence == "EXIF GPSImgDirection (true north)"


def test_a_camera_states_its_body_and_its_focal_plane() -> None:
    """A Sony with pixels a centimetre, magnetic direction."""
    exif = exif_of(
        PLACE | {16: "M", 17: IFDRational(90, 1)},
        {37386: IFDRational(35, 1), 41486: IFDRational(22222, 10), 41488: 3, 40962: 64, 42033: "04512345"},
    )
    assert exif.body_serial == "04512345"
    assert exif.focal_plane_focal_px == pytest.approx(35 * 222.22, rel=0, abs=1e-6)  # px
    assert derive_attitude_prior(None, exif).evidence == "EXIF GPSImgDirection (magnetic north)"
    resized = exif_of({}, {37386: IFDRational(35, 1), 41486: IFDRational(22222, 10), 41488: 3, 40962: 6000})
    assert math.isnan(resized.focal_plane_focal_px)


def test_dilution_of_precision_widens_and_never_narrows() -> None:
    assert prior_of(t11=IFDRational(8, 10)).sigma == PositionSigma(horizontal_m=5.0, vertical_m=10.0)
    assert prior_of(t11=IFDRational(4, 1)).sigma == PositionSigma(horizontal_m=12.0, vertical_m=24.0)


@pytest.mark.parametrize(
    ("tag", "value", "sigma", "warning"),
    [
        ("t9", "V", PositionSigma(horizontal_m=50.0, vertical_m=50.0), "GPSStatus is V (void)"),
        ("t10", "2", PositionSigma(horizontal_m=5.0, vertical_m=50.0), "the height is not measured"),
        ("t18", "TOKYO", PositionSigma(horizontal_m=500.0, vertical_m=50.0), "GPSMapDatum is TOKYO, read as WGS 84"),
        ("t18", "OSGB36", PositionSigma(horizontal_m=500.0, vertical_m=50.0), "name the CRS of the positions in crs"),
    ],
)
def test_a_poor_fix_increases_sigma_and_is_warned_about(
    tag: str, value: str, sigma: PositionSigma, warning: str
) -> None:
    prior = prior_of(**{tag: value})
    assert prior.sigma == sigma
    assert len(prior.warnings) == 1
    assert warning in prior.warnings[0]
    for datum in ("WGS-84", "WGS 84", "World Geodetic System 1984", "JGD2011", "ETRS89"):
        assert prior_of(t9="A", t10="3", t18=datum).warnings == ()


def test_the_sigma_of_a_position_covers_the_resolution_it_is_written_in() -> None:
    coarse = ratios((33, 1), (51, 1), (24, 1))
    prior = prior_of(t2=coarse, t4=coarse)
    # a second of arc is 30.9 m: 8.9 m rms, and the receiver's 5 m
    assert prior.sigma.horizontal_m == pytest.approx(math.hypot(5.0, 30.92 / math.sqrt(12)), rel=0, abs=0.01)  # m
    assert prior.warnings == ("the position is written in steps of 31 m",)
    minutes = exif_of(
        PLACE | {2: ratios((33, 1), (514020, 10000), (0, 1)), 4: ratios((70, 1), (396543, 10000), (0, 1))}
    )
    assert minutes.position_step_deg * 111_320 < 1.0  # m


def test_gps_time_is_the_receivers() -> None:
    clock = ratios((13, 1), (0, 1), (45, 10))
    assert exif_of(PLACE | {7: clock, 29: "2026:04:14"}).gps_time == datetime(2026, 4, 14, 13, 0, 4, 500000, tzinfo=UTC)
    assert exif_of(PLACE | {7: clock, 29: "0000:00:00"}).gps_time is None


def test_xmp_is_used_and_a_different_exif_value_is_warned_about() -> None:
    drone = DroneMetadata(maker="DJI", lat_deg=-33.8567, lon_deg=-70.6627, absolute_altitude_m=-30.04)
    close = ExifMetadata(lat_deg=-33.8567, lon_deg=-70.66271, altitude_m=-30.0)
    assert derive_position_prior(drone, close).warnings == ()
    prior = derive_position_prior(drone, ExifMetadata(lat_deg=-33.8567, lon_deg=-70.66, altitude_m=30.04))
    assert (prior.source, prior.lon_deg, prior.height_m) == ("xmp", -70.6627, -30.04)
    asked = "XMP is used, its sigma covers both; set 'positions: exif' or 'positions: xmp' in the portfolio"
    assert prior.warnings == (
        "the positions disagree by 249.60 m, beyond their sigmas (4.2 m): XMP lat -33.85670000, lon -70.66270000; "
        f"EXIF lat -33.85670000, lon -70.66000000; {asked}",
        "the heights disagree by 60.08 m, beyond their sigmas (7.1 m), as with the sign changed: XMP -30.04 m; "
        f"EXIF 30.04 m; {asked}",
    )
    assert prior.sigma.horizontal_m == pytest.approx(249.6, rel=0, abs=0.1)  # m
    assert prior.sigma.vertical_m == pytest.approx(60.1, rel=0, abs=0.1)  # m


def test_a_damaged_block_gives_empty_values() -> None:
    assert repr(read_exif(Image.Exif(), width_px=64)) == repr(ExifMetadata())  # NaN is not equal to itself
    damaged = exif_of({2: ratios((48, 1)), 4: ratios((8, 1), (24, 1))}, {36867: "yesterday", 37521: "abc", 41488: 9})
    assert (damaged.taken_at, math.isnan(damaged.lat_deg), math.isnan(damaged.altitude_m)) == (None, True, True)
