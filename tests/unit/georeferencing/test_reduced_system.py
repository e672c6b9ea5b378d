"""The reduced camera system against the complete dense normal equations, by OpenCV and difference quotients."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from facadelake.georeferencing.adjustment.parameters import (
    AdjustmentState,
    ParameterIndex,
    apply_step,
    initialise_state,
)
from facadelake.georeferencing.adjustment.problem import AdjustmentProblem, AttitudeTerms, PointPriors
from facadelake.georeferencing.adjustment.reduced_system import build_reduced_system, compute_cost
from facadelake.georeferencing.adjustment.solve import Solution, compute_covariance, solve_adjustment
from facadelake.georeferencing.adjustment.uncertainty import Uncertainty, compute_leave_one_out_residual
from tests.unit.georeferencing.small_block import (
    add_control,
    add_gps,
    add_walls,
    build_small_block,
    build_tie_point_problem,
    fix_lens,
)

SIGMA_PX = 0.6


def build_complete_problem() -> AdjustmentProblem:
    """Six photographs, two lenses, tie points, lines, surveyed points, walls, GPS of two flights, attitudes."""
    rng = np.random.default_rng(4)
    block = build_small_block(photographs=6, points=30)
    problem = build_tie_point_problem(block, rng, tie_px=0.7, start_m=0.01, start_deg=0.05)
    problem = add_control(problem, block, rng, nodes=np.array([1, 5, 9]), sigma_m=0.02)
    problem = add_gps(problem, block, rng, noise_m=0.3, bias_m=[[1.0, 0, 2], [0, -1, 0.5]], bias_sigma_m=2.0)
    problem = add_walls(
        problem,
        block,
        rng,
        relief_m=0.03,
        wall_deviation_m=np.array([0.02, -0.03, 0.0, 0.01, -0.02]),
        wall_sigma_m=0.03,
    )
    walls = problem.point_to_plane
    problem = replace(
        problem, point_to_plane=replace(walls, wall=np.where(np.arange(len(walls.wall)) % 4, walls.wall, -1))
    )
    # Two points of an edge that three photographs show as a line: whitening of rank one.
    edge = len(problem.initial_xyz_m)
    on_edge = np.array([[5.0, -4.0, 2.0], [5.0, -4.0, 5.0]])
    image_points = problem.image_points
    photos = np.array([0, 4, 5, 0, 4, 5])
    number = np.array([0, 0, 0, 1, 1, 1])
    xy = np.array([block.cameras[p].project_site(x[None])[0] for p, x in zip(photos, on_edge[number], strict=True)])
    angle = rng.uniform(0, 2 * np.pi, 6)
    line = np.zeros((6, 2, 2))
    line[:, 0] = np.column_stack([np.cos(angle), np.sin(angle)]) / 1.5
    image_points = replace(
        image_points,
        photo=np.concatenate([image_points.photo, photos]),
        point=np.concatenate([image_points.point, edge + number]),
        xy_img=np.vstack([image_points.xy_img, xy + rng.normal(0, 1.5, xy.shape)]),
        whitening=np.concatenate([image_points.whitening, line]),
        is_tie_point=np.concatenate([image_points.is_tie_point, np.zeros(6, dtype=bool)]),
    )
    priors = problem.point_priors
    factor = rng.normal(size=(2, 3, 3))
    return fix_lens(
        replace(
            problem,
            block=replace(
                problem.block,
                cameras=(problem.block.cameras[0], replace(problem.block.cameras[0], fx_px=2850.0, k1=-0.05, p1=1e-3)),
                camera_of_photo=np.array([0, 1, 0, 1, 0, 1]),
            ),
            lens_prior_mean=np.vstack([problem.lens_prior_mean, problem.lens_prior_mean + 0.001]),
            lens_prior_sigma=np.vstack([problem.lens_prior_sigma, problem.lens_prior_sigma]),
            initial_xyz_m=np.vstack([problem.initial_xyz_m, on_edge + np.array([0.01, -0.02, 0.0])]),
            image_points=image_points,
            point_priors=PointPriors(
                point=np.append(priors.point, [edge, edge + 1]),
                xyz_m=np.vstack([priors.xyz_m, on_edge]),
                information=np.concatenate([priors.information, 900 * (np.eye(3) + factor @ factor.mT)]),
                loss_scale=np.append(priors.loss_scale, [2.5, 2.5]),
            ),
            # Gauss-Newton takes an attitude's derivative at a residual of zero, so residuals are small here.
            attitudes=AttitudeTerms(
                photo=np.array([0, 2, 3]),
                flight=np.array([0, 0, 1]),
                site_from_cam=Rotation.from_rotvec(rng.normal(0, 1e-4, (3, 3))).as_matrix()
                @ problem.block.site_from_cam[[0, 2, 3]],
                sigma_rad=np.full((3, 3), 1e-4),
                yaw_sigma_rad=np.array([0.1, 0.08]),
            ),
        ),
        "aspect", "p2",
    )  # fmt: skip


@dataclass(frozen=True)
class Group:
    """Whitened residuals (k, d), scale of Cauchy's loss (None: not robust); ``share`` divides their square in it."""

    residual: np.ndarray
    loss_scale: np.ndarray | float | None
    share: float = 1.0


