"""The georeferenced bundle adjustment of a block, from a start to posed cameras with their covariance."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array
from facadelake.core.camera import PosedCamera
from facadelake.core.frames import Similarity
from facadelake.georeferencing.adjustment.evidence import Evidence, MarkedPoints, ModelEvidence, lens_beforehand
from facadelake.georeferencing.adjustment.linearise import (
    PRIOR_LIMIT,
    Layout,
    State,
    cauchy,
    sighting_residuals,
    start_of,
)
from facadelake.georeferencing.adjustment.model_terms import no_walls, walls_of
from facadelake.georeferencing.adjustment.problem import Block, NodePriors, Problem, Sightings
from facadelake.georeferencing.adjustment.projection import LENS_TERMS, camera_of
from facadelake.georeferencing.adjustment.solve import SETTLED_M, Solution, covariance_of, solve
from facadelake.georeferencing.adjustment.tie_points import Ties, block_of, choose_ties, inflation_of
from facadelake.georeferencing.adjustment.uncertainty import Uncertainty, residual_when_left_out, uncertainty_of
from facadelake.sfm import Reconstruction

logger = logging.getLogger(__name__)

# The gate closes in from what a start by the model leaves to the relief of a facade; an early round need not settle,
# for its correspondences are looked for anew.
_MODEL_ROUNDS = ((0.3, 2e-3), (0.2, 1e-3), (0.2, SETTLED_M))
_SIGNIFICANT = 2.0
KNOWN_POINT_LIMIT = 2.5  # surfaces change between campaigns: a point that moved loses its say early
_LEAST_LEFT = 3  # control points that must remain when one is left out
_OPTIONAL_TERMS = ("aspect", "k2", "p1", "p2")


@dataclass(frozen=True, kw_only=True, eq=False)
class Nodes:
    """Where each kind of node begins: tie points from 0, then ``marked`` points up to ``count``."""

    marked: int
    count: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Adjusted:
    """The adjusted block.

    ``covariance`` (n, 6, 6): each photograph's centre (m, site) and attitude (rad, about the camera's axes).
    ``xyz_site_m`` (t, 3): the tie points, with ``point_covariance_m2`` (t, 3, 3), which holds for given cameras.
    ``marked_site_m`` (p, 3): the marked points as adjusted. ``gps_offset_m`` (f, 3) and its sigma: what must be added
    to a flight's cameras to give their GPS. ``datum_covariance_m2`` (3, 3): of the mean camera.
    ``tie_variance_factor``: factor on the variance of image points for their correlation.
    """

    problem: Problem
    solution: Solution
    nodes: Nodes
    ties: Ties
    covariance: Float64Array
    uncertainty: Uncertainty
    gps_offset_m: Float64Array
    gps_offset_sigma_m: Float64Array
    datum_covariance_m2: Float64Array
    tie_variance_factor: float
    lens_sigma: Float64Array
    focal_height_correlation: float
    held_terms: tuple[str, ...]

    @property
    def cameras(self) -> tuple[PosedCamera, ...]:
        """The posed cameras, in the reconstruction's order."""
        return posed(self.problem.block, self.solution.state)

    @property
    def xyz_site_m(self) -> Float64Array:
        """The tie points (t, 3) as adjusted."""
        return self.solution.state.node_m[: self.nodes.marked]

    @property
    def point_covariance_m2(self) -> Float64Array:
        """Covariance (t, 3, 3) of the tie points within the block, that is for given cameras."""
        return self.uncertainty.system.node_covariance[: self.nodes.marked]

    @property
    def marked_site_m(self) -> Float64Array:
        """The marked points (p, 3) as adjusted."""
        return self.solution.state.node_m[self.nodes.marked :]


def posed(block: Block, state: State) -> tuple[PosedCamera, ...]:
    """The cameras of a state."""
    return tuple(
        PosedCamera(
            camera=camera_of(state.lens[lens], block.cameras[lens]),
            site_from_cam=Similarity(rotation=rotation, translation=centre),
        )
        for lens, rotation, centre in zip(block.camera_of_photo, state.site_from_cam, state.centre_site_m, strict=True)
    )


