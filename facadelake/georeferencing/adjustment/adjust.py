"""The georeferenced bundle adjustment of a block, from a start to posed cameras with their covariance."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array
from facadelake.core.camera import PosedCamera
from facadelake.core.frames import Similarity
from facadelake.georeferencing.adjustment.control_observations import (
    ControlObservations,
    MarkedPoints,
    SurfaceConstraint,
    build_lens_prior,
)
from facadelake.georeferencing.adjustment.linearise import (
    PRIOR_LOSS_SCALE,
    AdjustmentState,
    ParameterIndex,
    compute_cauchy_loss,
    compute_reprojection_residuals,
    initialise_state,
)
from facadelake.georeferencing.adjustment.point_to_plane import build_empty_terms, match_points_to_surface
from facadelake.georeferencing.adjustment.problem import AdjustmentProblem, Block, ImagePoints, PointPriors
from facadelake.georeferencing.adjustment.projection import LENS_PARAMETERS, camera_from_lens
from facadelake.georeferencing.adjustment.solve import CONVERGED_M, Solution, compute_covariance, solve_adjustment
from facadelake.georeferencing.adjustment.tie_points import (
    TiePointSelection,
    build_block,
    choose_tie_points,
    estimate_tie_variance_factor,
)
from facadelake.georeferencing.adjustment.uncertainty import (
    Uncertainty,
    compute_leave_one_out_residual,
    estimate_uncertainty,
)
from facadelake.sfm import Reconstruction

logger = logging.getLogger(__name__)

# The gate closes in from what a start by the model leaves to the relief of a facade; an early round need not settle,
# for its correspondences are looked for anew.
_SURFACE_ROUNDS = ((0.3, 2e-3), (0.2, 1e-3), (0.2, CONVERGED_M))
_SIGNIFICANCE_SIGMAS = 2.0
SHARED_POINT_LOSS_SCALE = 2.5  # surfaces change between campaigns: a point that moved loses its say early
_MIN_REMAINING_POINTS = 3  # control points that must remain when one is left out
_OPTIONAL_PARAMETERS = ("aspect", "k2", "p1", "p2")


@dataclass(frozen=True, kw_only=True, eq=False)
class Nodes:
    """Where each kind of node begins: tie points from 0, then ``marked`` points up to ``count``."""

    marked: int
    count: int


@dataclass(frozen=True, kw_only=True, eq=False)
class AdjustedBlock:
    """The adjusted block.

    ``covariance`` (n, 6, 6): each photograph's centre (m, site) and attitude (rad, about the camera's axes).
    ``xyz_site_m`` (t, 3): the tie points, with ``point_covariance_m2`` (t, 3, 3), which holds for given cameras.
    ``marked_xyz_site_m`` (p, 3): the marked points as adjusted. ``gps_offset_m`` (f, 3) and its sigma: what must be added
    to a flight's cameras to give their GPS. ``datum_covariance_m2`` (3, 3): of the mean camera.
    ``tie_variance_factor``: factor on the variance of image points for their correlation.
    """

    problem: AdjustmentProblem
    solution: Solution
    nodes: Nodes
    tie_points: TiePointSelection
    covariance: Float64Array
    uncertainty: Uncertainty
    gps_offset_m: Float64Array
    gps_offset_sigma_m: Float64Array
    datum_covariance_m2: Float64Array
    tie_variance_factor: float
    lens_sigma: Float64Array
    focal_height_correlation: float
    fixed_parameters: tuple[str, ...]

    @property
    def cameras(self) -> tuple[PosedCamera, ...]:
        """The posed cameras, in the reconstruction's order."""
        return build_posed_cameras(self.problem.block, self.solution.state)

    @property
    def xyz_site_m(self) -> Float64Array:
        """The tie points (t, 3) as adjusted."""
        return self.solution.state.xyz_site_m[: self.nodes.marked]

    @property
    def point_covariance_m2(self) -> Float64Array:
        """Covariance (t, 3, 3) of the tie points within the block, that is for given cameras."""
        return self.uncertainty.system.point_covariance_m2[: self.nodes.marked]

    @property
    def marked_xyz_site_m(self) -> Float64Array:
        """The marked points (p, 3) as adjusted."""
        return self.solution.state.xyz_site_m[self.nodes.marked :]


def build_posed_cameras(block: Block, state: AdjustmentState) -> tuple[PosedCamera, ...]:
    """The cameras of a state."""
    return tuple(
        PosedCamera(
            camera=camera_from_lens(state.lens[lens], block.cameras[lens]),
            site_from_cam=Similarity(rotation=rotation, translation=centre),
        )
        for lens, rotation, centre in zip(block.camera_of_photo, state.site_from_cam, state.centre_site_m, strict=True)
    )


