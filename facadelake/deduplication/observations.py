"""Registered observations as arrays: what merging and triangulation work on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from facadelake.core.arrays import Float64Array, Int64Array
from facadelake.core.camera import PosedCamera
from facadelake.registration import compute_tangents
from schemas.vocabulary import DefectClass

CLASSES = [str(name) for name in DefectClass]
_NO_BOX = np.full(4, np.nan)


@dataclass(frozen=True, kw_only=True, eq=False)
class ObservationArrays:
    """Registered observations as arrays, in a fixed order (n rows).

    ``ray_site`` (n, 3) is the unit direction from camera to place, ``distance_m`` (n,) its length. ``photo`` and
    ``defect_class`` (into ``CLASSES``) are codes. ``box_img`` (n, 4): x, y, width, height in pixels, NaN where unknown.
    ``pose_covariance_m2`` (n, 3, 3): covariance of the place by its photograph's pose; zero where none is stated.
    """

    xyz_site_m: Float64Array
    normal_site: Float64Array
    ray_site: Float64Array
    distance_m: Float64Array
    width_m: Float64Array
    height_m: Float64Array
    gsd_m: Float64Array
    photo: Int64Array
    defect_class: Int64Array
    box_img: Float64Array
    pose_covariance_m2: Float64Array

    def __len__(self) -> int:
        return len(self.photo)

    @property
    def half_diagonal_m(self) -> Float64Array:
        """Half the diagonal of each patch's extents (n,)."""
        reach: Float64Array = np.hypot(self.width_m, self.height_m) / 2
        return reach

    def compute_tangents(self) -> tuple[Float64Array, Float64Array]:
        """Unit horizontal and upward tangents (n, 3) of each sighting's surface."""
        return compute_tangents(self.normal_site)


def read_column(table: pa.Table, name: str) -> Float64Array:
    """A real column as float64, empty values as NaN."""
    values: Float64Array = table.column(name).to_numpy().astype(np.float64)
    return values


def read_columns(table: pa.Table, *names: str) -> Float64Array:
    """Real columns side by side (n, k)."""
    return np.column_stack([read_column(table, name) for name in names]) if len(table) else np.zeros((0, len(names)))


def encode_column(table: pa.Table, name: str) -> tuple[Int64Array, list[str | None]]:
    """A text column as codes into its own words, which come in order; an empty value is the word None."""
    encoded = pc.dictionary_encode(table.column(name).combine_chunks(), null_encoding="encode")
    words = encoded.dictionary.to_pylist()
    order = sorted(range(len(words)), key=lambda i: (words[i] is not None, words[i] or ""))
    place = np.empty(len(words), dtype=np.int64)
    place[order] = np.arange(len(words))
    indices = encoded.indices.to_numpy(zero_copy_only=False).astype(np.int64)
    return place[indices] if len(words) else indices, [words[i] for i in order]


def read_observations(
    seen: pa.Table,
    detections: pa.Table,
    posed: Mapping[str, PosedCamera],
    covariances: Mapping[str, Float64Array],
) -> ObservationArrays:
    """Registered rows ``seen`` of table ``observations``, in their order, with the boxes of their ``detections``.

    ``covariances`` (6, 6) by photo_id: centre (m, site) and attitude (rad, about the camera's own axes).
    """
    photo, photos = encode_column(seen, "photo_id")
    names = [str(name) for name in photos]
    centres = np.array([posed[name].centre_site_m for name in names]).reshape(-1, 3)
    turns = np.array([posed[name].site_from_cam.rotation for name in names]).reshape(-1, 3, 3)
    stated = np.array([covariances.get(name, np.zeros((6, 6))) for name in names]).reshape(-1, 6, 6)
    xyz = read_columns(seen, "x_site_m", "y_site_m", "z_site_m")
    away = xyz - centres[photo]
    distance = np.linalg.norm(away, axis=1)
    known = np.array(CLASSES)
    word, words = encode_column(seen, "defect_class")
    as_class = np.array([int(np.flatnonzero(known == name)[0]) for name in words], dtype=np.int64)
    box = np.tile(_NO_BOX, (len(seen), 1))
    at = pc.index_in(seen.column("detection_id").combine_chunks(), detections.column("detection_id").combine_chunks())
    found = np.flatnonzero(at.is_valid().to_numpy(zero_copy_only=False))
    rows = at.fill_null(0).to_numpy(zero_copy_only=False)[found]
    box[found] = read_columns(detections, "box_x_px", "box_y_px", "box_width_px", "box_height_px")[rows]
    return ObservationArrays(
        xyz_site_m=xyz,
        normal_site=read_columns(seen, "normal_x", "normal_y", "normal_z"),
        ray_site=away / distance[:, None],
        distance_m=distance,
        width_m=read_column(seen, "width_m"),
        height_m=read_column(seen, "height_m"),
        gsd_m=read_column(seen, "gsd_mm") / 1000,
        photo=photo,
        defect_class=as_class[word] if len(word) else word,
        box_img=box,
        pose_covariance_m2=_propagate_pose_covariance(away, photo, turns, stated),
    )


def _propagate_pose_covariance(
    away: Float64Array, photo: Int64Array, turns: Float64Array, stated: Float64Array
) -> Float64Array:
    """Covariance (n, 3, 3) in m2 that poses give the places ``away`` (n, 3) from their centres."""
    out = np.zeros((len(away), 3, 3))
    for number in np.flatnonzero(np.abs(stated).sum(axis=(1, 2)) > 0):
        own = np.flatnonzero(photo == number)
        # site_from_cam (I + [turn]x) xyz_cam: a turn about the camera's axis k moves the place by (axis k) x away.
        by_turn = np.cross(turns[number].T[None], away[own, None, :]).transpose(0, 2, 1)
        moved = np.concatenate([np.broadcast_to(np.eye(3), by_turn.shape), by_turn], axis=2)
        out[own] = moved @ stated[number] @ moved.transpose(0, 2, 1)
    return out
