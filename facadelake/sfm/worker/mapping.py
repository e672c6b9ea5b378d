"""Incremental mapping, and the final bundle adjustment of the free network with estimated principal points."""

from __future__ import annotations

import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import pycolmap

from facadelake.core.errors import InputDataError
from facadelake.sfm.worker.report import ProgressReport

# With fewer photographs of one camera its principal point is correlated with their attitudes.
_MIN_PHOTOS_FOR_PRINCIPAL_POINT = 8
_FILTER_ROUNDS = 3
_MAX_ERROR_PX = 2.0
_MIN_ANGLE_DEG = 1.5
# Features are extracted from reduced photographs; the noise of a keypoint grows with the reduction. The tolerances in
# pixels here and in COLMAP apply up to this reduction and grow beyond it.
_REFERENCE_REDUCTION = 1.6
_MAX_ATTEMPTS = 3
_SUFFICIENT_SHARE = 0.5
_SNAPSHOTS = 12
_COMPLETE = "complete"  # file that marks a snapshot or a folder of models as completely written


def compute_tolerance_factor(job: dict[str, Any]) -> float:
    """Factor on tolerances in pixels of the photographs, above 1 where features come from strongly reduced ones."""
    longest = max(float(max(camera["width_px"], camera["height_px"])) for camera in job["cameras"])
    return max(1.0, longest / float(job["settings"]["max_image_px"]) / _REFERENCE_REDUCTION)


def map_photographs(job: dict[str, Any], database_path: Path, report: ProgressReport) -> list[pycolmap.Reconstruction]:
    """The blocks of the photographs, the largest first; an interrupted run is resumed.

    With weak overlap the initial pair decides how far a block grows: if less than half of the photographs are in one
    block, other initial pairs are tried. Raises InputDataError where no pair can start a reconstruction.
    """
    total = len(job["photos"])
    best: list[pycolmap.Reconstruction] = []
    for attempt in range(_MAX_ATTEMPTS):
        models = sorted(_map_once(job, database_path, attempt, report), key=_measure_size, reverse=True)
        if models and (not best or _measure_size(models[0]) > _measure_size(best[0])):
            best = models
        if best and best[0].num_reg_images() >= _SUFFICIENT_SHARE * total:
            return best
    if not best:
        raise InputDataError(
            f"none of the {total} photographs could be localised: no pair has enough matches to start from; "
            "photograph with 70 % overlap or more, and check that all show the same building"
        )
    return best


def _map_once(
    job: dict[str, Any], database_path: Path, attempt: int, report: ProgressReport
) -> list[pycolmap.Reconstruction]:
    """The blocks of one attempt: from its models if it finished, from its newest snapshot if it was interrupted."""
    models_folder = database_path.with_name(f"models-{attempt}")
    snapshots = database_path.with_name(f"snapshots-{attempt}")
    if (models_folder / _COMPLETE).exists():
        return [pycolmap.Reconstruction(folder) for folder in models_folder.iterdir() if folder.is_dir()]
    snapshots.mkdir(exist_ok=True)
    snapshot = _find_newest_snapshot(snapshots)
    with report.step("Mapping photographs", len(job["photos"])):
        report.advance(pycolmap.Reconstruction(snapshot).num_reg_images() if snapshot else 0)

        def on_localised(count: int = 1) -> None:
            report.advance(count)
            _keep_newest_snapshot(snapshots)

        shutil.rmtree(models_folder, ignore_errors=True)
        models_folder.mkdir()
        models = pycolmap.incremental_mapping(
            database_path,
            job["photographs_root"],
            models_folder,
            options=_configure_mapper(job, snapshots, job["settings"]["seed"] + attempt),
            input_path=str(snapshot) if snapshot else "",
            initial_image_pair_callback=lambda: on_localised(2),
            next_image_callback=on_localised,
        )
    (models_folder / _COMPLETE).touch()
    shutil.rmtree(snapshots)
    return list(models.values())


