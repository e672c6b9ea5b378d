"""Posed cameras and the columns of table ``poses`` that store them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from facadelake.core.arrays import Float64Array
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from schemas.vocabulary import PoseSource

_INTRINSICS = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2")


def columns_from_camera(posed: PosedCamera) -> dict[str, float]:
    """Columns of table ``poses`` of a camera: projection centre, attitude and intrinsics."""
    qx, qy, qz, qw = Rotation.from_matrix(posed.site_from_cam.rotation).as_quat(canonical=True)
    x, y, z = posed.centre_site_m
    return {
        "x_site_m": float(x),
        "y_site_m": float(y),
        "z_site_m": float(z),
        "qw": float(qw),
        "qx": float(qx),
        "qy": float(qy),
        "qz": float(qz),
        **{name: float(getattr(posed.camera, name)) for name in _INTRINSICS},
    }


def read_posed_cameras(poses: pa.Table) -> dict[str, PosedCamera]:
    """The cameras with a measured pose of table ``poses``, by photo_id.

    Photographs without a pose are left out, and so are those whose pose is a prior from their metadata (``prior``): it
    is too coarse to register detections.
    """
    out = {}
    for row in poses.to_pylist():
        if PoseSource(row["pose_source"]).measured:
            out[row["photo_id"]] = _posed_camera_from_row(row)
    return out


def read_pose_covariances(poses: pa.Table) -> dict[str, Float64Array]:
    """Covariances (6, 6) of the measured poses of table ``poses`` that have one, by photo_id.

    Order: projection centre (m, ``site``), then rotation (rad) about the camera's own x, y, z axes:
    ``site_from_cam @ exp([rotation]x)``.
    """
    return {
        row["photo_id"]: np.array(row["covariance"], dtype=np.float64).reshape(6, 6)
        for row in poses.select(["photo_id", "pose_source", "covariance"]).to_pylist()
        if row["covariance"] is not None and PoseSource(row["pose_source"]).measured
    }


def _posed_camera_from_row(row: dict[str, Any]) -> PosedCamera:
    rotation = Rotation.from_quat([row["qx"], row["qy"], row["qz"], row["qw"]]).as_matrix()
    camera = Camera(
        width_px=row["image_width_px"],
        height_px=row["image_height_px"],
        **{name: row[name] for name in _INTRINSICS},
    )
    translation = pa.array([row["x_site_m"], row["y_site_m"], row["z_site_m"]]).to_numpy()
    return PosedCamera(camera=camera, site_from_cam=Similarity(rotation=rotation, translation=translation))
