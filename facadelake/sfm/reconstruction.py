"""A reconstruction as the rest of Facadelake sees it: posed cameras and tie points in `sfm`, no pycolmap."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from facadelake.core.arrays import Float64Array, Int64Array, UInt8Array
from facadelake.core.cache import DIAGNOSTICS
from facadelake.core.camera import Camera
from facadelake.core.errors import InputDataError
from facadelake.core.frames import Similarity
from schemas.vocabulary import PoseSource


@dataclass(frozen=True, kw_only=True, eq=False)
class LocalisedPhoto:
    """A photograph in the block; ``sfm_from_cam`` has scale 1 (the frame ``sfm`` has no metre).

    ``source``: SFM where mapping placed it, RESECTED where its matches with the finished block did.
    """

    photo_id: str
    camera: Camera
    sfm_from_cam: Similarity
    reprojection_error_px: float
    tie_points: int
    source: PoseSource = PoseSource.SFM


@dataclass(frozen=True, kw_only=True)
class UnlocalisedPhoto:
    """A photograph outside the block, and why."""

    photo_id: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class StepCost:
    """Wall and processor time of a step of the reconstruction, and the process's peak memory at its end."""

    step: str
    seconds: float
    cpu_seconds: float
    peak_memory_mb: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Reconstruction:
    """The largest block.

    ``xyz_sfm`` (m, 3) tie points, ``rgb`` (m, 3) uint8; a track entry k says that photograph ``track_photo[k]`` (index
    into ``photos``) saw point ``track_point[k]`` at pixel ``track_xy_img[k]``.
    """

    photos: tuple[LocalisedPhoto, ...]
    unlocalised: tuple[UnlocalisedPhoto, ...]
    xyz_sfm: Float64Array
    rgb: UInt8Array
    image_point_photo: Int64Array
    image_point_tie_point: Int64Array
    image_point_xy_img: Float64Array
    mean_reprojection_error_px: float
    costs: tuple[StepCost, ...]

    @property
    def centres_sfm(self) -> Float64Array:
        """Projection centres (n, 3) of ``photos``."""
        return np.array([photo.sfm_from_cam.translation for photo in self.photos]).reshape(-1, 3)

    def photo(self, photo_id: str) -> LocalisedPhoto | None:
        """The localised photograph of that id, if it is one."""
        return next((photo for photo in self.photos if photo.photo_id == photo_id), None)


def _parse_localised_photo(
    said: dict[str, Any], camera: Float64Array, rotation: Float64Array, translation: Float64Array
) -> LocalisedPhoto:
    width, height, fx, fy, cx, cy, k1, k2, p1, p2 = (float(value) for value in camera)
    return LocalisedPhoto(
        photo_id=said["photo_id"],
        camera=Camera(
            width_px=int(width),
            height_px=int(height),
            fx_px=fx,
            fy_px=fy,
            cx_px=cx,
            cy_px=cy,
            k1=k1,
            k2=k2,
            p1=p1,
            p2=p2,
        ),
        sfm_from_cam=Similarity(rotation=rotation, translation=translation),
        reprojection_error_px=said["reprojection_error_px"],
        tie_points=said["tie_points"],
        source=PoseSource(said.get("source", PoseSource.SFM)),
    )


def read_reconstruction(folder: Path) -> Reconstruction:
    """Read what ``reconstruct`` left in ``folder``; raises InputDataError where there is no whole reconstruction."""
    try:
        said = json.loads((folder / "reconstruction.json").read_text(encoding="utf-8"))
        costs = json.loads((folder / DIAGNOSTICS / "costs.json").read_text(encoding="utf-8"))
        with np.load(folder / "reconstruction.npz") as loaded:
            arrays = dict(loaded)
    except (OSError, ValueError) as error:
        raise InputDataError(
            f"{folder} holds no whole reconstruction ({error}); remove the folder and run again"
        ) from error
    return Reconstruction(
        photos=tuple(
            _parse_localised_photo(photo, camera, rotation, translation)
            for photo, camera, rotation, translation in zip(
                said["photos"],
                arrays["camera"],
                arrays["sfm_from_cam_rotation"],
                arrays["sfm_from_cam_translation"],
                strict=True,
            )
        ),
        unlocalised=tuple(UnlocalisedPhoto(**photo) for photo in said["unlocalised"]),
        xyz_sfm=arrays["xyz_sfm"],
        rgb=arrays["rgb"],
        image_point_photo=arrays["image_point_photo"],
        image_point_tie_point=arrays["image_point_tie_point"],
        image_point_xy_img=arrays["image_point_xy_img"],
        mean_reprojection_error_px=said["mean_reprojection_error_px"],
        costs=tuple(StepCost(**cost) for cost in costs),
    )


def read_descriptors(folder: Path) -> UInt8Array:
    """SIFT descriptors (m, 128) of the tie points of the reconstruction in ``folder``, in the rows of ``xyz_sfm``.

    Each is the one of its track nearest to the track's mean, as COLMAP stores it: the square root of a histogram of
    sum 1, times 512 (Arandjelovic and Zisserman 2012). Raises InputDataError where the reconstruction has none.
    """
    try:
        descriptors: UInt8Array = np.load(folder / "descriptors.npy")
    except (OSError, ValueError) as error:
        raise InputDataError(
            f"{folder} holds no descriptors of its tie points ({error}); remove the folder and run again"
        ) from error
    return descriptors