def _measure_size(model: pycolmap.Reconstruction) -> tuple[int, int]:
    """Numbers of photographs and of points, by which blocks are ordered."""
    return model.num_reg_images(), model.num_points3D()


def _configure_mapper(job: dict[str, Any], snapshots: Path, seed: int) -> pycolmap.IncrementalPipelineOptions:
    """Options of the incremental mapper."""
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = seed
    options.num_threads = job["cores"]
    options.min_model_size = 3
    options.max_num_models = 10
    options.image_path = job["photographs_root"]
    options.snapshot_path = str(snapshots)
    options.snapshot_frames_freq = max(len(job["photos"]) // _SNAPSHOTS, 3)
    # The block is adjusted at the end, first free, then with control, so intermediate adjustments may be coarse. Fewer
    # and looser ones take half the time of COLMAP's defaults and give the same cameras (benchmarks/scale.py).
    options.ba_global_frames_ratio = options.ba_global_points_ratio = 1.4
    options.ba_global_max_refinements = 2
    options.ba_global_function_tolerance = options.ba_local_function_tolerance = 1e-6
    # At the corners of a building, neighbours share one narrow face: COLMAP's minimum of 30 points is too many.
    options.mapper.abs_pose_min_num_inliers = 20
    factor = compute_tolerance_factor(job)
    options.mapper.filter_max_reproj_error *= factor
    options.mapper.abs_pose_max_error *= factor
    options.mapper.init_max_error *= factor
    options.triangulation.merge_max_reproj_error *= factor
    options.triangulation.complete_max_reproj_error *= factor
    return options


def _keep_newest_snapshot(snapshots: Path) -> None:
    """Mark the newest snapshot as complete (COLMAP writes none during this callback) and remove the others."""
    found = sorted(snapshots.iterdir())
    for newest in found[-1:]:
        (newest / _COMPLETE).touch()
    for older in found[:-1]:
        shutil.rmtree(older)


def _find_newest_snapshot(snapshots: Path) -> Path | None:
    """The newest complete snapshot, if there is one."""
    complete = sorted(folder for folder in snapshots.iterdir() if (folder / _COMPLETE).exists())
    return complete[-1] if complete else None


def adjust_block(model: pycolmap.Reconstruction, job: dict[str, Any], report: ProgressReport) -> None:
    """Bundle adjustment of the free network, in place, alternating with the removal of outliers.

    The principal point of a consumer camera is off by tens of pixels; fixed at the centre of the image it bends the
    block (castle: 12 cm instead of 3 cm at the cameras). That of a camera with few photographs stays at the centre.
    """
    photo_count = Counter(model.images[image_id].camera_id for image_id in model.reg_image_ids())
    few_photos = [camera_id for camera_id, count in photo_count.items() if count < _MIN_PHOTOS_FOR_PRINCIPAL_POINT]
    with report.step("Adjusting the block", _FILTER_ROUNDS):
        for _ in range(_FILTER_ROUNDS):
            if len(few_photos) < len(photo_count):
                _adjust_once(model, job, principal_points=True, fixed=few_photos)
            if few_photos:
                _adjust_once(model, job, principal_points=False, fixed=[])
            max_error_px = _MAX_ERROR_PX * compute_tolerance_factor(job)
            pycolmap.ObservationManager(model).filter_all_points3D(max_error_px, _MIN_ANGLE_DEG)
            report.advance()
        model.update_point_3d_errors()


def _adjust_once(
    model: pycolmap.Reconstruction, job: dict[str, Any], *, principal_points: bool, fixed: list[int]
) -> None:
    """One adjustment; the intrinsics of the cameras ``fixed`` stay constant."""
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = principal_points
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    options.ceres.loss_function_scale = compute_tolerance_factor(job)
    options.ceres.solver_options.num_threads = job["cores"]
    # Stops at a relative decrease of 1e-6, far below the effect of pixel noise on the cameras.
    options.ceres.solver_options.function_tolerance = 1e-6
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in model.reg_image_ids():
        config.add_image(image_id)
    for camera_id in fixed:
        config.set_constant_cam_intrinsics(camera_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()
