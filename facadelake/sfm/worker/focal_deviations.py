"""Photographs whose own focal length disagrees with that of their camera: zoomed ones that no metadata tell apart.

A facade is nearly a plane, on which a zoom looks like a shorter distance: one focal length for all photographs of a
body fits a zoomed one with residuals below a pixel, metres from where it was taken. Its correspondences with points of
the block, which the other photographs determine, have relief and perspective enough for a focal length of its own.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from facadelake.core.arrays import Float64Array, Float64Nx2, Float64Nx3
from facadelake.sfm.worker.mapping import adjust_block, compute_tolerance_factor
from facadelake.sfm.worker.report import ProgressReport
from facadelake.sfm.worker.resection import (
    Correspondences,
    ResectionCamera,
    collect_correspondences,
    find_matched_images,
    resect_image,
    select_inliers,
)

# A deviation is told beyond this number of sigmas, but not below what focusing and temperature change: five times the
# 0.3 % of a calibration.
_LIMIT_SIGMAS = 5.0
_MIN_DEVIATION = 0.015
_MIN_INLIERS = 20
_MAX_ERROR_PX = 4.0
# Deviations that differ by less belong to one setting of the zoom.
_SAME_SETTING = 0.02
_MIN_PHOTOS_FOR_OPENCV_MODEL = 4
_MAX_ITERATIONS = 20
_MAX_ROUNDS = 4
_MAX_SIGMA = 0.03  # of a factor that counts as determined


@dataclass(frozen=True, kw_only=True)
class FocalDeviation:
    """The focal length of a photograph over that of its camera, and one sigma of the factor."""

    image_id: int
    camera_id: int
    factor: float
    sigma: float


def separate_focal_deviations(
    model: pycolmap.Reconstruction,
    job: dict[str, Any],
    database_path: Path,
    failures: dict[int, str],
    report: ProgressReport,
) -> list[FocalDeviation]:
    """Give photographs with another focal length than their camera a camera of its own, in place, and adjust again.

    Args:
        model: the block, with resected photographs.
        job: the job, with cameras and settings.
        database_path: COLMAP's database of the job, with matches.
        failures: reason of each photograph outside the block; updated where one enters or leaves it.
        report: receives the progress.

    Returns:
        The deviations found; the photographs are in the block again, or in ``failures``.
    """
    deviations: dict[int, FocalDeviation] = {}
    settings: list[_ZoomSetting] = []
    with pycolmap.Database.open(database_path) as database:
        image_ids = sorted({*model.reg_image_ids(), *failures})
        matched = find_matched_images(database, set(image_ids))
        for _ in range(_MAX_ROUNDS):  # separated photographs give the others more points
            found = _estimate_deviations(model, database, job, matched, report)
            significant = [d for d in _select_significant(model, found, failures) if d.image_id not in deviations]
            if not significant:
                break
            deviations |= {deviation.image_id: deviation for deviation in significant}
            remove_from_block(model, {d.image_id for d in significant} - failures.keys())
            for deviation in significant:
                failures.pop(deviation.image_id, None)
                camera = _find_camera(model, database, deviation, settings, significant)
                reason = resect_image(
                    model,
                    database,
                    job,
                    deviation.image_id,
                    collect_correspondences(model, database, deviation.image_id, matched[deviation.image_id]),
                    ResectionCamera(camera=camera, focal_is_free=False),
                )
                if reason:
                    factor = f"its focal length is {deviation.factor:.3f} times that of its camera"
                    failures[deviation.image_id] = f"{factor}; {reason}"
            adjust_block(model, job, report)
        if deviations:
            _remove_unchecked(model, database, found, deviations, failures)
    return [deviation for deviation in deviations.values() if deviation.image_id not in failures]


def remove_from_block(model: pycolmap.Reconstruction, image_ids: set[int]) -> None:
    """Take photographs out of the block, in place."""
    for image_id in image_ids:
        model.deregister_frame(model.images[image_id].frame_id)
    model.tear_down()


def _remove_unchecked(
    model: pycolmap.Reconstruction,
    database: pycolmap.Database,
    found: dict[int, FocalDeviation],
    deviations: dict[int, FocalDeviation],
    failures: dict[int, str],
) -> None:
    """Where a camera has zoomed photographs, take out those whose own focal length is not determined, with a reason."""
    zoomed = {database.read_image(image_id).camera_id for image_id in deviations}
    unchecked = {
        image_id
        for image_id in model.reg_image_ids()
        if model.images[image_id].camera_id in zoomed and (image_id not in found or found[image_id].sigma > _MAX_SIGMA)
    }
    remove_from_block(model, unchecked)
    for image_id in unchecked:
        failures[image_id] = (
            f"{len(deviations)} photographs by its camera have another focal length (zoom?), and its own cannot be "
            "determined from its matches with the block"
        )


def _estimate_deviations(
    model: pycolmap.Reconstruction,
    database: pycolmap.Database,
    job: dict[str, Any],
    matched: dict[int, set[int]],
    report: ProgressReport,
) -> dict[int, FocalDeviation]:
    """The focal length of each photograph over that of its camera, where its matches determine it."""
    found = {}
    with report.step("Checking focal lengths", len(matched)):
        for image_id in sorted(matched):
            correspondences = collect_correspondences(model, database, image_id, matched[image_id])
            deviation = _estimate_deviation(model, database, job, image_id, correspondences)
            if deviation is not None:
                found[image_id] = deviation
            report.advance()
    return found


def _estimate_deviation(
    model: pycolmap.Reconstruction,
    database: pycolmap.Database,
    job: dict[str, Any],
    image_id: int,
    correspondences: Correspondences,
) -> FocalDeviation | None:
    """The focal length of one photograph from its correspondences; None where they do not determine it."""
    in_block = image_id in model.images and model.images[image_id].has_pose
    camera_id = model.images[image_id].camera_id if in_block else database.read_image(image_id).camera_id
    if camera_id not in model.cameras or len(correspondences.keypoint) < _MIN_INLIERS:
        return None
    camera = copy(model.cameras[camera_id])
    usual = float(camera.mean_focal_length())
    estimation = pycolmap.AbsolutePoseEstimationOptions()
    estimation.estimate_focal_length = True
    estimation.ransac.max_error = _MAX_ERROR_PX * compute_tolerance_factor(job)
    estimation.ransac.random_seed = job["settings"]["seed"]
    refinement = pycolmap.AbsolutePoseRefinementOptions()
    refinement.refine_focal_length = True
    answer = pycolmap.estimate_and_refine_absolute_pose(
        correspondences.xy_img, correspondences.xyz_sfm, camera, estimation, refinement
    )
    if answer is None:
        return None
    cam_from_sfm = answer["cam_from_world"]
    inliers = select_inliers(correspondences, camera, cam_from_sfm, estimation.ransac.max_error)
    if len(inliers) < _MIN_INLIERS:
        return None
    log_factor, sigma = _refine_log_focal(
        camera, cam_from_sfm, correspondences.xy_img[inliers], correspondences.xyz_sfm[inliers]
    )
    factor = float(np.exp(log_factor)) * float(camera.mean_focal_length()) / usual
    return FocalDeviation(image_id=image_id, camera_id=camera_id, factor=factor, sigma=factor * sigma)


def _refine_log_focal(
    camera: pycolmap.Camera, cam_from_sfm: pycolmap.Rigid3d, xy_img: Float64Nx2, xyz_sfm: Float64Nx3
) -> tuple[float, float]:
    """Logarithm of a factor on the focal length, estimated with the pose, and its sigma, by robust least squares."""
    centre = np.array([camera.principal_point_x, camera.principal_point_y])
    pose, log_factor = cam_from_sfm, 0.0
    scale_m = float(np.median((pose * xyz_sfm)[:, 2]))
    steps = np.array([1e-6] * 3 + [1e-6 * scale_m] * 3 + [1e-6])

    def compute_residuals(pose: pycolmap.Rigid3d, log_factor: float) -> Float64Array:
        projected = np.asarray(camera.img_from_cam(pose * xyz_sfm), dtype=np.float64).reshape(-1, 2)
        residuals: Float64Array = (centre + np.exp(log_factor) * (projected - centre) - xy_img).ravel()
        return residuals

    def move(pose: pycolmap.Rigid3d, step: Float64Array) -> pycolmap.Rigid3d:
        turn = pycolmap.Rigid3d(pycolmap.Rotation3d(step[:3]), step[3:6])
        return turn * pose

    for _ in range(_MAX_ITERATIONS):
        residuals = compute_residuals(pose, log_factor)
        jacobian = np.empty((len(residuals), 7))
        for k, size in enumerate(steps):
            step = np.zeros(7)
            step[k] = size
            jacobian[:, k] = (compute_residuals(move(pose, step), log_factor + step[6]) - residuals) / size
        error = np.linalg.norm(residuals.reshape(-1, 2), axis=1)
        weight = np.repeat(1 / (1 + (error / (2 * max(float(np.median(error)), 0.05))) ** 2), 2)
        normal = jacobian.T @ (weight[:, None] * jacobian)
        gradient = jacobian.T @ (weight * residuals)
        change = -np.asarray(np.linalg.lstsq(normal, gradient, rcond=None)[0], dtype=np.float64)
        pose, log_factor = move(pose, change), log_factor + float(change[6])
        if np.all(np.abs(change) < 0.01 * steps):
            break
    variance = float((weight * residuals**2).sum() / max(weight.sum() - 7, 1.0))
    return log_factor, float(np.sqrt(np.linalg.pinv(normal)[6, 6] * variance))


def _select_significant(
    model: pycolmap.Reconstruction, found: dict[int, FocalDeviation], failures: dict[int, str]
) -> list[FocalDeviation]:
    """Deviations from the median of their camera beyond the limits; what most photographs have is the camera's own."""
    significant = []
    for camera_id in sorted({deviation.camera_id for deviation in found.values()}):
        members = [deviation for deviation in found.values() if deviation.camera_id == camera_id]
        inside = [deviation for deviation in members if deviation.image_id not in failures]
        if len(inside) < 3:
            continue
        usual = float(np.median([deviation.factor for deviation in inside]))
        # Errors of the points and of the lens model are in the spread of the others.
        scores = [abs(deviation.factor - usual) / deviation.sigma for deviation in inside]
        inflation = max(1.0, float(np.median(scores)) / 0.6745)
        for deviation in members:
            limit = max(_LIMIT_SIGMAS * inflation * deviation.sigma, _MIN_DEVIATION)
            if abs(deviation.factor / usual - 1) > limit:
                significant.append(deviation)
    return sorted(significant, key=lambda deviation: deviation.image_id)


