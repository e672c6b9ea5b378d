"""The result of structure from motion: posed cameras and tie points in the frame `sfm`, read without pycolmap."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from facadelake.core.arrays import Float64N, Float64Nx2, Float64Nx3, Float64x3, Float64x3x3, Int64Array, UInt8Array
from facadelake.core.cache import DIAGNOSTICS
from facadelake.core.camera import Camera
from facadelake.core.errors import InputDataError
from facadelake.core.frames import Similarity
from facadelake.sfm.step_cost import StepCost
from schemas.vocabulary import PoseSource


@dataclass(frozen=True, kw_only=True, eq=False)
class LocalisedPhoto:
    """A photograph in the block; ``sfm_from_cam`` has scale 1 (the frame ``sfm`` has no metre).

    ``source`` is SFM where mapping localised it, RESECTED where resection in the finished block did. ``focal_factor``
    is not 1 where its focal length is so many times that of the other photographs by its camera, with the factor's
    sigma: a zoom that no metadata state. It has a camera of its own then.
    """

    photo_id: str
    camera: Camera
    sfm_from_cam: Similarity
    reprojection_error_px: float
    tie_points: int
    source: PoseSource = PoseSource.SFM
    focal_factor: float = 1.0
    focal_factor_sigma: float = 0.0


@dataclass(frozen=True, kw_only=True)
class UnlocalisedPhoto:
    """A photograph outside the block, with the reason."""

    photo_id: str
    reason: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Reconstruction:
    """The largest block.

    ``xyz_sfm`` (m, 3) and ``rgb`` (m, 3) are tie points and their colours. Image point k of a tie point is in
    photograph ``image_point_photo[k]`` (index into ``photos``), shows tie point ``image_point_tie_point[k]`` (row of
    ``xyz_sfm``) and lies at pixel ``image_point_xy_img[k]``.
    """

    photos: tuple[LocalisedPhoto, ...]
    unlocalised: tuple[UnlocalisedPhoto, ...]
    xyz_sfm: Float64Nx3
    rgb: UInt8Array
    image_point_photo: Int64Array
    image_point_tie_point: Int64Array
    image_point_xy_img: Float64Nx2
    mean_reprojection_error_px: float
    costs: tuple[StepCost, ...]

    @property
    def centres_sfm(self) -> Float64Nx3:
        """Projection centres (n, 3) of ``photos``."""
        return np.array([photo.sfm_from_cam.translation for photo in self.photos]).reshape(-1, 3)

    def list_focal_deviations(self) -> list[str]:
        """A remark on the photographs with another focal length than the others by their camera, if there are any."""
        zoomed = [photo for photo in self.photos if photo.focal_factor != 1.0]
        if not zoomed:
            return []
        named = ", ".join(
            f"{photo.photo_id} {photo.focal_factor:.3f} (sigma {photo.focal_factor_sigma:.3f})" for photo in zoomed[:5]
        )
        more = f" and {len(zoomed) - 5} more" if len(zoomed) > 5 else ""
        return [
            f"{len(zoomed)} photographs have another focal length than the others by their camera (a zoom that the "
            f"metadata do not state?), in multiples: {named}{more}; they have a camera of their own in the adjustment"
        ]


def _parse_localised_photo(
    record: dict[str, Any], parameters: Float64N, rotation: Float64x3x3, translation: Float64x3
) -> LocalisedPhoto:
    """The photograph of a record of reconstruction.json and the arrays of reconstruction.npz in the same row."""
    width, height, fx, fy, cx, cy, k1, k2, p1, p2 = (float(value) for value in parameters)
    return LocalisedPhoto(
        photo_id=record["photo_id"],
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
        reprojection_error_px=record["reprojection_error_px"],
        tie_points=record["tie_points"],
        source=PoseSource(record.get("source", PoseSource.SFM)),
        focal_factor=record.get("focal_factor", 1.0),
        focal_factor_sigma=record.get("focal_factor_sigma", 0.0),
    )


def read_reconstruction(folder: Path) -> Reconstruction:
    """Read the output folder of ``reconstruct``.

    Raises InputDataError where the folder holds no complete reconstruction.
    """
    try:
        record = json.loads((folder / "reconstruction.json").read_text(encoding="utf-8"))
        costs = json.loads((folder / DIAGNOSTICS / "costs.json").read_text(encoding="utf-8"))
        with np.load(folder / "reconstruction.npz") as loaded:
            arrays = dict(loaded)
    except (OSError, ValueError) as error:
        raise InputDataError(
            f"{folder} holds no complete reconstruction ({error}); remove the folder and run again"
        ) from error
    return Reconstruction(
        photos=tuple(
            _parse_localised_photo(photo, camera, rotation, translation)
            for photo, camera, rotation, translation in zip(
                record["photos"],
                arrays["camera"],
                arrays["sfm_from_cam_rotation"],
                arrays["sfm_from_cam_translation"],
                strict=True,
            )
        ),
        unlocalised=tuple(UnlocalisedPhoto(**photo) for photo in record["unlocalised"]),
        xyz_sfm=arrays["xyz_sfm"],
        rgb=arrays["rgb"],
        image_point_photo=arrays["image_point_photo"],
        image_point_tie_point=arrays["image_point_tie_point"],
        image_point_xy_img=arrays["image_point_xy_img"],
        mean_reprojection_error_px=record["mean_reprojection_error_px"],
        costs=tuple(StepCost(**cost) for cost in costs),
    )


def read_descriptors(folder: Path) -> UInt8Array:
    """SIFT descriptors (m, 128) of the tie points of the reconstruction in ``folder``, in the rows of ``xyz_sfm``.

    Each is the descriptor nearest to the mean of its tie point's image points, as COLMAP stores it: the square root of
    a histogram of sum 1, times 512 (Arandjelovic and Zisserman 2012). Raises InputDataError where there are none.
    """
    try:
        descriptors: UInt8Array = np.load(folder / "descriptors.npy")
    except (OSError, ValueError) as error:
        raise InputDataError(
            f"{folder} holds no descriptors of its tie points ({error}); remove the folder and run again"
        ) from error
    return descriptors
