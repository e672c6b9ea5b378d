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
from facadelake.sfm.worker.focal_deviations import FocalDeviation
from facadelake.sfm.worker.report import ProgressReport
from schemas.vocabulary import PoseSource

_DESCRIPTOR_DIMENSIONS = 128


def select_descriptors(model: pycolmap.Reconstruction, database_path: Path, row_of_point: dict[int, int]) -> UInt8Array:
    """SIFT descriptors (m, 128) of the points: for each that of the image point nearest to the mean of all.

    It is the descriptor of an actual image point, not the mean: a mean of histograms is smoother than each of them, so
    distances to it are smaller, and a ratio test designed for single descriptors would be biased. ``row_of_point``
    gives the row of each point id.
    """
    total = np.zeros((len(row_of_point), _DESCRIPTOR_DIMENSIONS), dtype=np.float32)
    image_point_count = np.zeros(len(row_of_point), dtype=np.float32)
    with pycolmap.Database.open(database_path) as database:
        for rows, descriptors in _read_point_descriptors(model, database, row_of_point):
            np.add.at(total, rows, descriptors)
            np.add.at(image_point_count, rows, 1)
        mean = total / np.maximum(image_point_count, 1)[:, None]
        nearest = np.full(len(row_of_point), np.inf, dtype=np.float32)
        chosen = np.zeros((len(row_of_point), _DESCRIPTOR_DIMENSIONS), dtype=np.uint8)
        for rows, descriptors in _read_point_descriptors(model, database, row_of_point):
            distance = np.sum((descriptors - mean[rows]) ** 2, axis=1)
            # Farthest first: where a photograph shows a point twice, the nearer descriptor is written last.
            order = [k for k in np.argsort(-distance, kind="stable") if distance[k] < nearest[rows[k]]]
            nearest[rows[order]] = distance[order]
            chosen[rows[order]] = descriptors[order]
    return chosen


def _read_point_descriptors(
    model: pycolmap.Reconstruction, database: pycolmap.Database, row_of_point: dict[int, int]
) -> Iterator[tuple[Int64Array, UInt8Array]]:
    """For each posed photograph, the rows of the points that it shows and their descriptors there."""
    for image_id in sorted(model.reg_image_ids()):
        image = model.images[image_id]
        point_rows = [row_of_point[point.point3D_id] for point in image.get_observation_points2D()]
        if point_rows:
            descriptors = database.read_descriptors(image_id).data[image.get_observation_point2D_idxs()]
            yield np.array(point_rows, dtype=np.int64), descriptors


@dataclass(frozen=True, kw_only=True, eq=False)
class MappingResult:
    """Result for all photographs of a job.

    ``block`` is the largest block, ``mapped`` those of its photographs that mapping localised (the others were
    resected), ``separate_blocks`` the blocks that could not be joined, ``resection_failures`` the reason why each
    photograph outside the block could not be resected, by image id. ``focal_deviations`` are the photographs with
    another focal length than their camera, by image id; they were resected with a camera of their own.
    """

    block: pycolmap.Reconstruction
    mapped: frozenset[int]
    separate_blocks: list[pycolmap.Reconstruction]
    resection_failures: dict[int, str]
    focal_deviations: dict[int, FocalDeviation]


def _explain_unlocalised(result: MappingResult, database: pycolmap.Database, image_id: int) -> str:
    """Reason and remedy for a photograph outside the block."""
    features = database.num_keypoints_for_image(image_id)
    if features < 100:
        return (
            f"only {features} features were found: the photograph is blurred, dark or shows a surface without texture"
        )
    block_size = len(result.mapped)
    for number, other in enumerate(result.separate_blocks, start=2):
        if image_id in other.images and other.images[image_id].has_pose:
            return (
                f"belongs to block {number} of {other.num_reg_images()} photographs, which overlaps too little with "
                f"the first block of {block_size}; photograph the surfaces between them"
            )
    return (
        f"could not be joined to the block of {block_size} photographs: too little overlap with them "
        f"({features} features found; {result.resection_failures[image_id]}); photograph with more overlap"
    )


def _opencv_from_camera(camera: pycolmap.Camera) -> list[float]:
    """``fx fy cx cy k1 k2 p1 p2`` of a camera of either model that the database uses."""
    if camera.model == pycolmap.CameraModelId.SIMPLE_RADIAL:
        focal, cx, cy, k1 = camera.params
        return [focal, focal, cx, cy, k1, 0.0, 0.0, 0.0]
    return [float(value) for value in camera.params]


