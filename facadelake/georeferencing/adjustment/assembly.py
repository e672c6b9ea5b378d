"""Assembly of the adjustment problem: object points (tie points first, then marked points) and their control."""

from __future__ import annotations

import numpy as np

from facadelake.core.frames import Similarity
from facadelake.georeferencing.adjustment.control_observations import (
    ControlObservations,
    MarkedPoints,
    SharedTiePoints,
)
from facadelake.georeferencing.adjustment.linearise import PRIOR_LOSS_SCALE
from facadelake.georeferencing.adjustment.point_to_plane import build_empty_terms
from facadelake.georeferencing.adjustment.problem import AdjustmentProblem, ImagePoints, PointPriors
from facadelake.georeferencing.adjustment.projection import build_lens_prior
from facadelake.georeferencing.adjustment.tie_points import TiePointSelection, build_block
from facadelake.sfm import Reconstruction

SHARED_POINT_LOSS_SCALE = 2.5  # surfaces change between campaigns: a point that moved is down-weighted early


def build_problem(
    reconstruction: Reconstruction,
    site_from_sfm: Similarity,
    tie_points: TiePointSelection,
    control: ControlObservations,
) -> AdjustmentProblem:
    """The adjustment of a block with its control, without point-to-plane observations.

    Args:
        reconstruction: the block.
        site_from_sfm: its initial placement.
        tie_points: the tie points that take part; they are the first object points.
        control: GPS, attitudes, marked points (the object points after the tie points), shared tie points.

    Returns:
        the problem with its initial values.
    """
    block = build_block(reconstruction, site_from_sfm)
    count = len(tie_points)
    image_points = ImagePoints(
        photo=tie_points.photo,
        point=tie_points.point,
        xy_img=tie_points.xy_img,
        whitening=np.broadcast_to(np.eye(2), (len(tie_points.photo), 2, 2)).copy(),
        is_tie_point=np.ones(len(tie_points.photo), dtype=bool),
    )
    xyz = tie_points.xyz_site_m
    priors = _build_shared_point_priors(control.shared, tie_points)
    marked = control.marked
    if marked is not None:
        image_points = _append_image_points(image_points, _build_mark_observations(marked, count))
        initial = marked.initial_xyz_site_m
        xyz = np.vstack([xyz, marked.xyz_site_m if initial is None else initial])
        priors = _append_priors(priors, _build_survey_priors(marked, count))
    mean, sigma = build_lens_prior(block.cameras)
    return AdjustmentProblem(
        block=block,
        initial_xyz_m=xyz,
        image_points=image_points,
        point_priors=priors,
        point_to_plane=build_empty_terms(),
        positions=control.positions,
        attitudes=control.attitudes,
        lens_prior_mean=mean,
        lens_prior_sigma=sigma,
    )


def _build_shared_point_priors(shared: SharedTiePoints | None, tie_points: TiePointSelection) -> PointPriors:
    """Priors of the selected tie points that an earlier campaign determined too."""
    if shared is None:
        return PointPriors(
            point=np.zeros(0, dtype=np.int64),
            xyz_m=np.zeros((0, 3)),
            information=np.zeros((0, 3, 3)),
            loss_scale=np.zeros(0),
        )
    row = np.full(max(int(tie_points.reconstruction_point.max()), int(shared.point.max())) + 1, -1)
    row[tie_points.reconstruction_point] = np.arange(len(tie_points))
    point = row[shared.point]
    selected = point >= 0
    return PointPriors(
        point=point[selected],
        xyz_m=shared.xyz_site_m[selected],
        information=np.linalg.inv(shared.covariance_m2[selected]).astype(np.float64),
        loss_scale=np.full(int(selected.sum()), SHARED_POINT_LOSS_SCALE),
    )


def _build_mark_observations(marked: MarkedPoints, first_point: int) -> ImagePoints:
    k = len(marked.photo)
    return ImagePoints(
        photo=marked.photo,
        point=first_point + marked.point,
        xy_img=marked.xy_img,
        whitening=np.broadcast_to(np.eye(2) / marked.sigma_px, (k, 2, 2)).copy(),
        is_tie_point=np.zeros(k, dtype=bool),
    )


def _build_survey_priors(marked: MarkedPoints, first_point: int) -> PointPriors:
    """Priors of the control points; check points have none."""
    control = np.flatnonzero(np.isfinite(marked.sigma_m).all(axis=1))
    information = np.zeros((len(control), 3, 3))
    information[:, np.arange(3), np.arange(3)] = 1.0 / marked.sigma_m[control] ** 2
    return PointPriors(
        point=first_point + control,
        xyz_m=marked.xyz_site_m[control],
        information=information,
        loss_scale=np.full(len(control), PRIOR_LOSS_SCALE),
    )


def _append_image_points(first: ImagePoints, second: ImagePoints) -> ImagePoints:
    return ImagePoints(
        photo=np.concatenate([first.photo, second.photo]),
        point=np.concatenate([first.point, second.point]),
        xy_img=np.concatenate([first.xy_img, second.xy_img]),
        whitening=np.concatenate([first.whitening, second.whitening]),
        is_tie_point=np.concatenate([first.is_tie_point, second.is_tie_point]),
    )


def _append_priors(first: PointPriors, second: PointPriors) -> PointPriors:
    return PointPriors(
        point=np.concatenate([first.point, second.point]),
        xyz_m=np.concatenate([first.xyz_m, second.xyz_m]),
        information=np.concatenate([first.information, second.information]),
        loss_scale=np.concatenate([first.loss_scale, second.loss_scale]),
    )