def adjust_block(
    reconstruction: Reconstruction, site_from_sfm: Similarity, evidence: ControlObservations
) -> AdjustedBlock:
    """Adjust the block from ``site_from_sfm`` on.

    Where there is a model, its faces are looked for anew in each of three rounds. Lens terms that the
    photographs do not show to differ from nought are then held there, and the block is adjusted once more.
    Raises GeoreferenceError where the evidence leaves the block open.
    """
    ties = choose_tie_points(reconstruction, site_from_sfm)
    problem, nodes = _build_problem(reconstruction, site_from_sfm, ties, evidence)
    if evidence.model is None:
        solution = solve_adjustment(problem)
    else:
        # GPS alone would draw the block away from the model before the model is heard.
        state = initialise_state(problem)
        for gate_m, settled_m in _SURFACE_ROUNDS:
            problem = _update_point_to_plane(problem, ties, state, evidence.model, gate_m)
            state = replace(state, wall_deviation_m=np.zeros(len(problem.point_to_plane.wall_sigma_m)))
            solution = solve_adjustment(problem, state, settled_m=settled_m)
            state = solution.state
    free = _find_significant_parameters(problem, solution)
    if not free.all():
        problem = _fix_parameters(problem, free)
        mean = np.where(problem.lens_prior_sigma > 0, solution.state.lens, problem.lens_prior_mean)
        solution = solve_adjustment(problem, replace(solution.state, lens=mean))
    logger.info(
        "adjusted %d photographs, %d tie points: sigma %.2f px, %d steps",
        len(problem.block.centre_site_m),
        len(ties.reconstruction_point),
        solution.tie_sigma_px,
        solution.iterations,
    )
    return _build_adjusted_block(problem, nodes, ties, solution, free)


def compute_held_out_residuals(adjusted: AdjustedBlock, marked: MarkedPoints) -> dict[int, Float64Array]:
    """``given - predicted`` (3,), metres in site, of each control point when its survey is left out; empty where fewer
    than three would be left. Keys are rows of ``marked``."""
    held = np.flatnonzero(np.isfinite(marked.sigma_m).all(axis=1))
    if len(held) <= _MIN_REMAINING_POINTS:
        return {}
    left, variance = marked.xyz_site_m[held] - adjusted.marked_xyz_site_m[held], marked.sigma_m[held] ** 2
    # A point that is off has lost its say in the fit, so there is less of it to leave out.
    _, weight = compute_cauchy_loss((left**2 / variance).sum(axis=1), PRIOR_LOSS_SCALE)
    residual = compute_leave_one_out_residual(
        left, adjusted.uncertainty.compute_point_covariance(adjusted.nodes.marked + held), variance / weight[:, None]
    )
    return {int(row): left for row, left in zip(held, residual, strict=True)}


def _build_problem(
    reconstruction: Reconstruction, site_from_sfm: Similarity, ties: TiePointSelection, evidence: ControlObservations
) -> tuple[AdjustmentProblem, Nodes]:
    block = build_block(reconstruction, site_from_sfm)
    count = len(ties.reconstruction_point)
    marked = evidence.marked
    points = len(marked.names) if marked is not None else 0
    sightings = ImagePoints(
        photo=ties.photo,
        point=ties.point,
        offset_site_m=np.zeros((len(ties.photo), 3)),
        xy_img=ties.xy_img,
        whitening=np.broadcast_to(np.eye(2), (len(ties.photo), 2, 2)).copy(),
        is_tie_point=np.ones(len(ties.photo), dtype=bool),
    )
    xyz = ties.xyz_site_m
    priors = _build_shared_point_priors(evidence, ties)
    if marked is not None:
        sightings = _append_image_points(sightings, _build_mark_observations(marked, count))
        xyz = np.vstack([xyz, marked.xyz_site_m])
        priors = _append_priors(priors, _build_survey_priors(marked, count))
    mean, sigma = build_lens_prior(block.cameras, np.ones(len(LENS_PARAMETERS), dtype=bool))
    problem = AdjustmentProblem(
        block=block,
        initial_xyz_m=xyz,
        image_points=sightings,
        point_priors=priors,
        point_to_plane=build_empty_terms(),
        positions=evidence.positions,
        attitudes=evidence.attitudes,
        lens_prior_mean=mean,
        lens_prior_sigma=sigma,
    )
    return problem, Nodes(marked=count, count=count + points)


def _build_shared_point_priors(evidence: ControlObservations, ties: TiePointSelection) -> PointPriors:
    known = evidence.known
    if known is None:
        return PointPriors(
            point=np.zeros(0, dtype=np.int64),
            xyz_m=np.zeros((0, 3)),
            information=np.zeros((0, 3, 3)),
            loss_scale=np.zeros(0),
        )
    row = np.full(max(int(ties.reconstruction_point.max()), int(known.point.max())) + 1, -1)
    row[ties.reconstruction_point] = np.arange(len(ties.reconstruction_point))
    node = row[known.point]
    held = node >= 0
    return PointPriors(
        point=node[held],
        xyz_m=known.xyz_site_m[held],
        information=np.linalg.inv(known.covariance_m2[held]).astype(np.float64),
        loss_scale=np.full(int(held.sum()), SHARED_POINT_LOSS_SCALE),
    )


def _build_mark_observations(marked: MarkedPoints, first_node: int) -> ImagePoints:
    k = len(marked.photo)
    return ImagePoints(
        photo=marked.photo,
        point=first_node + marked.point,
        offset_site_m=np.zeros((k, 3)),
        xy_img=marked.xy_img,
        whitening=np.broadcast_to(np.eye(2) / marked.sigma_px, (k, 2, 2)).copy(),
        is_tie_point=np.zeros(k, dtype=bool),
    )