def export_reconstruction(
    result: MappingResult,
    job: dict[str, Any],
    image_id_of: dict[int, int],
    database_path: Path,
    folder: Path,
    report: ProgressReport,
) -> None:
    """Write the result: ``sparse/``, ``reconstruction.npz``, ``reconstruction.json`` and ``descriptors.npy``.

    ``sparse/`` is COLMAP's binary model; the parent reads the other files.

    Args:
        result: the block, and the reasons for photographs outside it.
        job: the job, whose order of photographs is kept.
        image_id_of: index in the job -> image id.
        database_path: COLMAP's database of the job.
        folder: output folder.
        report: holds the cost of the steps, written to ``diagnostics/costs.json``.
    """
    model, deviations = result.block, result.focal_deviations
    sparse = folder / "sparse"
    sparse.mkdir()
    model.write_binary(sparse)
    point_ids = sorted(model.points3D)
    row_of_point = {point_id: row for row, point_id in enumerate(point_ids)}
    points = [model.points3D[point_id] for point_id in point_ids]
    photos: list[dict[str, Any]] = []
    unlocalised: list[dict[str, str]] = []
    cameras, rotations, centres, point_photo, point_row, point_xy = [], [], [], [], [], []
    with pycolmap.Database.open(database_path) as database:
        for index, photo in enumerate(job["photos"]):
            image_id = image_id_of[index]
            if image_id not in model.images or not model.images[image_id].has_pose:
                reason = _explain_unlocalised(result, database, image_id)
                unlocalised.append({"photo_id": photo["photo_id"], "reason": reason})
                continue
            image = model.images[image_id]
            camera = model.cameras[image.camera_id]
            sfm_from_cam = image.cam_from_world().inverse()
            image_points = image.get_observation_points2D()
            xyz_cam = image.cam_from_world() * np.array(
                [model.points3D[p.point3D_id].xyz for p in image_points]
            ).reshape(-1, 3)
            xy = np.array([p.xy for p in image_points], dtype=np.float64).reshape(-1, 2)
            projected = np.asarray(camera.img_from_cam(xyz_cam), dtype=np.float64).reshape(-1, 2)
            error_px = np.linalg.norm(projected - xy, axis=1)
            point_photo.append(np.full(len(image_points), len(photos)))
            point_row.append(np.array([row_of_point[p.point3D_id] for p in image_points], dtype=np.int64))
            point_xy.append(xy)
            cameras.append([camera.width, camera.height, *_opencv_from_camera(camera)])
            rotations.append(sfm_from_cam.rotation.matrix())
            centres.append(sfm_from_cam.translation)
            photos.append(
                {
                    "photo_id": photo["photo_id"],
                    "source": str(PoseSource.SFM if image_id in result.mapped else PoseSource.RESECTED),
                    "reprojection_error_px": float(error_px.mean()) if len(image_points) else 0.0,
                    "tie_points": len(image_points),
                    "focal_factor": deviations[image_id].factor if image_id in deviations else 1.0,
                    "focal_factor_sigma": deviations[image_id].sigma if image_id in deviations else 0.0,
                }
            )
    np.savez(
        folder / "reconstruction.npz",
        camera=np.array(cameras),
        sfm_from_cam_rotation=np.array(rotations),
        sfm_from_cam_translation=np.array(centres),
        xyz_sfm=np.array([point.xyz for point in points]).reshape(-1, 3),
        rgb=np.array([point.color for point in points], dtype=np.uint8).reshape(-1, 3),
        image_point_photo=np.concatenate(point_photo),
        image_point_tie_point=np.concatenate(point_row),
        image_point_xy_img=np.concatenate(point_xy),
    )
    np.save(folder / "descriptors.npy", select_descriptors(model, database_path, row_of_point))
    diagnostics = folder / DIAGNOSTICS
    diagnostics.mkdir(exist_ok=True)
    (diagnostics / "costs.json").write_text(json.dumps([asdict(cost) for cost in report.costs], indent=1), "utf-8")
    (folder / "reconstruction.json").write_text(
        json.dumps(
            {
                "photos": photos,
                "unlocalised": unlocalised,
                "mean_reprojection_error_px": float(model.compute_mean_reprojection_error()),
                "pycolmap": pycolmap.__version__,
            },
            indent=1,
        ),
        encoding="utf-8",
    )
