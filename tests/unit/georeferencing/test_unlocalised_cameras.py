"""A photograph outside the block has its own camera, not that of another lens of the same size."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from facadelake.georeferencing.poses_table import find_adjusted_cameras
from facadelake.sfm import Reconstruction
from facadelake.sfm.reconstruction import LocalisedPhoto

# Two lenses of one drone, of one size: the tele lens has 1.08 times the focal length of the wide one.
WIDE = Camera(width_px=4000, height_px=3000, fx_px=3000.0, fy_px=3000.0, cx_px=2010.0, cy_px=1490.0, k1=-0.1)
TELE = replace(WIDE, fx_px=3240.0, fy_px=3240.0, cx_px=1980.0, k1=0.05)
IDENTITY = Similarity(rotation=np.eye(3), translation=np.zeros(3))


def row_of(photo_id: str, source: str, focal_px: float | None) -> dict[str, Any]:
    """What table ``photos`` says of the camera of a photograph."""
    empty = dict.fromkeys(
        ("camera_serial", "lens_model", "focal_length_mm", "digital_zoom", "exif_focal_length_35mm_mm"), None
    )
    size = {"image_width_px": 4000, "image_height_px": 3000, "prior_focal_px": focal_px}
    stated = {"focal_length_35mm_mm": None, "prior_calibration": None}
    return (
        {"photo_id": photo_id, "camera_make": "DJI", "camera_model": "M3E", "image_source": source}
        | empty
        | size
        | stated
    )


def block(*photographs: tuple[str, Camera, float]) -> Reconstruction:
    """A block of these photographs: name, camera, and multiple of the focal length of the others by its camera."""
    return Reconstruction(
        photos=tuple(
            LocalisedPhoto(
                photo_id=name,
                camera=camera,
                sfm_from_cam=IDENTITY,
                reprojection_error_px=0.5,
                tie_points=100,
                focal_factor=factor,
            )
            for name, camera, factor in photographs
        ),
        unlocalised=(),
        xyz_sfm=np.zeros((0, 3)),
        rgb=np.zeros((0, 3), np.uint8),
        image_point_photo=np.zeros(0, np.int64),
        image_point_tie_point=np.zeros(0, np.int64),
        image_point_xy_img=np.zeros((0, 2)),
        mean_reprojection_error_px=0.5,
        costs=(),
    )


def test_the_camera_is_that_of_the_photographs_by_the_same_lens() -> None:
    """By size, and by focal lengths within 10%, the first in the block was taken: the wide one for all."""
    reconstruction = block(("w.jpg", WIDE, 1.0), ("z.jpg", replace(WIDE, fx_px=3900.0), 1.3), ("t.jpg", TELE, 1.0))
    posed = {
        photo.photo_id: PosedCamera(camera=photo.camera, site_from_cam=IDENTITY) for photo in reconstruction.photos
    }
    for focal_px in (3000.0, None):
        rows = [
            row_of(name, source, focal_px)
            for name, source in (
                *(("w.jpg", "WideCamera"), ("z.jpg", "WideCamera"), ("t.jpg", "ZoomCamera")),
                *(("lost-w.jpg", "WideCamera"), ("lost-t.jpg", "ZoomCamera"), ("lost-other.jpg", "")),
            )
        ]
        found = find_adjusted_cameras(rows, posed, reconstruction)
        assert found["lost-w.jpg"] == WIDE
        assert found["lost-t.jpg"] == TELE
        assert "lost-other.jpg" not in found  # of a camera that has no photograph in the block
