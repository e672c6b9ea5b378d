"""Photographs that mapping did not localise, resected one by one from their matches with the points of the block."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from facadelake.core.arrays import Float64Nx2, Float64Nx3, Int64Array
from facadelake.sfm.worker.mapping import compute_tolerance_factor
from facadelake.sfm.worker.report import ProgressReport

_MIN_INLIERS = 12
_MIN_INLIERS_UNKNOWN_FOCAL = 30
_MAX_ERROR_PX = 4.0
# Limit of the sigma of the projection centre over the median depth: points in one corner do not determine the pose.
_MAX_RELATIVE_SIGMA = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class Correspondences:
    """2D-3D correspondences of a photograph with the block.

    ``keypoint`` (m,) and ``xy_img`` (m, 2) are keypoints and their pixels, ``point_id`` (m,) and ``xyz_sfm`` (m, 3) the
    points that they may show.
    """

    keypoint: Int64Array
    xy_img: Float64Nx2
    point_id: Int64Array
    xyz_sfm: Float64Nx3


@dataclass(frozen=True, kw_only=True, eq=False)
class ResectionCamera:
    """The camera to resect a photograph with, and whether its focal length is unknown."""

    camera: pycolmap.Camera
    focal_is_free: bool
    in_block: bool = True


def resect_remaining(
    model: pycolmap.Reconstruction, job: dict[str, Any], database_path: Path, report: ProgressReport
) -> dict[int, str]:
    """Resect the photographs outside the block, in place; returns the reason of each failure by image id.

    Inliers become image points of the block's points. Each resected photograph adds correspondences to those matched
    with it, so failed ones are tried again.

    Args:
        model: the block; resected photographs are added.
        job: the job, with cameras and settings.
        database_path: COLMAP's database of the job, with matches.
        report: receives the progress.
    """
    model.tear_down()  # removes photographs without a pose, and their frames
    with pycolmap.Database.open(database_path) as database:
        outside = {image.image_id for image in database.read_all_images()} - set(model.reg_image_ids())
        matched = find_matched_images(database, outside)
        correspondences = {
            image_id: collect_correspondences(model, database, image_id, matched[image_id]) for image_id in outside
        }
        failures: dict[int, str] = {}
        pending = set(outside)
        with report.step("Resecting photographs", len(outside)):
            while pending:
                image_id = min(pending, key=lambda image_id: (-len(correspondences[image_id].keypoint), image_id))
                pending.remove(image_id)
                failures[image_id] = resect_image(
                    model, database, job, image_id, correspondences[image_id], _choose_camera(model, database, image_id)
                )
                if not failures[image_id]:
                    del failures[image_id]
                    report.advance()
                    for other in sorted(failures.keys() | pending):
                        if image_id in matched[other]:
                            correspondences[other] = collect_correspondences(model, database, other, matched[other])
                            pending.add(other)
    return failures


def find_matched_images(database: pycolmap.Database, outside: set[int]) -> dict[int, set[int]]:
    """The photographs that each photograph outside the block was matched with."""
    matched: dict[int, set[int]] = {image_id: set() for image_id in outside}
    for pair_id, count in zip(*database.read_num_matches(), strict=True):
        first, second = pycolmap.pair_id_to_image_pair(pair_id)
        for one, other in ((first, second), (second, first)):
            if count and one in outside:
                matched[one].add(other)
    return matched


def collect_correspondences(
    model: pycolmap.Reconstruction, database: pycolmap.Database, image_id: int, matched: set[int]
) -> Correspondences:
    """Correspondences of a photograph from its matches, verified or not: the pose estimation rejects outliers."""
    pairs: set[tuple[int, int]] = set()
    for other in matched & set(model.reg_image_ids()):
        image = model.images[other]
        indices, points = image.get_observation_point2D_idxs(), image.get_observation_points2D()
        point_of = {index: point.point3D_id for index, point in zip(indices, points, strict=True)}
        matches = database.read_matches(image_id, other)
        pairs |= {
            (int(k), point_of[int(other_keypoint)]) for k, other_keypoint in matches if int(other_keypoint) in point_of
        }
    keypoint = np.array([k for k, _ in sorted(pairs)], dtype=np.int64)
    point_id = np.array([p for _, p in sorted(pairs)], dtype=np.int64)
    xyz = np.array([model.points3D[p].xyz for p in point_id]).reshape(-1, 3)
    return Correspondences(
        keypoint=keypoint, xy_img=_read_keypoints(database, image_id)[keypoint], point_id=point_id, xyz_sfm=xyz
    )


def _read_keypoints(database: pycolmap.Database, image_id: int) -> Float64Nx2:
    """Pixels (k, 2) of the keypoints of a photograph."""
    xy: Float64Nx2 = np.atleast_2d(np.asarray(database.read_keypoints(image_id), dtype=np.float64))[:, :2]
    return xy


def _choose_camera(model: pycolmap.Reconstruction, database: pycolmap.Database, image_id: int) -> ResectionCamera:
    """The adjusted camera of a photograph where the block has it, else that of the metadata."""
    camera_id = database.read_image(image_id).camera_id
    in_block = any(model.images[other].camera_id == camera_id for other in model.reg_image_ids())
    camera = model.cameras[camera_id] if in_block else database.read_camera(camera_id)
    return ResectionCamera(
        camera=camera, focal_is_free=not in_block and not camera.has_prior_focal_length, in_block=in_block
    )


def resect_image(
    model: pycolmap.Reconstruction,
    database: pycolmap.Database,
    job: dict[str, Any],
    image_id: int,
    correspondences: Correspondences,
    chosen: ResectionCamera,
) -> str:
    """Resect one photograph if its correspondences allow it; returns the reason of a failure, else an empty string.

    Args:
        model: the block; the photograph is added to it.
        database: COLMAP's database of the job.
        job: the job, with settings.
        image_id: the photograph in the database.
        correspondences: its correspondences with the block.
        chosen: the camera, and whether its focal length is estimated.
    """
    camera, free_focal = chosen.camera, chosen.focal_is_free
    min_inliers = _MIN_INLIERS_UNKNOWN_FOCAL if free_focal else _MIN_INLIERS
    if len(correspondences.keypoint) < min_inliers:
        return f"{len(correspondences.keypoint)} of its features match points of the block; {min_inliers} are needed"
    estimation = pycolmap.AbsolutePoseEstimationOptions()
    estimation.estimate_focal_length = free_focal
    estimation.ransac.max_error = _MAX_ERROR_PX * compute_tolerance_factor(job)
    estimation.ransac.random_seed = job["settings"]["seed"]
    refinement = pycolmap.AbsolutePoseRefinementOptions()
    refinement.refine_focal_length = not chosen.in_block
    answer = pycolmap.estimate_and_refine_absolute_pose(
        correspondences.xy_img, correspondences.xyz_sfm, camera, estimation, refinement, return_covariance=True
    )
    if answer is None:
        return f"no pose fits its {len(correspondences.keypoint)} matches with the block"
    cam_from_sfm = answer["cam_from_world"]
    inliers = select_inliers(correspondences, camera, cam_from_sfm, estimation.ransac.max_error)
    if len(inliers) < min_inliers:
        total = len(correspondences.keypoint)
        return f"{len(inliers)} of its {total} matches with the block fit one pose; {min_inliers} are needed"
    depth = float(np.median((cam_from_sfm * correspondences.xyz_sfm[inliers])[:, 2]))
    centre_covariance = pycolmap.get_covariance_for_inverse(cam_from_sfm, answer["covariance"])[3:, 3:]
    relative_sigma = float(np.sqrt(np.linalg.eigvalsh(centre_covariance)[-1])) / depth
    if not relative_sigma < _MAX_RELATIVE_SIGMA:
        return (
            f"its {len(inliers)} matches with the block are too close together: the sigma of its position would be "
            f"{relative_sigma:.1%} of the distance to the surface; the limit is {_MAX_RELATIVE_SIGMA:.0%}"
        )
    add_posed_image(model, database, image_id, camera, cam_from_sfm)
    for k in inliers:
        model.add_observation(
            int(correspondences.point_id[k]), pycolmap.TrackElement(image_id, int(correspondences.keypoint[k]))
        )
    return ""


def select_inliers(
    correspondences: Correspondences, camera: pycolmap.Camera, cam_from_sfm: pycolmap.Rigid3d, max_error_px: float
) -> Int64Array:
    """Correspondences with a small reprojection error, best first; at most one for each keypoint and each point."""
    xyz_cam = cam_from_sfm * correspondences.xyz_sfm
    ahead = xyz_cam[:, 2] > 0
    error = np.full(len(correspondences.keypoint), np.inf)
    projected = np.asarray(camera.img_from_cam(xyz_cam[ahead]), dtype=np.float64).reshape(-1, 2)
    error[ahead] = np.linalg.norm(projected - correspondences.xy_img[ahead], axis=1)
    order = np.argsort(error, kind="stable")
    order = order[error[order] <= max_error_px]
    for index in (correspondences.keypoint, correspondences.point_id):
        order = order[np.sort(np.unique(index[order], return_index=True)[1])]
    return order


def add_posed_image(
    model: pycolmap.Reconstruction,
    database: pycolmap.Database,
    image_id: int,
    camera: pycolmap.Camera,
    cam_from_sfm: pycolmap.Rigid3d,
) -> None:
    """Add a photograph to the block at a given pose, without image points.

    Args:
        model: the block, changed in place.
        database: COLMAP's database of the job.
        image_id: the photograph in the database.
        camera: its camera, added where the block does not have it yet.
        cam_from_sfm: its pose.
    """
    if camera.camera_id not in model.cameras:
        model.add_camera_with_trivial_rig(camera)
    image = pycolmap.Image(
        name=database.read_image(image_id).name,
        keypoints=_read_keypoints(database, image_id),
        camera_id=camera.camera_id,
        image_id=image_id,
    )
    model.add_image_with_trivial_frame(image, cam_from_sfm)