def list_groups(problem: AdjustmentProblem, state: AdjustmentState) -> list[Group]:
    """Every observation, written out by hand from the definitions in ``problem``."""
    seen, block = problem.image_points, problem.block
    xy = np.empty_like(seen.xy_img)
    for photo in np.unique(seen.photo):
        own = seen.photo == photo
        focal, aspect, cx, cy, *distortion = state.lens[block.camera_of_photo[photo]]
        cam_from_site = state.site_from_cam[photo].T
        xy[own] = cv2.projectPoints(
            state.xyz_site_m[seen.point[own]],
            cv2.Rodrigues(cam_from_site)[0],
            -cam_from_site @ state.centre_site_m[photo],
            np.array([[focal, 0, cx], [0, focal * aspect, cy], [0, 0, 1.0]]),
            np.array(distortion),
        )[0].reshape(-1, 2)
    pixels = np.einsum("kij,kj->ki", seen.whitening, xy - seen.xy_img)
    pixels[seen.is_tie_point] /= SIGMA_PX
    walls, priors, gps, gimbal = problem.point_to_plane, problem.point_priors, problem.positions, problem.attitudes
    off = np.array([state.wall_deviation_m[w] if w >= 0 else 0.0 for w in walls.wall])
    wall = (np.sum(walls.normal_site * state.xyz_site_m[walls.point], axis=1) - walls.distance_m - off) / walls.sigma_m
    known = np.array(
        [np.linalg.cholesky(i).T @ (state.xyz_site_m[n] - x)
         for n, x, i in zip(priors.point, priors.xyz_m, priors.information, strict=True)]
    )  # fmt: skip
    position = (state.centre_site_m[gps.photo] + state.gps_offset_m[gps.flight] - gps.xyz_site_m) / gps.sigma_m
    turn = (
        Rotation.from_matrix(state.site_from_cam[gimbal.photo]) * Rotation.from_matrix(gimbal.site_from_cam).inv()
    ).as_rotvec()
    turn[:, 2] -= state.yaw_offset_rad[gimbal.flight]
    free = problem.lens_prior_sigma > 0
    lens = ((state.lens - problem.lens_prior_mean)[free] / problem.lens_prior_sigma[free])[:, None]
    return [
        Group(pixels, 2.4),
        Group(wall[:, None], 2.0),
        Group(known, priors.loss_scale),
        Group(position, 4.0, 3.0),
        Group(turn / gimbal.sigma_rad, 4.0, 3.0),
        Group(lens, None),
        Group((state.gps_offset_m / gps.offset_sigma_m).ravel()[:, None], None),
        Group((state.yaw_offset_rad / gimbal.yaw_sigma_rad)[:, None], None),
        Group((state.wall_deviation_m / walls.wall_sigma_m)[:, None], None),
    ]


