"""Incremental mapping, and the final free-network bundle adjustment with the principal point free."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import pycolmap

from facadelake.errors import InputDataError
from facadelake.pose.worker.report import Report

# With fewer photographs of one camera its principal point trades off against their attitudes.
_PHOTOS_FOR_PRINCIPAL_POINT = 8
_FILTER_ROUNDS = 3
_LARGEST_ERROR_PX = 2.0
_SMALLEST_ANGLE_DEG = 1.5


def map_photographs(job: dict[str, Any], database_path: Path, report: Report) -> pycolmap.Reconstruction:
    """The largest block of photographs that can be brought together.

    Raises InputDataError where no two photographs overlap well enough to begin.
    """
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = job["settings"]["seed"]
    options.num_threads = job["cores"]
    options.min_model_size = 3
    options.image_path = job["photographs_root"]
    # At a building's corners, neighbours share one narrow face: fewer points than COLMAP's 30 must do.
    options.mapper.abs_pose_min_num_inliers = 20
    total = len(job["photos"])
    with report.step("Placing photographs", total), tempfile.TemporaryDirectory(dir=database_path.parent) as scratch:
        report_two = lambda: report.advance(2)  # noqa: E731 - the pipeline wants a callable without arguments
        models = pycolmap.incremental_mapping(
            database_path,
            job["photographs_root"],
            scratch,
            options=options,
            initial_image_pair_callback=report_two,
            next_image_callback=report.advance,
        )
    if not models:
        raise InputDataError(
            f"none of the {total} photographs could be placed: no pair shares enough of the scene; photograph with "
            "70 % overlap or more, and check that they show the same building"
        )
    return max(models.values(), key=lambda model: (model.num_reg_images(), model.num_points3D()))


def adjust(model: pycolmap.Reconstruction, job: dict[str, Any], report: Report) -> None:
    """Bundle adjustment in the free network, in place: OPENCV model, principal point free, outliers filtered between.

    The principal point of a consumer camera is off by tens of pixels; held at the image's centre it bends the block
    (castle: 12 cm instead of 3 cm at the cameras).
    """
    with report.step("Adjusting the block", _FILTER_ROUNDS):
        for _ in range(_FILTER_ROUNDS):
            options = pycolmap.BundleAdjustmentOptions()
            options.refine_principal_point = model.num_reg_images() >= _PHOTOS_FOR_PRINCIPAL_POINT
            options.print_summary = False
            options.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
            options.ceres.loss_function_scale = 1.0
            options.ceres.solver_options.num_threads = job["cores"]
            # The error falls no more than a millionth: far below what a pixel's noise moves the cameras by.
            options.ceres.solver_options.function_tolerance = 1e-6
            pycolmap.bundle_adjustment(model, options)
            pycolmap.ObservationManager(model).filter_all_points3D(_LARGEST_ERROR_PX, _SMALLEST_ANGLE_DEG)
            report.advance()
        model.update_point_3d_errors()