def _build_survey_priors(marked: MarkedPoints, first_node: int) -> PointPriors:
    held = np.flatnonzero(np.isfinite(marked.sigma_m).all(axis=1))
    information = np.zeros((len(held), 3, 3))
    information[:, np.arange(3), np.arange(3)] = 1.0 / marked.sigma_m[held] ** 2
    return PointPriors(
        point=first_node + held,
        xyz_m=marked.xyz_site_m[held],
        information=information,
        loss_scale=np.full(len(held), PRIOR_LOSS_SCALE),
    )


def _update_point_to_plane(
    problem: AdjustmentProblem, ties: TiePointSelection, state: AdjustmentState, model: SurfaceConstraint, gate_m: float
) -> AdjustmentProblem:
    """The problem with the model's faces as they are met from ``state``; older ones are dropped."""
    walls = match_points_to_surface(ties, state, model.surface, gate_m=gate_m, model_sigma_m=model.sigma_m)
    logger.debug("%d tie points on %d walls", len(walls.point), len(walls.wall_sigma_m))
    return replace(problem, point_to_plane=walls)


def _append_image_points(first: ImagePoints, second: ImagePoints) -> ImagePoints:
    return ImagePoints(
        photo=np.concatenate([first.photo, second.photo]),
        point=np.concatenate([first.point, second.point]),
        offset_site_m=np.concatenate([first.offset_site_m, second.offset_site_m]),
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


def _find_significant_parameters(problem: AdjustmentProblem, solution: Solution) -> BoolArray:
    """Which lens terms (c, 8) the photographs show to differ from a plain lens's, by more than two sigmas."""
    layout = ParameterIndex.build(problem)
    _, covariance = compute_covariance(problem, solution, 1.0)
    sigma = np.sqrt(np.diag(covariance)[layout.lens : layout.gps_offset]).reshape(-1, len(LENS_PARAMETERS))
    away = np.abs(solution.state.lens - problem.lens_prior_mean)
    optional = np.isin(LENS_PARAMETERS, _OPTIONAL_PARAMETERS)
    worth: BoolArray = ~optional | (away > _SIGNIFICANCE_SIGMAS * sigma)
    return worth


def _fix_parameters(problem: AdjustmentProblem, free: BoolArray) -> AdjustmentProblem:
    return replace(problem, lens_prior_sigma=np.where(free, problem.lens_prior_sigma, 0.0))


def _build_adjusted_block(
    problem: AdjustmentProblem, nodes: Nodes, ties: TiePointSelection, solution: Solution, free: BoolArray
) -> AdjustedBlock:
    state, layout = solution.state, ParameterIndex.build(problem)
    tie = problem.image_points.is_tie_point
    residual = compute_reprojection_residuals(problem, state, solution.tie_sigma_px)[tie]
    inflation = estimate_tie_variance_factor(
        residual, problem.image_points.photo[tie], problem.image_points.xy_img[tie]
    )
    uncertainty = estimate_uncertainty(problem, solution, nodes.marked, inflation)
    covariance = uncertainty.covariance
    photos = len(state.centre_site_m)
    blocks = covariance[: layout.lens, : layout.lens].reshape(photos, 6, photos, 6)
    centres = blocks[:, :3, :, :3]
    own = blocks[np.arange(photos), :, np.arange(photos), :]
    sigma = np.sqrt(np.diag(covariance))
    held = [
        f"{term} of camera {lens + 1}"
        for lens, row in enumerate(free)
        for term, is_free in zip(LENS_PARAMETERS, row, strict=True)
        if not is_free
    ]
    return AdjustedBlock(
        problem=problem,
        solution=solution,
        nodes=nodes,
        tie_points=ties,
        covariance=(own + own.transpose(0, 2, 1)) / 2,
        uncertainty=uncertainty,
        gps_offset_m=state.gps_offset_m,
        gps_offset_sigma_m=sigma[layout.gps_offset : layout.yaw].reshape(-1, 3),
        datum_covariance_m2=centres.mean(axis=(0, 2)),
        tie_variance_factor=inflation,
        lens_sigma=sigma[layout.lens : layout.gps_offset].reshape(-1, len(LENS_PARAMETERS)),
        focal_height_correlation=_compute_focal_height_correlation(covariance, layout, photos),
        fixed_parameters=tuple(held),
    )


def _compute_focal_height_correlation(covariance: Float64Array, layout: ParameterIndex, photos: int) -> float:
    """Largest correlation (absolute) of a lens's focal length with the block's mean height: near 1, an error of the
    lens is an error of height."""
    height = covariance[:, 2 : layout.lens : 6].mean(axis=1)
    variance = float(height[2 : layout.lens : 6].mean())
    focal = np.arange(layout.lens, layout.gps_offset, len(LENS_PARAMETERS))
    spread = np.sqrt(np.diag(covariance)[focal] * max(variance, 1e-18))
    return float(np.abs(height[focal] / spread).max())