def compute_robust_cost(groups: list[Group]) -> float:
    """The cost by Cauchy's loss, limit^2 log(1 + s / limit^2)."""
    cost = 0.0
    for group in groups:
        squared = (group.residual**2).sum(axis=1) / group.share
        loss = squared if group.loss_scale is None else group.loss_scale**2 * np.log1p(squared / group.loss_scale**2)
        cost += float(group.share * loss.sum())
    return cost


def compute_weights(groups: list[Group]) -> np.ndarray:
    """The weights of reweighted least squares, one for each scalar residual."""
    out = []
    for group in groups:
        squared = (group.residual**2).sum(axis=1) / group.share
        weight = np.ones(len(squared)) if group.loss_scale is None else 1 / (1 + squared / group.loss_scale**2)
        out.append(np.repeat(weight, group.residual.shape[1]))
    return np.concatenate(out)


@dataclass(frozen=True)
class DenseSystem:
    """The whole problem: ``matrix`` and ``gradient`` of kept unknowns and then nodes; ``free`` are not held."""

    matrix: np.ndarray
    gradient: np.ndarray
    free: np.ndarray
    kept: int


def build_dense_system(problem: AdjustmentProblem, state: AdjustmentState) -> DenseSystem:
    """Normal equations of the whole by difference quotients of every residual."""
    kept, nodes = ParameterIndex.build(problem).size, len(state.xyz_site_m)

    def flat(step: np.ndarray) -> np.ndarray:
        at = apply_step(state, problem, step[:kept], step[kept:].reshape(-1, 3))
        return np.concatenate([group.residual.ravel() for group in list_groups(problem, at)])

    jacobian = differentiate(flat, kept + 3 * nodes)
    weighted = jacobian * compute_weights(list_groups(problem, state))[:, None]
    held = np.zeros(kept + 3 * nodes, dtype=bool)
    held[ParameterIndex.build(problem).lens : ParameterIndex.build(problem).gps_offset] = (
        problem.lens_prior_sigma.ravel() == 0
    )
    return DenseSystem(weighted.T @ jacobian, weighted.T @ flat(np.zeros(kept + 3 * nodes)), ~held, kept)


def differentiate(function: Callable[[np.ndarray], np.ndarray], size: int) -> np.ndarray:
    """Central differences (r, size) of a function about zero."""
    step = 1e-6
    return np.column_stack([(function(step * e) - function(-step * e)) / (2 * step) for e in np.eye(size)])


@pytest.fixture(scope="module")
def whole() -> tuple[AdjustmentProblem, AdjustmentState, DenseSystem]:
    """A problem of every kind of term, a state off its solution, and its dense normal equations."""
    problem = build_complete_problem()
    rng = np.random.default_rng(8)
    start = initialise_state(problem)
    state = replace(
        start,
        gps_offset_m=rng.normal(0, 0.5, start.gps_offset_m.shape),
        wall_deviation_m=rng.normal(0, 0.01, start.wall_deviation_m.shape),
        yaw_offset_rad=np.array([1e-4, -1e-4]),
    )
    return problem, state, build_dense_system(problem, state)