def adjust(reconstruction: Reconstruction, site_from_sfm: Similarity, evidence: Evidence) -> Adjusted:
    """Adjust the block from ``site_from_sfm`` on.

    Where there is a model, its faces are looked for anew in each of three rounds. Lens terms that the
    photographs do not show to differ from nought are then held there, and the block is adjusted once more.
    Raises GeoreferenceError where the evidence leaves the block open.
    """
    ties = choose_ties(reconstruction, site_from_sfm)
    problem, nodes = _problem(reconstruction, site_from_sfm, ties, evidence)
    if evidence.model is None:
        solution = solve(problem)
    else:
        # GPS alone would draw the block away from the model before the model is heard.
        state = start_of(problem)
        for gate_m, settled_m in _MODEL_ROUNDS:
            problem = _with_walls(problem, ties, state, evidence.model, gate_m)
            state = replace(state, wall_m=np.zeros(len(problem.walls.wall_sigma_m)))
            solution = solve(problem, state, settled_m=settled_m)
            state = solution.state
    free = _worth_freeing(problem, solution)
    if not free.all():
        problem = _holding(problem, free)
        mean = np.where(problem.lens_sigma > 0, solution.state.lens, problem.lens_mean)
        solution = solve(problem, replace(solution.state, lens=mean))
    logger.info(
        "adjusted %d photographs, %d tie points: sigma %.2f px, %d steps",
        len(problem.block.centre_site_m),
        len(ties.point),
        solution.tie_sigma_px,
        solution.steps,
    )
    return _described(problem, nodes, ties, solution, free)


def held_out_residuals(adjusted: Adjusted, marked: MarkedPoints) -> dict[int, Float64Array]:
    """``given - predicted`` (3,), metres in site, of each control point when its survey is left out; empty where fewer
    than three would be left. Keys are rows of ``marked``."""
    held = np.flatnonzero(np.isfinite(marked.sigma_m).all(axis=1))
    if len(held) <= _LEAST_LEFT:
        return {}
    left, variance = marked.xyz_site_m[held] - adjusted.marked_site_m[held], marked.sigma_m[held] ** 2
    # A point that is off has lost its say in the fit, so there is less of it to leave out.
    _, weight = cauchy((left**2 / variance).sum(axis=1), PRIOR_LIMIT)
    residual = residual_when_left_out(
        left, adjusted.uncertainty.node_covariance(adjusted.nodes.marked + held), variance / weight[:, None]
    )
    return {int(row): left for row, left in zip(held, residual, strict=True)}


def _problem(
    reconstruction: Reconstruction, site_from_sfm: Similarity, ties: Ties, evidence: Evidence
) -> tuple[Problem, Nodes]:
    block = block_of(reconstruction, site_from_sfm)
    count = len(ties.point)
    marked = evidence.marked
    points = len(marked.names) if marked is not None else 0
    sightings = Sightings(
        photo=ties.photo,
        node=ties.node,
        offset_site_m=np.zeros((len(ties.photo), 3)),
        xy_img=ties.xy_img,
        whitening=np.broadcast_to(np.eye(2), (len(ties.photo), 2, 2)).copy(),
        tie=np.ones(len(ties.photo), dtype=bool),
    )
    xyz = ties.xyz_site_m
    priors = _known_points(evidence, ties)
    if marked is not None:
        sightings = _joined(sightings, _marks(marked, count))
        xyz = np.vstack([xyz, marked.xyz_site_m])
        priors = _joined_priors(priors, _surveyed(marked, count))
    mean, sigma = lens_beforehand(block.cameras, np.ones(len(LENS_TERMS), dtype=bool))
    problem = Problem(
        block=block,
        node_xyz_m=xyz,
        sightings=sightings,
        node_priors=priors,
        walls=no_walls(),
        positions=evidence.positions,
        attitudes=evidence.attitudes,
        lens_mean=mean,
        lens_sigma=sigma,
    )
    return problem, Nodes(marked=count, count=count + points)


def _known_points(evidence: Evidence, ties: Ties) -> NodePriors:
    known = evidence.known
    if known is None:
        return NodePriors(
            node=np.zeros(0, dtype=np.int64),
            xyz_m=np.zeros((0, 3)),
            information=np.zeros((0, 3, 3)),
            limit=np.zeros(0),
        )
    row = np.full(max(int(ties.point.max()), int(known.point.max())) + 1, -1)
    row[ties.point] = np.arange(len(ties.point))
    node = row[known.point]
    held = node >= 0
    return NodePriors(
        node=node[held],
        xyz_m=known.xyz_site_m[held],
        information=np.linalg.inv(known.covariance_m2[held]).astype(np.float64),
        limit=np.full(int(held.sum()), KNOWN_POINT_LIMIT),
    )


def _marks(marked: MarkedPoints, first_node: int) -> Sightings:
    k = len(marked.photo)
    return Sightings(
        photo=marked.photo,
        node=first_node + marked.point,
        offset_site_m=np.zeros((k, 3)),
        xy_img=marked.xy_img,
        whitening=np.broadcast_to(np.eye(2) / marked.sigma_px, (k, 2, 2)).copy(),
        tie=np.zeros(k, dtype=bool),
    )


