"""The reconstruction as plain arrays, with a descriptor for each tie point; the parent reads them without pycolmap."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from facadelake.core.arrays import Int64Array, UInt8Array
from facadelake.core.cache import DIAGNOSTICS
from facadelake.sfm.worker.report import ProgressReport
from schemas.vocabulary import PoseSource

_DESCRIPTOR_DIMENSIONS = 128


def select_descriptors(model: pycolmap.Reconstruction, database_path: Path, row_of_point: dict[int, int]) -> UInt8Array:
    """SIFT descriptors (m, 128) of the points, in the rows given: of each track the one nearest to its mean.

    It is one that a photograph really held, not the mean itself: a mean of histograms is smoother than any of them, so
    distances to it shrink, and a ratio test meant for single descriptors would no longer say what it should.
    """
    total = np.zeros((len(row_of_point), _DESCRIPTOR_DIMENSIONS), dtype=np.float32)
    sightings = np.zeros(len(row_of_point), dtype=np.float32)
    with pycolmap.Database.open(database_path) as database:
        for rows, found in _read_point_descriptors(model, database, row_of_point):
            np.add.at(total, rows, found)
            np.add.at(sightings, rows, 1)
        mean = total / np.maximum(sightings, 1)[:, None]
        nearest = np.full(len(row_of_point), np.inf, dtype=np.float32)
        chosen = np.zeros((len(row_of_point), _DESCRIPTOR_DIMENSIONS), dtype=np.uint8)
        for rows, found in _read_point_descriptors(model, database, row_of_point):
            distance = np.sum((found - mean[rows]) ** 2, axis=1)
            # Farthest first: where a photograph saw a point twice, the nearer one is written last.
            order = [k for k in np.argsort(-distance, kind="stable") if distance[k] < nearest[rows[k]]]
            nearest[rows[order]] = distance[order]
            chosen[rows[order]] = found[order]
    return chosen


def _read_point_descriptors(
    model: pycolmap.Reconstruction, database: pycolmap.Database, row_of_point: dict[int, int]
) -> Iterator[tuple[Int64Array, UInt8Array]]:
    """Of each posed photograph, the rows of the points that it saw and their descriptors there."""
    for image_id in sorted(model.reg_image_ids()):
        image = model.images[image_id]
        seen = [row_of_point[point.point3D_id] for point in image.get_observation_points2D()]
        if seen:
            found = database.read_descriptors(image_id).data[image.get_observation_point2D_idxs()]
            yield np.array(seen, dtype=np.int64), found


@dataclass(frozen=True, kw_only=True, eq=False)
class MappingResult:
    """What became of the photographs: the ``block``, those of it that mapping placed (the others were resected), the
    blocks that stayed ``separate_blocks``, and for each photograph outside the block why it was ``resection_failures``, by image id.
    """

    block: pycolmap.Reconstruction
    mapped: frozenset[int]
    separate_blocks: list[pycolmap.Reconstruction]
    resection_failures: dict[int, str]


def _explain_unlocalised(outcome: MappingResult, database: pycolmap.Database, image_id: int) -> str:
    features = database.num_keypoints_for_image(image_id)
    if features < 100:
        return f"only {features} features were found: blurred, dark or showing a bare surface"
    block = len(outcome.mapped)
    for number, other in enumerate(outcome.separate_blocks, start=2):
        if image_id in other.images and other.images[image_id].has_pose:
            return (
                f"lies in block {number}, of {other.num_reg_images()} photographs, which shares too little with the "
                f"first, of {block}; photograph what lies between them"
            )
    return (
        f"could not be joined to the block of {block} photographs: too little overlap with them "
        f"({features} features found; {outcome.resection_failures[image_id]}); photograph with more overlap"
    )


def _opencv_from_camera(camera: pycolmap.Camera) -> list[float]:
    """``fx fy cx cy k1 k2 p1 p2`` of a camera of either model that the database uses."""
    if camera.model == pycolmap.CameraModelId.SIMPLE_RADIAL:
        focal, cx, cy, k1 = camera.params
        return [focal, focal, cx, cy, k1, 0.0, 0.0, 0.0]
    return [float(value) for value in camera.params]


def export_reconstruction(
    outcome: MappingResult,
    job: dict[str, Any],
    image_id_of: dict[int, int],
    database_path: Path,
    folder: Path,
    report: ProgressReport,
) -> None:
    """Write ``sparse/`` (COLMAP's binary model), ``reconstruction.npz``, ``descriptors.npy`` and
    ``reconstruction.json``.
    """
    model = outcome.block
    sparse = folder / "sparse"
    sparse.mkdir()
    model.write_binary(sparse)
    point_ids = sorted(model.points3D)
    row_of_point = {point_id: row for row, point_id in enumerate(point_ids)}
    points = [model.points3D[point_id] for point_id in point_ids]
    photos: list[dict[str, Any]] = []
    lost: list[dict[str, str]] = []
    cameras, rotations, centres, track_photo, track_point, track_xy = [], [], [], [], [], []
    with pycolmap.Database.open(database_path) as database:
        for index, photo in enumerate(job["photos"]):
            image_id = image_id_of[index]
            if image_id not in model.images or not model.images[image_id].has_pose:
                reason = _explain_unlocalised(outcome, database, image_id)
                lost.append({"photo_id": photo["photo_id"], "reason": reason})
                continue
            image = model.images[image_id]
            camera = model.cameras[image.camera_id]
            sfm_from_cam = image.cam_from_world().inverse()
            seen = image.get_observation_points2D()
            xyz_cam = image.cam_from_world() * np.array([model.points3D[p.point3D_id].xyz for p in seen]).reshape(-1, 3)
            xy = np.array([p.xy for p in seen], dtype=np.float64).reshape(-1, 2)
            projected = np.asarray(camera.img_from_cam(xyz_cam), dtype=np.float64).reshape(-1, 2)
            error_px = np.linalg.norm(projected - xy, axis=1)
            track_photo.append(np.full(len(seen), len(photos)))
            track_point.append(np.array([row_of_point[p.point3D_id] for p in seen], dtype=np.int64))
            track_xy.append(xy)
            cameras.append([camera.width, camera.height, *_opencv_from_camera(camera)])
            rotations.append(sfm_from_cam.rotation.matrix())
            centres.append(sfm_from_cam.translation)
            photos.append(
                {
                    "photo_id": photo["photo_id"],
                    "source": str(PoseSource.SFM if image_id in outcome.mapped else PoseSource.RESECTED),
                    "reprojection_error_px": float(error_px.mean()) if len(seen) else 0.0,
                    "tie_points": len(seen),
                }
            )
    np.savez(
        folder / "reconstruction.npz",
        camera=np.array(cameras),
        sfm_from_cam_rotation=np.array(rotations),
        sfm_from_cam_translation=np.array(centres),
        xyz_sfm=np.array([point.xyz for point in points]).reshape(-1, 3),
        rgb=np.array([point.color for point in points], dtype=np.uint8).reshape(-1, 3),
        image_point_photo=np.concatenate(track_photo),
        image_point_tie_point=np.concatenate(track_point),
        image_point_xy_img=np.concatenate(track_xy),
    )
    np.save(folder / "descriptors.npy", select_descriptors(model, database_path, row_of_point))
    diagnostics = folder / DIAGNOSTICS
    diagnostics.mkdir(exist_ok=True)
    (diagnostics / "costs.json").write_text(json.dumps([asdict(cost) for cost in report.costs], indent=1), "utf-8")
    (folder / "reconstruction.json").write_text(
        json.dumps(
            {
                "photos": photos,
                "unlocalised": lost,
                "mean_reprojection_error_px": float(model.compute_mean_reprojection_error()),
                "pycolmap": pycolmap.__version__,
            },
            indent=1,
        ),
        encoding="utf-8",
    )