def scale_to_unit_diagonal(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The matrix with a unit diagonal, and the scale."""
    scale = 1 / np.sqrt(np.diag(matrix))
    return matrix * scale[:, None] * scale[None], scale


def test_the_cost_is_the_definitions(whole: tuple[AdjustmentProblem, AdjustmentState, DenseSystem]) -> None:
    problem, state, _ = whole
    by_hand = compute_robust_cost(list_groups(problem, state))
    assert build_reduced_system(problem, state, SIGMA_PX).cost == pytest.approx(by_hand, rel=1e-9)
    assert compute_cost(problem, state, SIGMA_PX) == pytest.approx(by_hand, rel=1e-9)


def test_the_gradient_is_half_the_slope_of_the_robust_cost(
    whole: tuple[AdjustmentProblem, AdjustmentState, DenseSystem],
) -> None:
    """Independent of the weights: the slope of the cost itself, before elimination."""
    problem, state, full = whole

    def cost(step: np.ndarray) -> np.ndarray:
        at = apply_step(state, problem, step[: full.kept], step[full.kept :].reshape(-1, 3))
        return np.array([compute_robust_cost(list_groups(problem, at))])

    slope = differentiate(cost, len(full.gradient))[0] / 2
    _, scale = scale_to_unit_diagonal(full.matrix[np.ix_(full.free, full.free)])
    # in sigmas of each unknown; robust costs of some hundreds give about 1e-7 by rounding
    np.testing.assert_allclose(full.gradient[full.free] * scale, slope[full.free] * scale, rtol=0, atol=2e-3)
    nodes = build_reduced_system(problem, state, SIGMA_PX).point_gradient.ravel()
    np.testing.assert_allclose(
        nodes * scale[-len(nodes) :], slope[full.kept :] * scale[-len(nodes) :], rtol=0, atol=2e-3
    )


def test_the_reduced_system_is_the_schur_complement(
    whole: tuple[AdjustmentProblem, AdjustmentState, DenseSystem],
) -> None:
    problem, state, full = whole
    kept = np.flatnonzero(full.free[: full.kept])
    nodes = np.arange(full.kept, len(full.gradient))
    inverse = np.linalg.inv(full.matrix[np.ix_(nodes, nodes)])
    across = full.matrix[np.ix_(kept, nodes)]
    matrix = full.matrix[np.ix_(kept, kept)] - across @ inverse @ across.T
    gradient = full.gradient[kept] - across @ inverse @ full.gradient[nodes]
    found = build_reduced_system(problem, state, SIGMA_PX)
    wanted, scale = scale_to_unit_diagonal(matrix)
    np.testing.assert_allclose(
        found.matrix[np.ix_(kept, kept)] * scale[:, None] * scale[None], wanted, rtol=0, atol=2e-4
    )  # of a unit diagonal
    np.testing.assert_allclose(found.gradient[kept] * scale, gradient * scale, rtol=0, atol=2e-3)  # sigmas
    m = len(state.xyz_site_m)
    blocks = inverse.reshape(m, 3, m, 3)[np.arange(m), :, np.arange(m), :]
    np.testing.assert_allclose(found.point_covariance_m2, blocks, rtol=0, atol=1e-5 * np.abs(blocks).max())  # m2


def test_the_step_is_the_whole_problems_step(whole: tuple[AdjustmentProblem, AdjustmentState, DenseSystem]) -> None:
    problem, state, full = whole
    step = np.zeros(len(full.gradient))
    free = full.free
    matrix, scale = scale_to_unit_diagonal(full.matrix[np.ix_(free, free)])
    step[free] = -scale * np.linalg.solve(matrix, scale * full.gradient[free])
    found = build_reduced_system(problem, state, SIGMA_PX)
    kept = np.flatnonzero(free[: full.kept])
    own = np.zeros(full.kept)
    own[kept] = -np.linalg.solve(found.matrix[np.ix_(kept, kept)], found.gradient[kept])
    sigma = np.sqrt(np.diag(np.linalg.inv(full.matrix[np.ix_(free, free)])))
    assert np.abs(step[free] / sigma).max() > 1.0, "a step of no size would prove nothing"
    np.testing.assert_allclose(own[kept] / sigma[: len(kept)], step[kept] / sigma[: len(kept)], rtol=0, atol=5e-3)
    nodes = found.compute_point_step(own).ravel()
    np.testing.assert_allclose(nodes / sigma[len(kept) :], step[full.kept :] / sigma[len(kept) :], rtol=0, atol=5e-3)


def test_the_covariance_is_the_inverse_of_the_whole() -> None:
    problem = build_complete_problem()
    solution = solve_adjustment(problem)
    solution = Solution(state=solution.state, tie_sigma_px=SIGMA_PX, iterations=1, converged=True)
    full = build_dense_system(problem, solution.state)
    inverse = np.zeros_like(full.matrix)
    inverse[np.ix_(full.free, full.free)] = np.linalg.inv(full.matrix[np.ix_(full.free, full.free)])
    system, covariance = compute_covariance(problem, solution, 1.0)
    sigma = np.sqrt(np.diag(inverse)[: full.kept])
    free = full.free[: full.kept]
    ratio = np.sqrt(np.diag(covariance))[free] / sigma[free]
    np.testing.assert_allclose(ratio, 1.0, rtol=0, atol=2e-3)
    assert (covariance[~free] == 0).all(), "held terms do not vary"
    # a node's own covariance, cameras' included
    nodes = np.array([0, 5, len(solution.state.xyz_site_m) - 1])
    known = Uncertainty(covariance=covariance, formal=covariance, system=system).compute_point_covariance(nodes)
    for node, found in zip(nodes, known, strict=True):
        at = full.kept + 3 * node + np.arange(3)
        wanted = inverse[np.ix_(at, at)]
        np.testing.assert_allclose(found, wanted, rtol=0, atol=3e-3 * np.abs(wanted).max())  # m2


def test_ties_that_are_moved_together_tell_nothing_of_the_datum() -> None:
    """One flight's GPS is all the datum: the block is known to its bias and no better, however many its points."""
    rng = np.random.default_rng(5)
    block = build_small_block(points=500)
    problem = add_gps(
        fix_lens(build_tie_point_problem(block, rng, tie_px=0.5)), block, rng, noise_m=0.05, bias_m=[[0, 0, 0]],
        bias_sigma_m=3.0,
    )  # fmt: skip
    solution = solve_adjustment(problem)
    assert solution.converged and solution.iterations < 12
    _, covariance = compute_covariance(problem, solution, 1.0)
    n = len(block.cameras)
    centres = covariance[: 6 * n, : 6 * n].reshape(n, 6, n, 6)[:, :3, :, :3].mean(axis=(0, 2))
    np.testing.assert_allclose(np.sqrt(np.diag(centres)), 3.0, rtol=0, atol=0.02)  # m


def test_a_node_that_lost_its_observations_does_no_harm() -> None:
    rng = np.random.default_rng(6)
    block = build_small_block()
    problem = add_control(
        fix_lens(build_tie_point_problem(block, rng, tie_px=0.5)), block, rng, nodes=np.arange(0, 200, 20), sigma_m=0.01
    )
    lost = replace(problem, initial_xyz_m=np.vstack([problem.initial_xyz_m, [[1.0, 1.0, 1.0]]]))
    found, without = solve_adjustment(lost), solve_adjustment(problem)
    np.testing.assert_allclose(found.state.centre_site_m, without.state.centre_site_m, rtol=0, atol=1e-9)  # m
    np.testing.assert_allclose(found.state.xyz_site_m[-1], [1.0, 1.0, 1.0], rtol=0, atol=0)


def test_a_prior_left_out_by_a_formula_is_one_left_out_by_solving_again() -> None:
    rng = np.random.default_rng(7)
    block = build_small_block()
    nodes = np.arange(0, 120, 15)
    problem = add_control(
        fix_lens(build_tie_point_problem(block, rng, tie_px=0.5)), block, rng, nodes=nodes, sigma_m=0.02
    )
    priors = replace(problem.point_priors, loss_scale=np.full(len(nodes), 1e3))  # the formula is of least squares
    problem = replace(problem, point_priors=priors)
    solution = solve_adjustment(problem)
    system, formal = compute_covariance(problem, solution, 1.0)
    known = Uncertainty(covariance=formal, formal=formal, system=system).compute_point_covariance(nodes)
    residual = priors.xyz_m - solution.state.xyz_site_m[nodes]
    found = compute_leave_one_out_residual(residual, known, np.full((len(nodes), 3), 0.02**2))
    for k, node in enumerate(nodes):
        without = replace(problem, point_priors=priors.take(np.arange(len(nodes)) != k))
        again = priors.xyz_m[k] - solve_adjustment(without).state.xyz_site_m[node]
        np.testing.assert_allclose(found[k], again, rtol=0, atol=0.0005)  # m
        assert np.linalg.norm(again) > 1.02 * np.linalg.norm(residual[k])
