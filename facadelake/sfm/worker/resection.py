"""Photographs that mapping left out, placed in the block one by one: from their matches with its points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from facadelake.core.arrays import Float64Array, Int64Array
from facadelake.sfm.worker.mapping import compute_tolerance_factor
from facadelake.sfm.worker.report import ProgressReport

_MIN_INLIERS = 12
_MIN_INLIERS_UNKNOWN_FOCAL = 30
_MAX_ERROR_PX = 4.0
# Points in one corner of the photograph leave the pose loose: its centre's sigma over the distance of what it sees.
_MAX_RELATIVE_SIGMA = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class Correspondences:
    """Keypoints (m,) of a photograph, their pixels (m, 2), and the points (m,) of the block that they may show."""

    keypoint: Int64Array
    xy_img: Float64Array
    point_id: Int64Array
    xyz_sfm: Float64Array


def resect_remaining(
    model: pycolmap.Reconstruction, job: dict[str, Any], database_path: Path, report: ProgressReport
) -> dict[int, str]:
    """Place the photographs outside the block in it, in place; returns for each that stays outside why, by image id.

    Their sightings join the tracks of the block's points. A photograph placed may help others that were matched with
    it, so those are tried again.
    """
    model.tear_down()  # forgets photographs without a pose, and their frames
    with pycolmap.Database.open(database_path) as database:
        outside = {image.image_id for image in database.read_all_images()} - set(model.reg_image_ids())
        partners = _find_matched_images(database, outside)
        seen = {
            image_id: _collect_correspondences(model, database, image_id, partners[image_id]) for image_id in outside
        }
        refused: dict[int, str] = {}
        waiting = set(outside)
        with report.step("Placing the rest", len(outside)):
            while waiting:
                image_id = min(waiting, key=lambda image_id: (-len(seen[image_id].keypoint), image_id))
                waiting.remove(image_id)
                refused[image_id] = _resect_image(model, database, job, image_id, seen[image_id])
                if not refused[image_id]:
                    del refused[image_id]
                    report.advance()
                    for other in sorted(refused.keys() | waiting):
                        if image_id in partners[other]:
                            seen[other] = _collect_correspondences(model, database, other, partners[other])
                            waiting.add(other)
    return refused


def _find_matched_images(database: pycolmap.Database, outside: set[int]) -> dict[int, set[int]]:
    """Which photographs each of those outside was matched with."""
    partners: dict[int, set[int]] = {image_id: set() for image_id in outside}
    for pair_id, count in zip(*database.read_num_matches(), strict=True):
        first, second = pycolmap.pair_id_to_image_pair(pair_id)
        for one, other in ((first, second), (second, first)):
            if count and one in outside:
                partners[one].add(other)
    return partners


def _collect_correspondences(
    model: pycolmap.Reconstruction, database: pycolmap.Database, image_id: int, partners: set[int]
) -> Correspondences:
    """What the photograph's matches say it sees of the block: unverified ones too, for the points will sort them."""
    pairs: set[tuple[int, int]] = set()
    for other in partners & set(model.reg_image_ids()):
        image = model.images[other]
        indices, points = image.get_observation_point2D_idxs(), image.get_observation_points2D()
        point_of = {index: point.point3D_id for index, point in zip(indices, points, strict=True)}
        matches = database.read_matches(image_id, other)
        pairs |= {(int(k), point_of[int(at)]) for k, at in matches if int(at) in point_of}
    keypoint = np.array([k for k, _ in sorted(pairs)], dtype=np.int64)
    point_id = np.array([p for _, p in sorted(pairs)], dtype=np.int64)
    xyz = np.array([model.points3D[p].xyz for p in point_id]).reshape(-1, 3)
    return Correspondences(
        keypoint=keypoint, xy_img=_read_keypoints(database, image_id)[keypoint], point_id=point_id, xyz_sfm=xyz
    )


def _read_keypoints(database: pycolmap.Database, image_id: int) -> Float64Array:
    xy: Float64Array = np.asarray(database.read_keypoints(image_id), dtype=np.float64).reshape(-1, 6)[:, :2]
    return xy


