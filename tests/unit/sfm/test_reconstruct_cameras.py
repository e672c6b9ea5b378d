"""Cameras of a campaign's photographs and their initial focal lengths."""

from typing import Any

import pytest

from facadelake.sfm.cameras import group_by_camera


def row(**metadata: Any) -> dict[str, Any]:
    plain = {"camera_make": "DJI", "camera_model": "M3E", "image_width_px": 4000, "image_height_px": 3000}
    return plain | {"focal_length_mm": 12.3, "focal_length_35mm_mm": 24.0} | metadata


def test_zooms_sizes_bodies_and_lenses_are_cameras_of_their_own() -> None:
    rows = [
        row(),
        row(focal_length_mm=30.0, focal_length_35mm_mm=60.0),
        row(image_width_px=2000, image_height_px=1500),
        row(camera_serial="1ZN"),
        row(camera_serial="1ZN", lens_model="wide"),
        row(),
    ]
    cameras, camera_of = group_by_camera(rows)
    assert camera_of == [0, 1, 2, 3, 4, 0]
    assert cameras[1]["focal_px"] == pytest.approx(2.5 * cameras[0]["focal_px"], rel=1e-12)
    assert cameras[2]["focal_px"] == pytest.approx(0.5 * cameras[0]["focal_px"], rel=1e-12)


def test_each_sign_of_a_zoom_or_another_lens_makes_a_camera() -> None:
    """One camera for a zoomed and a plain photograph put the zoomed ones metres off the wall."""
    calibrated = {"prior_focal_px": 3725.0}  # the same, whatever the zoom
    rows = [
        row(**calibrated, digital_zoom=1.0, exif_focal_length_35mm_mm=24.0),
        row(**calibrated, digital_zoom=2.0, exif_focal_length_35mm_mm=24.0),
        row(**calibrated, digital_zoom=1.0, exif_focal_length_35mm_mm=30.0),
        row(**calibrated, digital_zoom=1.0, exif_focal_length_35mm_mm=24.0, image_source="zoom"),
        row(**calibrated, digital_zoom=1.0, exif_focal_length_35mm_mm=24.0),
    ]
    assert group_by_camera(rows)[1] == [0, 1, 2, 3, 0]


def test_the_stated_focal_length_in_pixels_comes_first() -> None:
    """24 mm on 43.27 mm of full frame's diagonal is 0.5547 of a 5000 px diagonal."""
    cameras, camera_of = group_by_camera(
        [row(prior_focal_px=3725.15), row(prior_focal_px=3725.4), row(prior_focal_px=None)]
    )
    assert camera_of == [0, 0, 1]
    assert cameras[0] == {"width_px": 4000, "height_px": 3000, "focal_px": 3725.15, "focal_known": True}
    assert cameras[1]["focal_px"] == pytest.approx(2773.5, abs=1.0)  # px
    (guessed,), _ = group_by_camera([row(focal_length_mm=None, focal_length_35mm_mm=None)])
    assert guessed == {"width_px": 4000, "height_px": 3000, "focal_px": 4800.0, "focal_known": False}