def _surveyed(marked: MarkedPoints, first_node: int) -> NodePriors:
    held = np.flatnonzero(np.isfinite(marked.sigma_m).all(axis=1))
    information = np.zeros((len(held), 3, 3))
    information[:, np.arange(3), np.arange(3)] = 1.0 / marked.sigma_m[held] ** 2
    return NodePriors(
        node=first_node + held,
        xyz_m=marked.xyz_site_m[held],
        information=information,
        limit=np.full(len(held), PRIOR_LIMIT),
    )


def _with_walls(problem: Problem, ties: Ties, state: State, model: ModelEvidence, gate_m: float) -> Problem:
    """The problem with the model's faces as they are met from ``state``; older ones are dropped."""
    walls = walls_of(ties, state, model.surface, gate_m=gate_m, model_sigma_m=model.sigma_m)
    logger.debug("%d tie points on %d walls", len(walls.node), len(walls.wall_sigma_m))
    return replace(problem, walls=walls)


def _joined(first: Sightings, second: Sightings) -> Sightings:
    return Sightings(
        photo=np.concatenate([first.photo, second.photo]),
        node=np.concatenate([first.node, second.node]),
        offset_site_m=np.concatenate([first.offset_site_m, second.offset_site_m]),
        xy_img=np.concatenate([first.xy_img, second.xy_img]),
        whitening=np.concatenate([first.whitening, second.whitening]),
        tie=np.concatenate([first.tie, second.tie]),
    )


def _joined_priors(first: NodePriors, second: NodePriors) -> NodePriors:
    return NodePriors(
        node=np.concatenate([first.node, second.node]),
        xyz_m=np.concatenate([first.xyz_m, second.xyz_m]),
        information=np.concatenate([first.information, second.information]),
        limit=np.concatenate([first.limit, second.limit]),
    )


def _worth_freeing(problem: Problem, solution: Solution) -> BoolArray:
    """Which lens terms (c, 8) the photographs show to differ from a plain lens's, by more than two sigmas."""
    layout = Layout.of(problem)
    _, covariance = covariance_of(problem, solution, 1.0)
    sigma = np.sqrt(np.diag(covariance)[layout.lens : layout.offset]).reshape(-1, len(LENS_TERMS))
    away = np.abs(solution.state.lens - problem.lens_mean)
    optional = np.isin(LENS_TERMS, _OPTIONAL_TERMS)
    worth: BoolArray = ~optional | (away > _SIGNIFICANT * sigma)
    return worth


def _holding(problem: Problem, free: BoolArray) -> Problem:
    return replace(problem, lens_sigma=np.where(free, problem.lens_sigma, 0.0))


def _described(problem: Problem, nodes: Nodes, ties: Ties, solution: Solution, free: BoolArray) -> Adjusted:
    state, layout = solution.state, Layout.of(problem)
    tie = problem.sightings.tie
    residual = sighting_residuals(problem, state, solution.tie_sigma_px)[tie]
    inflation = inflation_of(residual, problem.sightings.photo[tie], problem.sightings.xy_img[tie])
    uncertainty = uncertainty_of(problem, solution, nodes.marked, inflation)
    covariance = uncertainty.covariance
    photos = len(state.centre_site_m)
    blocks = covariance[: layout.lens, : layout.lens].reshape(photos, 6, photos, 6)
    centres = blocks[:, :3, :, :3]
    own = blocks[np.arange(photos), :, np.arange(photos), :]
    sigma = np.sqrt(np.diag(covariance))
    held = [
        f"{term} of camera {lens + 1}"
        for lens, row in enumerate(free)
        for term, is_free in zip(LENS_TERMS, row, strict=True)
        if not is_free
    ]
    return Adjusted(
        problem=problem,
        solution=solution,
        nodes=nodes,
        ties=ties,
        covariance=(own + own.transpose(0, 2, 1)) / 2,
        uncertainty=uncertainty,
        gps_offset_m=state.gps_offset_m,
        gps_offset_sigma_m=sigma[layout.offset : layout.yaw].reshape(-1, 3),
        datum_covariance_m2=centres.mean(axis=(0, 2)),
        tie_variance_factor=inflation,
        lens_sigma=sigma[layout.lens : layout.offset].reshape(-1, len(LENS_TERMS)),
        focal_height_correlation=_focal_height_correlation(covariance, layout, photos),
        held_terms=tuple(held),
    )


def _focal_height_correlation(covariance: Float64Array, layout: Layout, photos: int) -> float:
    """Largest correlation (absolute) of a lens's focal length with the block's mean height: near 1, an error of the
    lens is an error of height."""
    height = covariance[:, 2 : layout.lens : 6].mean(axis=1)
    variance = float(height[2 : layout.lens : 6].mean())
    focal = np.arange(layout.lens, layout.offset, len(LENS_TERMS))
    spread = np.sqrt(np.diag(covariance)[focal] * max(variance, 1e-18))
    return float(np.abs(height[focal] / spread).max())