def _resect_image(
    model: pycolmap.Reconstruction,
    database: pycolmap.Database,
    job: dict[str, Any],
    image_id: int,
    seen: Correspondences,
) -> str:
    """Place one photograph if its sightings allow; returns why not, else empty."""
    camera_id = database.read_image(image_id).camera_id
    known = any(model.images[other].camera_id == camera_id for other in model.reg_image_ids())
    camera = model.cameras[camera_id] if known else database.read_camera(camera_id)
    free_focal = not known and not camera.has_prior_focal_length
    least = _MIN_INLIERS_UNKNOWN_FOCAL if free_focal else _MIN_INLIERS
    if len(seen.keypoint) < least:
        return f"{len(seen.keypoint)} of its features match points of the block, {least} are needed"
    estimation = pycolmap.AbsolutePoseEstimationOptions()
    estimation.estimate_focal_length = free_focal
    estimation.ransac.max_error = _MAX_ERROR_PX * compute_tolerance_factor(job)
    estimation.ransac.random_seed = job["settings"]["seed"]
    refinement = pycolmap.AbsolutePoseRefinementOptions()
    refinement.refine_focal_length = not known
    answer = pycolmap.estimate_and_refine_absolute_pose(
        seen.xy_img, seen.xyz_sfm, camera, estimation, refinement, return_covariance=True
    )
    if answer is None:
        return f"no pose agrees with its {len(seen.keypoint)} matches with the block"
    cam_from_sfm = answer["cam_from_world"]
    agreeing = _select_inliers(seen, camera, cam_from_sfm, estimation.ransac.max_error)
    if len(agreeing) < least:
        return f"{len(agreeing)} of its {len(seen.keypoint)} matches with the block agree on a pose, {least} are needed"
    depth = float(np.median((cam_from_sfm * seen.xyz_sfm[agreeing])[:, 2]))
    centre = pycolmap.get_covariance_for_inverse(cam_from_sfm, answer["covariance"])[3:, 3:]
    looseness = float(np.sqrt(np.linalg.eigvalsh(centre)[-1])) / depth
    if not looseness < _MAX_RELATIVE_SIGMA:
        return (
            f"its {len(agreeing)} matches with the block lie too close together: its place would be uncertain by "
            f"{looseness:.1%} of the distance to what it shows, {_MAX_RELATIVE_SIGMA:.0%} is the limit"
        )
    add_posed_image(model, database, image_id, camera, cam_from_sfm)
    for k in agreeing:
        model.add_observation(int(seen.point_id[k]), pycolmap.TrackElement(image_id, int(seen.keypoint[k])))
    return ""


def _select_inliers(
    seen: Correspondences, camera: pycolmap.Camera, cam_from_sfm: pycolmap.Rigid3d, max_error_px: float
) -> Int64Array:
    """The sightings that the pose reprojects well; of those of one keypoint, and of one point, the best alone."""
    xyz_cam = cam_from_sfm * seen.xyz_sfm
    ahead = xyz_cam[:, 2] > 0
    error = np.full(len(seen.keypoint), np.inf)
    projected = np.asarray(camera.img_from_cam(xyz_cam[ahead]), dtype=np.float64).reshape(-1, 2)
    error[ahead] = np.linalg.norm(projected - seen.xy_img[ahead], axis=1)
    order = np.argsort(error, kind="stable")
    order = order[error[order] <= max_error_px]
    for name in (seen.keypoint, seen.point_id):
        order = order[np.sort(np.unique(name[order], return_index=True)[1])]
    return order


def add_posed_image(
    model: pycolmap.Reconstruction,
    database: pycolmap.Database,
    image_id: int,
    camera: pycolmap.Camera,
    cam_from_sfm: pycolmap.Rigid3d,
) -> None:
    """Add a photograph that the block does not have, at its pose and without sightings."""
    said = database.read_image(image_id)
    if said.camera_id not in model.cameras:
        model.add_camera_with_trivial_rig(camera)
    image = pycolmap.Image(
        name=said.name, keypoints=_read_keypoints(database, image_id), camera_id=said.camera_id, image_id=image_id
    )
    model.add_image_with_trivial_frame(image, cam_from_sfm)