@dataclass(frozen=True, kw_only=True)
class _ZoomSetting:
    """A camera made for photographs whose focal length is ``factor`` times that of camera ``of_camera_id``."""

    of_camera_id: int
    factor: float
    camera: pycolmap.Camera


def _find_camera(
    model: pycolmap.Reconstruction,
    database: pycolmap.Database,
    deviation: FocalDeviation,
    settings: list[_ZoomSetting],
    significant: list[FocalDeviation],
) -> pycolmap.Camera:
    """The camera of the photograph's zoom setting; a new one is added to ``settings``."""

    def is_same(factor: float) -> bool:
        return abs(factor / deviation.factor - 1) < max(
            _SAME_SETTING, _LIMIT_SIGMAS * deviation.sigma / deviation.factor
        )

    for setting in settings:
        if setting.of_camera_id == deviation.camera_id and is_same(setting.factor):
            adjusted = setting.camera.camera_id in model.cameras
            return model.cameras[setting.camera.camera_id] if adjusted else setting.camera
    members = [d for d in significant if d.camera_id == deviation.camera_id and is_same(d.factor)]
    best = min(members, key=lambda member: member.sigma)
    plain = model.cameras[deviation.camera_id]
    middle = np.array([plain.width, plain.height]) / 2
    cx, cy = middle + best.factor * (np.array([plain.principal_point_x, plain.principal_point_y]) - middle)
    fx, fy = best.factor * plain.focal_length_x, best.factor * plain.focal_length_y
    distortion = list(plain.params[4:]) if plain.model == pycolmap.CameraModelId.OPENCV else [plain.params[3], 0, 0, 0]
    large = len(members) >= _MIN_PHOTOS_FOR_OPENCV_MODEL
    camera = pycolmap.Camera(
        model="OPENCV" if large else "SIMPLE_RADIAL",
        width=plain.width,
        height=plain.height,
        params=[fx, fy, cx, cy, *distortion] if large else [fx, cx, cy, distortion[0]],
        camera_id=max(database.num_cameras(), *model.cameras, *(s.camera.camera_id for s in settings)) + 1,
    )
    settings.append(_ZoomSetting(of_camera_id=deviation.camera_id, factor=best.factor, camera=camera))
    return camera
