"""Attitudes near nadir, compasses; and the order of sources of the focal length."""

import math
from dataclasses import replace

import pytest

from facadelake.photos.attitude_prior import derive_attitude_prior
from facadelake.photos.drone_xmp import DewarpCalibration, DroneMetadata
from facadelake.photos.exif import ExifMetadata
from facadelake.photos.lenses.focal_prior import derive_focal_prior

NOTHING = ExifMetadata()
GIMBAL = DroneMetadata(maker="DJI", yaw_deg=10.0, pitch_deg=-20.0, roll_deg=0.0, attitude_tags="Gimbal*Degree")
DEWARP = DewarpCalibration(
    fx_px=3678.87, fy_px=3671.84, centre_x_px=10.1, centre_y_px=27.29, k1=-0.27, k2=0.11, p1=0.0, p2=0.0, k3=-0.04
)


@pytest.mark.parametrize(("pitch", "sigma"), [(0.0, 5.0), (-60.0, 10.0), (60.0, 10.0), (-89.0, 180.0), (-90.0, 180.0)])
def test_sigma_of_yaw_grows_towards_nadir_and_sigma_of_tilt_does_not(pitch: float, sigma: float) -> None:
    prior = derive_attitude_prior(replace(GIMBAL, pitch_deg=pitch), NOTHING)
    assert prior.sigma_yaw_deg == pytest.approx(sigma, rel=0, abs=1e-6)  # deg
    assert prior.sigma_tilt_deg == 1.0


@pytest.mark.parametrize(
    ("yaw", "same"), [(190.0, -170.0), (-180.0, 180.0), (180.0, 180.0), (359.5, -0.5), (47.8, 47.8)]
)
def test_yaw_is_brought_into_one_turn(yaw: float, same: float) -> None:
    assert derive_attitude_prior(replace(GIMBAL, yaw_deg=yaw), NOTHING).yaw_deg == pytest.approx(
        same, rel=0, abs=1e-9
    )  # deg


@pytest.mark.parametrize(
    ("changed", "warning"),
    [
        ({"yaw_deg": 0.0, "pitch_deg": 0.0}, "Gimbal*Degree are all 0"),
        ({"upside_down": True}, "upside down"),
        ({"pitch_deg": 700.0}, "out of range"),
        ({"roll_deg": math.nan}, ""),
    ],
)
def test_an_unusable_attitude_is_none_with_a_warning(changed: dict[str, float], warning: str) -> None:
    prior = derive_attitude_prior(replace(GIMBAL, **changed), NOTHING)
    assert math.isnan(prior.yaw_deg)
    assert math.isnan(prior.sigma_yaw_deg)
    assert warning in prior.warning
    assert bool(warning) == bool(prior.warning)


@pytest.mark.parametrize(("magnetic", "sigma"), [(False, 15.0), (True, 25.0)])
def test_a_compass_gives_yaw_alone(magnetic: bool, sigma: float) -> None:
    prior = derive_attitude_prior(None, ExifMetadata(direction_deg=200.0, direction_magnetic=magnetic))
    assert (prior.yaw_deg, prior.sigma_yaw_deg) == (-160.0, sigma)
    assert math.isnan(prior.pitch_deg)
    assert math.isnan(prior.sigma_tilt_deg)
    assert prior.evidence == f"EXIF GPSImgDirection ({'magnetic' if magnetic else 'true'} north)"


def test_without_a_gimbals_attitude_the_aircrafts_nose_is_better_than_nothing() -> None:
    drone = replace(GIMBAL, yaw_deg=0.0, pitch_deg=0.0, aircraft_yaw_deg=-148.96)
    prior = derive_attitude_prior(drone, NOTHING)
    assert (prior.yaw_deg, prior.sigma_yaw_deg, math.isnan(prior.pitch_deg)) == (-148.96, 30.0, True)
    assert prior.evidence == "XMP FlightYawDegree (the aircraft's)"
    assert "are all 0" in prior.warning
    assert derive_attitude_prior(replace(GIMBAL, aircraft_yaw_deg=99.0), NOTHING).yaw_deg == 10.0


def test_calibration_goes_before_design_before_the_focal_plane_before_the_35_mm_equivalent() -> None:
    size = {"width_px": 5472, "height_px": 3648}
    exif = ExifMetadata(focal_length_35mm_mm=24.0)
    plane = replace(exif, focal_plane_focal_px=3650.0)
    designed = DroneMetadata(maker="DJI", calibrated_focal_px=3666.5, calibrated_width_px=5472.0)
    dewarp = replace(designed, dewarp=DEWARP)
    found = [
        derive_focal_prior(None, exif, **size),
        derive_focal_prior(None, plane, **size),
        derive_focal_prior(designed, plane, **size),
        derive_focal_prior(dewarp, plane, **size),
    ]
    # 24 mm of 43.267 mm, times 6576.6 px
    assert [prior.px for prior in found] == pytest.approx([3648.0, 3650.0, 3666.5, 3675.355], rel=0, abs=0.1)  # px
    assert [prior.sigma_px for prior in found] == pytest.approx([218.9, 73.0, 110.0, 11.0], rel=0, abs=0.1)  # px
    assert [prior.warning for prior in found] == [""] * 4
    assert found[3].calibration == "3678.87, 3671.84, 2746.1, 1851.29, -0.27, 0.11, 0, 0, -0.04"
    assert math.isnan(derive_focal_prior(None, NOTHING, **size).px)


def test_a_resized_photograph_scales_the_calibration() -> None:
    drone = DroneMetadata(maker="DJI", calibrated_width_px=5472.0, dewarp=DEWARP)
    prior = derive_focal_prior(drone, NOTHING, width_px=2736, height_px=1824)
    assert prior.px == pytest.approx(3675.355 / 2, rel=0, abs=1e-6)  # px
    assert prior.evidence == "XMP DewarpData, scaled by 0.5000 to the stored size"
    cx, cy = (float(number) for number in prior.calibration.split(",")[2:4])
    assert (cx, cy) == pytest.approx((1368 + 5.05, 912 + 13.645), rel=0, abs=1e-6)  # px


def test_a_photograph_dewarped_in_the_camera_has_no_distortion_left_to_state() -> None:
    drone = DroneMetadata(maker="DJI", calibrated_width_px=5472.0, dewarp=DEWARP, dewarped=True)
    prior = derive_focal_prior(drone, NOTHING, width_px=5472, height_px=3648)
    assert (prior.calibration, prior.sigma_px) == ("", pytest.approx(73.5, rel=0, abs=0.1))  # px


def test_a_calibration_of_another_zoom_is_not_used() -> None:
    drone = DroneMetadata(maker="DJI", calibrated_focal_px=3666.5)
    prior = derive_focal_prior(drone, ExifMetadata(focal_length_35mm_mm=96.0), width_px=5472, height_px=3648)
    assert prior.evidence == "EXIF FocalLengthIn35mmFilm 96 mm"
    assert prior.warning == (
        "focal length: XMP CalibratedFocalLength gives 3666 px, EXIF FocalLengthIn35mmFilm 96 mm 14592 px; "
        "the former belongs to another zoom or image size and is not used"
    )


def test_a_nonsensical_focal_plane_gives_way_to_the_35_mm_equivalent() -> None:
    exif = ExifMetadata(focal_length_35mm_mm=26.0, focal_plane_focal_px=120.0)
    prior = derive_focal_prior(None, exif, width_px=4032, height_px=3024)
    assert prior.px == pytest.approx(3028.6, rel=0, abs=0.1)  # px
    assert "FocalPlaneXResolution gives 120 px" in prior.warning
