"""Focal lengths of zoomed photographs, and the cameras that they make."""

from __future__ import annotations

import math

import pytest

from facadelake.photos.lenses.focal_prior import FocalPrior
from facadelake.photos.lenses.zoom import ZoomReading, apply_zooms

SIZE = (4000, 3000)  # diagonal 5000 px; 24 mm are 2773 px
PX_24MM = 24 * 5000 / math.hypot(36, 24)


def by_35mm(mm: float, zoom: float = 1.0, calibrated_px: float = math.nan, **zooms: float) -> ZoomReading:
    px = mm * 5000 / math.hypot(36, 24)
    calibrated = FocalPrior(px=calibrated_px, sigma_px=30.0, evidence="XMP CalibratedFocalLength")
    exif = FocalPrior(px=px, sigma_px=0.06 * px, evidence=f"EXIF FocalLengthIn35mmFilm {mm:g} mm")
    tags = {"EXIF DigitalZoomRatio": zoom} | zooms
    return ZoomReading(
        camera=("S1",), size_px=SIZE, digital_zooms=tuple((t, z) for t, z in tags.items() if z > 1),
        focal_length_35mm_mm=mm, calibrated=calibrated, prior=calibrated if calibrated_px > 0 else exif,
    )  # fmt: skip


@pytest.mark.parametrize("stated_mm", [24.0, 48.0])
def test_the_other_photographs_tell_whether_the_equivalent_includes_the_zoom(stated_mm: float) -> None:
    plain, zoomed = apply_zooms([by_35mm(24.0), by_35mm(24.0), by_35mm(stated_mm, zoom=2.0)])[1:]
    assert plain.px == pytest.approx(PX_24MM)
    assert zoomed.px == pytest.approx(2 * PX_24MM)
    assert "digital zoom 2" in zoomed.evidence


def test_where_nothing_tells_the_focal_length_is_unknown_and_said_so() -> None:
    (alone,) = apply_zooms([by_35mm(24.0, zoom=2.0)])
    assert math.isnan(alone.px)
    assert "unknown whether FocalLengthIn35mmFilm 24 mm includes it" in alone.warning
    (contradiction,) = apply_zooms([by_35mm(24.0, zoom=2.0, CropFactor=3.0)])
    assert math.isnan(contradiction.px)
    assert "disagree" in contradiction.warning


@pytest.mark.parametrize("stated_mm", [24.0, 48.0])
def test_a_calibration_is_of_the_full_sensor(stated_mm: float) -> None:
    (zoomed,) = apply_zooms([by_35mm(stated_mm, zoom=2.0, calibrated_px=2800.0)])
    assert zoomed.px == pytest.approx(5600.0)
    assert zoomed.sigma_px == pytest.approx(168.0)
    (wrong,) = apply_zooms([by_35mm(90.0, zoom=2.0, calibrated_px=2800.0)])
    assert math.isnan(wrong.px)
    assert "2800 px, 5600 px with digital zoom 2" in wrong.warning


def test_another_equivalent_beside_one_calibration_is_a_zoom_that_no_tag_states() -> None:
    readings = [by_35mm(24.0, calibrated_px=2800.0)] * 3 + [by_35mm(30.0, calibrated_px=2800.0)]
    *plain, zoomed = apply_zooms(readings)
    assert [prior.px for prior in plain] == [2800.0] * 3
    assert zoomed.px == pytest.approx(3500.0)
    assert "taken as a zoom of 1.25" in zoomed.warning
    assert apply_zooms([by_35mm(24.0)] * 3 + [by_35mm(25.0, calibrated_px=2800.0)])[3].px == 2800.0  # rounding
