"""Registered observations as arrays: the input of merging and triangulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from facadelake.core.arrays import (
    Float64Array,
    Float64N,
    Float64Nx3,
    Float64Nx3x3,
    Float64Nx4,
    Float64Nx6x6,
    Float64x6x6,
    RowIndices,
)
from facadelake.core.camera import PosedCamera
from facadelake.registration import compute_tangents
from schemas.vocabulary import DefectClass

CLASSES = [str(name) for name in DefectClass]
_NO_BOX = np.full(4, np.nan)


@dataclass(frozen=True, kw_only=True, eq=False)
class ObservationArrays:
    """Registered observations as arrays (n rows), in a fixed order.

    ``ray_site`` (n, 3): unit direction from the camera to the position, ``distance_m`` (n,) away. ``photo`` and
    ``defect_class`` (n,) are codes, the latter into ``CLASSES``. ``box_img`` (n, 4): x, y, width, height in pixels, NaN
    where unknown. ``pose_covariance_m2`` (n, 3, 3): covariance of the position due to the photograph's pose; zero where
    the pose has none.
    """

    xyz_site_m: Float64Nx3
    normal_site: Float64Nx3
    ray_site: Float64Nx3
    distance_m: Float64N
    width_m: Float64N
    height_m: Float64N
    gsd_m: Float64N
    photo: RowIndices
    defect_class: RowIndices
    box_img: Float64Nx4
    pose_covariance_m2: Float64Nx3x3

    def __len__(self) -> int:
        return len(self.photo)

    @property
    def half_diagonal_m(self) -> Float64N:
        """Half the diagonal of each patch's extents (n,)."""
        half: Float64Array = np.hypot(self.width_m, self.height_m) / 2
        return half

    def take(self, rows: RowIndices) -> ObservationArrays:
        """Some of the observations."""
        return ObservationArrays(**{field.name: getattr(self, field.name)[rows] for field in fields(ObservationArrays)})

    def compute_tangents(self) -> tuple[Float64Nx3, Float64Nx3]:
        """Unit horizontal and upward tangents (n, 3) of the surface at each observation."""
        return compute_tangents(self.normal_site)


def concatenate_observations(parts: Sequence[ObservationArrays]) -> ObservationArrays:
    """Observations one after the other."""
    return ObservationArrays(
        **{field.name: np.concatenate([getattr(p, field.name) for p in parts]) for field in fields(ObservationArrays)}
    )


def read_column(table: pa.Table, name: str) -> Float64N:
    """A numeric column as float64 (n,); empty values are NaN."""
    values: Float64Array = table.column(name).to_numpy().astype(np.float64)
    return values


def read_columns(table: pa.Table, *names: str) -> Float64Array:
    """Numeric columns side by side (n, k)."""
    return np.column_stack([read_column(table, name) for name in names]) if len(table) else np.zeros((0, len(names)))


def encode_column(table: pa.Table, name: str) -> tuple[RowIndices, list[str | None]]:
    """A text column as codes (n,), and the values of the codes in ascending order.

    An empty value is the first value, None.
    """
    encoded = pc.dictionary_encode(table.column(name).combine_chunks(), null_encoding="encode")
    values = encoded.dictionary.to_pylist()
    order = sorted(range(len(values)), key=lambda i: (values[i] is not None, values[i] or ""))
    rank = np.empty(len(values), dtype=np.int64)
    rank[order] = np.arange(len(values))
    indices = encoded.indices.to_numpy(zero_copy_only=False).astype(np.int64)
    return rank[indices] if len(values) else indices, [values[i] for i in order]


def read_observations(
    registered: pa.Table,
    detections: pa.Table,
    posed: Mapping[str, PosedCamera],
    covariances: Mapping[str, Float64x6x6],
) -> ObservationArrays:
    """Registered rows of table ``observations`` as arrays, in their order.

    Args:
        registered: the registered rows.
        detections: table ``detections``, for the boxes.
        posed: cameras of the localised photographs by photo_id.
        covariances: covariances (6, 6) of poses by photo_id: centre (m, site), attitude (rad, about the camera's axes).
    """
    photo, photos = encode_column(registered, "photo_id")
    names = [str(name) for name in photos]
    centres = np.array([posed[name].centre_site_m for name in names]).reshape(-1, 3)
    rotations = np.array([posed[name].site_from_cam.rotation for name in names]).reshape(-1, 3, 3)
    pose_covariances = np.array([covariances.get(name, np.zeros((6, 6))) for name in names]).reshape(-1, 6, 6)
    xyz = read_columns(registered, "x_site_m", "y_site_m", "z_site_m")
    offset = xyz - centres[photo]
    distance = np.linalg.norm(offset, axis=1)
    classes = np.array(CLASSES)
    name_code, name_values = encode_column(registered, "defect_class")
    class_of_name = np.array([int(np.flatnonzero(classes == name)[0]) for name in name_values], dtype=np.int64)
    box = np.tile(_NO_BOX, (len(registered), 1))
    matched = pc.index_in(
        registered.column("detection_id").combine_chunks(), detections.column("detection_id").combine_chunks()
    )
    valid = np.flatnonzero(matched.is_valid().to_numpy(zero_copy_only=False))
    rows = matched.fill_null(0).to_numpy(zero_copy_only=False)[valid]
    box[valid] = read_columns(detections, "box_x_px", "box_y_px", "box_width_px", "box_height_px")[rows]
    return ObservationArrays(
        xyz_site_m=xyz,
        normal_site=read_columns(registered, "normal_x", "normal_y", "normal_z"),
        ray_site=offset / distance[:, None],
        distance_m=distance,
        width_m=read_column(registered, "width_m"),
        height_m=read_column(registered, "height_m"),
        gsd_m=read_column(registered, "gsd_mm") / 1000,
        photo=photo,
        defect_class=class_of_name[name_code] if len(name_code) else name_code,
        box_img=box,
        pose_covariance_m2=_propagate_pose_covariance(offset, photo, rotations, pose_covariances),
    )


def _propagate_pose_covariance(
    offset: Float64Nx3, photo: RowIndices, rotations: Float64Nx3x3, pose_covariances: Float64Nx6x6
) -> Float64Nx3x3:
    """Covariance of positions due to the poses of their photographs.

    Args:
        offset: offsets (n, 3) of the positions from their cameras' centres, in site.
        photo: photograph (n,) of each position.
        rotations: rotations (p, 3, 3) of the photographs, site from camera.
        pose_covariances: covariances (p, 6, 6) of their poses.

    Returns:
        Covariances (n, 3, 3) in m2, in site.
    """
    out = np.zeros((len(offset), 3, 3))
    for index in np.flatnonzero(np.abs(pose_covariances).sum(axis=(1, 2)) > 0):
        rows = np.flatnonzero(photo == index)
        # site_from_cam (I + [w]x) xyz_cam: a rotation w about the axis k of the camera shifts it by axis k x offset.
        shift_by_attitude = np.cross(rotations[index].T[None], offset[rows, None, :]).transpose(0, 2, 1)
        shift_by_pose = np.concatenate([np.broadcast_to(np.eye(3), shift_by_attitude.shape), shift_by_attitude], axis=2)
        out[rows] = shift_by_pose @ pose_covariances[index] @ shift_by_pose.transpose(0, 2, 1)
    return out
