"""Incremental mapping, and the final free-network bundle adjustment with the principal point free."""

from __future__ import annotations

import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import pycolmap

from facadelake.core.errors import InputDataError
from facadelake.sfm.worker.report import ProgressReport

# With fewer photographs of one camera its principal point trades off against their attitudes.
_MIN_PHOTOS_FOR_PRINCIPAL_POINT = 8
_FILTER_ROUNDS = 3
_MAX_ERROR_PX = 2.0
_MIN_ANGLE_DEG = 1.5
# Photographs are reduced to find features; a keypoint's noise grows as they are. The tolerances in pixels here and in
# COLMAP hold up to this reduction and grow beyond it.
_REFERENCE_REDUCTION = 1.6
_MAX_ATTEMPTS = 3
_SUFFICIENT_SHARE = 0.5
_SNAPSHOTS = 12
_COMPLETE = "whole"  # a file that marks a snapshot or a folder of models as completely written


def compute_tolerance_factor(job: dict[str, Any]) -> float:
    """By how much tolerances in pixels of the photographs are widened, for features found on much reduced ones."""
    longest = max(float(max(camera["width_px"], camera["height_px"])) for camera in job["cameras"])
    return max(1.0, longest / float(job["settings"]["max_image_px"]) / _REFERENCE_REDUCTION)


def map_photographs(job: dict[str, Any], database_path: Path, report: ProgressReport) -> list[pycolmap.Reconstruction]:
    """The blocks of photographs that can be brought together, the largest first; a killed run's work goes on.

    Where overlap is weak the pair to begin with decides how far a block grows: if less than half of the photographs
    come into one block, others are tried. Raises InputDataError where no two photographs overlap well enough to begin.
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
            f"none of the {total} photographs could be placed: no pair shares enough of the scene; photograph with "
            "70 % overlap or more, and check that they show the same building"
        )
    return best


def _map_once(
    job: dict[str, Any], database_path: Path, attempt: int, report: ProgressReport
) -> list[pycolmap.Reconstruction]:
    """The blocks of one attempt, from its models if it was finished, or from its last snapshot if it was begun."""
    models_folder = database_path.with_name(f"models-{attempt}")
    snapshots = database_path.with_name(f"snapshots-{attempt}")
    if (models_folder / _COMPLETE).exists():
        return [pycolmap.Reconstruction(folder) for folder in models_folder.iterdir() if folder.is_dir()]
    snapshots.mkdir(exist_ok=True)
    begun = _find_newest_snapshot(snapshots)
    with report.step("Placing photographs", len(job["photos"])):
        report.advance(pycolmap.Reconstruction(begun).num_reg_images() if begun else 0)

        def placed(count: int = 1) -> None:
            report.advance(count)
            _keep_newest_snapshot(snapshots)

        shutil.rmtree(models_folder, ignore_errors=True)
        models_folder.mkdir()
        models = pycolmap.incremental_mapping(
            database_path,
            job["photographs_root"],
            models_folder,
            options=_configure_mapper(job, snapshots, job["settings"]["seed"] + attempt),
            input_path=str(begun) if begun else "",
            initial_image_pair_callback=lambda: placed(2),
            next_image_callback=placed,
        )
    (models_folder / _COMPLETE).touch()
    shutil.rmtree(snapshots)
    return list(models.values())


def _measure_size(model: pycolmap.Reconstruction) -> tuple[int, int]:
    return model.num_reg_images(), model.num_points3D()


def _configure_mapper(job: dict[str, Any], snapshots: Path, seed: int) -> pycolmap.IncrementalPipelineOptions:
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = seed
    options.num_threads = job["cores"]
    options.min_model_size = 3
    options.max_num_models = 10
    options.image_path = job["photographs_root"]
    options.snapshot_path = str(snapshots)
    options.snapshot_frames_freq = max(len(job["photos"]) // _SNAPSHOTS, 3)
    # The block is adjusted at the end, free and then on the globe: on the way it need not be perfect. Fewer and looser
    # adjustments take half the time of COLMAP's defaults and end at the same cameras (benchmarks/scale.py).
    options.ba_global_frames_ratio = options.ba_global_points_ratio = 1.4
    options.ba_global_max_refinements = 2
    options.ba_global_function_tolerance = options.ba_local_function_tolerance = 1e-6
    # At a building's corners, neighbours share one narrow face: fewer points than COLMAP's 30 must do.
    options.mapper.abs_pose_min_num_inliers = 20
    factor = compute_tolerance_factor(job)
    options.mapper.filter_max_reproj_error *= factor
    options.mapper.abs_pose_max_error *= factor
    options.mapper.init_max_error *= factor
    options.triangulation.merge_max_reproj_error *= factor
    options.triangulation.complete_max_reproj_error *= factor
    return options


def _keep_newest_snapshot(snapshots: Path) -> None:
    """Mark the newest snapshot as whole (COLMAP writes none while it reports a photograph) and drop the others."""
    written = sorted(snapshots.iterdir())
    for newest in written[-1:]:
        (newest / _COMPLETE).touch()
    for older in written[:-1]:
        shutil.rmtree(older)


def _find_newest_snapshot(snapshots: Path) -> Path | None:
    whole = sorted(folder for folder in snapshots.iterdir() if (folder / _COMPLETE).exists())
    return whole[-1] if whole else None


def adjust_block(model: pycolmap.Reconstruction, job: dict[str, Any], report: ProgressReport) -> None:
    """Bundle adjustment in the free network, in place: principal points free, outliers filtered between.

    The principal point of a consumer camera is off by tens of pixels; held at the image's centre it bends the block
    (castle: 12 cm instead of 3 cm at the cameras). That of a camera with few photographs stays in the middle.
    """
    taken = Counter(model.images[image_id].camera_id for image_id in model.reg_image_ids())
    few = [camera_id for camera_id, count in taken.items() if count < _MIN_PHOTOS_FOR_PRINCIPAL_POINT]
    with report.step("Adjusting the block", _FILTER_ROUNDS):
        for _ in range(_FILTER_ROUNDS):
            if len(few) < len(taken):
                _adjust_once(model, job, principal_points=True, held=few)
            if few:
                _adjust_once(model, job, principal_points=False, held=[])
            largest_px = _MAX_ERROR_PX * compute_tolerance_factor(job)
            pycolmap.ObservationManager(model).filter_all_points3D(largest_px, _MIN_ANGLE_DEG)
            report.advance()
        model.update_point_3d_errors()


def _adjust_once(
    model: pycolmap.Reconstruction, job: dict[str, Any], *, principal_points: bool, held: list[int]
) -> None:
    """One adjustment; the cameras ``held`` keep their intrinsics."""
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = principal_points
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    options.ceres.loss_function_scale = compute_tolerance_factor(job)
    options.ceres.solver_options.num_threads = job["cores"]
    # The error falls no more than a millionth: far below what a pixel's noise moves the cameras by.
    options.ceres.solver_options.function_tolerance = 1e-6
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in model.reg_image_ids():
        config.add_image(image_id)
    for camera_id in held:
        config.set_constant_cam_intrinsics(camera_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()
