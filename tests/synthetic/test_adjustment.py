"""The adjustment of synthetic blocks of known truth: errors against the covariance that it states for them."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from facadelake.core.camera import Camera
from facadelake.georeferencing.adjustment.adjust import adjust_block
from facadelake.georeferencing.adjustment.adjusted_block import AdjustedBlock, compute_held_out_residuals
from facadelake.georeferencing.adjustment.control_observations import (
    ControlObservations,
    MarkedPoints,
    SurfaceConstraint,
)
from facadelake.georeferencing.adjustment.parameters import ParameterIndex
from facadelake.georeferencing.adjustment.problem import AdjustmentProblem
from facadelake.georeferencing.adjustment.projection import lens_from_camera
from facadelake.georeferencing.adjustment.solve import compute_covariance, solve_adjustment
from tests.unit.georeferencing.small_block import (
    CAMERA,
    SITE_FROM_SFM,
    BoxSurface,
    SmallBlock,
    add_control,
    add_gps,
    add_walls,
    build_marked_points,
    build_no_attitudes,
    build_no_positions,
    build_reconstruction,
    build_small_block,
    build_tie_point_problem,
)

TIE_PX = 0.5
SEEDS = 20
CHI_SQUARE_95_OF_6 = 12.592  # tables
CONTROL = np.arange(0, 200, 17)
BENT = replace(CAMERA, cx_px=2015.0, cy_px=1491.0, k1=-0.03)


def build_control_problem(block: SmallBlock, rng: np.random.Generator) -> AdjustmentProblem:
    """Twelve surveyed tie points."""
    return add_control(build_tie_point_problem(block, rng, tie_px=TIE_PX), block, rng, nodes=CONTROL, sigma_m=0.01)


def build_gps_problem(block: SmallBlock, rng: np.random.Generator) -> AdjustmentProblem:
    """GPS with noise of 0.3 m and a bias drawn from 2 m."""
    problem = build_tie_point_problem(block, rng, tie_px=TIE_PX)
    return add_gps(problem, block, rng, noise_m=0.3, bias_m=[rng.normal(0, 2.0, 3)], bias_sigma_m=2.0)


def build_walls_problem(block: SmallBlock, rng: np.random.Generator) -> AdjustmentProblem:
    """The faces of a model that the building's walls stand off by 3 cm each, with 2 cm of relief."""
    problem = build_tie_point_problem(block, rng, tie_px=TIE_PX)
    return add_walls(problem, block, rng, relief_m=0.02, wall_deviation_m=rng.normal(0, 0.03, 5), wall_sigma_m=0.03)


@dataclass(frozen=True)
class Trial:
    """Of one seed: cameras' errors (n, 6), each one's squared error in its own covariance (n,), tie sigma, steps."""

    errors: np.ndarray
    normalised: np.ndarray
    tie_sigma_px: float
    iterations: int


def run_trial(block: SmallBlock, problem: AdjustmentProblem) -> Trial:
    """Solve and compare with the truth."""
    solution = solve_adjustment(problem)
    assert solution.converged
    _, covariance = compute_covariance(problem, solution, 1.0)
    n = len(block.cameras)
    own = covariance[: 6 * n, : 6 * n].reshape(n, 6, n, 6)[np.arange(n), :, np.arange(n), :]
    errors = block.errors(solution.state)
    normalised = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(own), errors)
    return Trial(errors, normalised, solution.tie_sigma_px, solution.iterations)


def test_without_noise_the_truth_is_found() -> None:
    block = build_small_block(camera=BENT)
    rng = np.random.default_rng(1)
    start = replace(CAMERA, fx_px=2930.0, fy_px=2930.0)
    problem = build_tie_point_problem(block, rng, tie_px=0.0, start_m=0.1, start_deg=0.5, lens=start)
    problem = add_control(problem, block, rng, nodes=CONTROL, sigma_m=0.01)
    exact = replace(problem, point_priors=replace(problem.point_priors, xyz_m=block.xyz_m[CONTROL]))
    # what is known of the lens beforehand agrees with it: nothing pulls
    exact = replace(exact, lens_prior_mean=lens_from_camera(BENT)[None])
    solution = solve_adjustment(exact)
    errors = block.errors(solution.state)
    np.testing.assert_allclose(errors[:, :3], 0, rtol=0, atol=1e-5)  # m
    np.testing.assert_allclose(errors[:, 3:], 0, rtol=0, atol=1e-6)  # rad
    np.testing.assert_allclose(solution.state.xyz_site_m, block.xyz_m, rtol=0, atol=1e-5)  # m
    np.testing.assert_allclose(solution.state.lens[0, :4], lens_from_camera(BENT)[:4], rtol=0, atol=1e-2)  # px
    assert solution.iterations <= 8


@pytest.mark.parametrize(
    ("make", "smallest_m", "largest_m"),
    [(build_control_problem, 0.004, 0.02), (build_gps_problem, 1.0, 5.0), (build_walls_problem, 0.03, 0.12)],
)
def test_errors_are_as_large_as_their_covariance_says(
    make: Callable[[SmallBlock, np.random.Generator], AdjustmentProblem], smallest_m: float, largest_m: float
) -> None:
    """Twenty draws of all noise: the mean squared error is the covariance's, and 95 % ellipsoids hold the truth."""
    block = build_small_block()
    trials = [run_trial(block, make(block, np.random.default_rng(100 + seed))) for seed in range(SEEDS)]
    normalised = np.array([found.normalised for found in trials])
    assert 0.7 < normalised.mean() / 6 < 1.3
    assert 0.88 < (normalised < CHI_SQUARE_95_OF_6).mean() <= 1.0
    error_m = np.sqrt(np.mean([(found.errors[:, :3] ** 2).sum(axis=1).mean() for found in trials]))
    assert smallest_m < error_m < largest_m
    assert 0.42 < np.mean([found.tie_sigma_px for found in trials]) < 0.55  # px, of 0.5


@pytest.mark.parametrize("views", [2, 3])
def test_short_tracks_do_not_look_better_than_they_are(views: int) -> None:
    """A point seen twice fits any noise but its epipolar part: its residuals are half its errors."""
    block = build_small_block(points=300, longest_track=views)
    trials = [
        run_trial(
            block,
            add_control(
                build_tie_point_problem(block, rng, tie_px=TIE_PX),
                block,
                rng,
                nodes=np.arange(0, 300, 25),
                sigma_m=0.01,
            ),
        )
        for rng in (np.random.default_rng(300 + seed) for seed in range(8))
    ]
    assert 0.6 < np.mean([found.normalised.mean() for found in trials]) / 6 < 1.6
    assert 0.33 < np.mean([found.tie_sigma_px for found in trials]) < 0.6  # px, of 0.5


def test_a_fifth_of_the_ties_may_be_wrong() -> None:
    block = build_small_block()
    clean, spoilt = [], []
    for seed in range(8):
        problem = build_control_problem(block, np.random.default_rng(100 + seed))
        clean.append(run_trial(block, problem))
        rng = np.random.default_rng(200 + seed)
        seen = problem.image_points
        wrong = rng.uniform(size=len(seen.photo)) < 0.2
        away = rng.normal(size=(len(wrong), 2))
        away *= rng.uniform(20, 300, (len(wrong), 1)) / np.linalg.norm(away, axis=1, keepdims=True)
        xy = seen.xy_img + np.where(wrong[:, None], away, 0)
        spoilt.append(run_trial(block, replace(problem, image_points=replace(seen, xy_img=xy))))
    error_m = [np.sqrt(np.mean([(t.errors[:, :3] ** 2).sum(axis=1) for t in of])) for of in (clean, spoilt)]
    assert 0.9 < error_m[1] / error_m[0] < 1.6  # a fifth less evidence, and a little of the outliers' pull
    assert 0.4 < np.mean([t.normalised.mean() for t in spoilt]) / 6 < 1.5


def test_each_flights_gps_has_its_own_offset() -> None:
    block = build_small_block()
    biases = np.array([[1.5, -0.7, 3.0], [-0.8, 0.4, -2.0]])
    left, sigmas = [], []
    for seed in range(12):
        rng = np.random.default_rng(400 + seed)
        problem = add_gps(build_control_problem(block, rng), block, rng, noise_m=0.2, bias_m=biases, bias_sigma_m=3.0)
        solution = solve_adjustment(problem)
        _, covariance = compute_covariance(problem, solution, 1.0)
        layout = ParameterIndex.build(problem)
        sigma = np.sqrt(np.diag(covariance)[layout.gps_offset : layout.yaw]).reshape(2, 3)
        left.append((solution.state.gps_offset_m - biases) / sigma)
        sigmas.append(sigma)
    assert 0.6 < np.mean(np.square(left)) < 1.5
    # six photographs a flight: 0.2 m / sqrt(6), a little more where noise looks gross
    np.testing.assert_allclose(np.mean(sigmas), 0.2 / np.sqrt(6), rtol=0, atol=0.03)  # m


def test_two_flights_without_control_know_their_difference_and_not_their_place() -> None:
    block = build_small_block()
    rng = np.random.default_rng(5)
    problem = build_tie_point_problem(block, rng, tie_px=TIE_PX)
    problem = add_gps(problem, block, rng, noise_m=0.2, bias_m=[[2.0, 0, 0], [-2.0, 0, 0]], bias_sigma_m=3.0)
    solution = solve_adjustment(problem)
    _, covariance = compute_covariance(problem, solution, 1.0)
    offset = ParameterIndex.build(problem).gps_offset
    first, second = solution.state.gps_offset_m
    np.testing.assert_allclose(first - second, [4.0, 0, 0], rtol=0, atol=0.6)  # m; four sigmas of 0.12, prior's pull
    between = covariance[offset, offset] + covariance[offset + 3, offset + 3] - 2 * covariance[offset, offset + 3]
    np.testing.assert_allclose(np.sqrt(between), 0.2 * np.sqrt(2 / 6), rtol=0, atol=0.05)  # m
    np.testing.assert_allclose(np.sqrt(covariance[offset, offset]), 3 / np.sqrt(2), rtol=0, atol=0.1)  # m


def adjust_to_control(
    block: SmallBlock, seed: int, lens: Camera | None = None, moved_m: float = 0.0
) -> tuple[AdjustedBlock, MarkedPoints]:
    """The whole adjustment from a reconstruction on; G3 is surveyed ``moved_m`` too high."""
    rng = np.random.default_rng(seed)
    marked = build_marked_points(block, rng, points=CONTROL, survey_m=0.01, mark_px=0.7)
    marked.xyz_site_m[3, 2] += moved_m
    evidence = ControlObservations(positions=build_no_positions(), attitudes=build_no_attitudes(), marked=marked)
    reconstruction = build_reconstruction(block, rng, tie_px=TIE_PX, lens=lens)
    return adjust_block(reconstruction, SITE_FROM_SFM, evidence), marked


def test_a_lens_is_found_and_terms_that_it_does_not_have_are_held() -> None:
    """The principal point 15 px from the centre, k1 -0.03; no k2, p1, p2, square pixels."""
    block = build_small_block(camera=BENT, points=300)
    truth = lens_from_camera(BENT)
    held, left = [], []
    for seed in range(6):
        adjusted, _ = adjust_to_control(block, seed, lens=CAMERA)
        found = adjusted.solution.state.lens[0]
        left.append(((found - truth) / np.where(adjusted.lens_sigma[0] > 0, adjusted.lens_sigma[0], np.inf))[:5])
        held.append(len(adjusted.fixed_parameters))
        for term in adjusted.fixed_parameters:
            assert term.split(" of ")[0] in ("aspect", "k2", "p1", "p2")
            row = ("focal_px", "aspect", "cx_px", "cy_px", "k1", "k2", "p1", "p2").index(term.split(" of ")[0])
            assert found[row] == truth[row], "held where a plain lens has it"
        assert abs(found[2] - 2015.0) < 6.0  # px; it began at 2000
        assert abs(found[4] + 0.03) < 0.004
    assert 17 <= sum(held) <= 24, "four in each of six, but for one in twenty that looks significant"
    shown = np.array(left)[:, [0, 2, 3, 4]]
    assert 0.15 < np.mean(shown**2) < 2.0  # of its sigma, which covers regions that disagree and so is rather large


def test_a_lens_term_that_the_photographs_show_is_not_held() -> None:
    block = build_small_block(camera=replace(CAMERA, p1=2e-3), points=300)
    adjusted, _ = adjust_to_control(block, 1, lens=CAMERA)
    assert "p1 of camera 1" not in adjusted.fixed_parameters
    found, sigma = adjusted.solution.state.lens[0, 6], adjusted.lens_sigma[0, 6]
    assert 0 < sigma < 5e-4
    assert abs(found - 2e-3) < 4 * sigma


def test_the_stated_covariance_is_never_smaller_than_the_formal_one() -> None:
    """The whole adjustment: what disagrees between regions of the building is added, so truth lies well inside."""
    block = build_small_block(points=300)
    normalised = []
    for seed in range(4):
        adjusted, _ = adjust_to_control(block, 20 + seed)
        errors = block.errors(adjusted.solution.state)
        normalised.append(np.einsum("ni,nij,nj->n", errors, np.linalg.inv(adjusted.covariance), errors))
        grown = adjusted.uncertainty.covariance - adjusted.uncertainty.formal
        assert np.linalg.eigvalsh(grown).min() > -1e-6 * np.abs(grown).max()
    assert 0.15 < np.mean(normalised) / 6 < 1.1


def test_a_moved_control_point_is_seen_when_it_is_left_out() -> None:
    """Twenty centimetres too high: held out it shows them, in the fit there is less of them, and the block stays."""
    block = build_small_block()
    adjusted, marked = adjust_to_control(block, 7, moved_m=0.2)
    held_out = compute_held_out_residuals(adjusted, marked)
    assert sorted(held_out) == list(range(len(CONTROL)))
    np.testing.assert_allclose(held_out[3], [0, 0, 0.2], rtol=0, atol=0.05)  # m; survey and block, four sigmas
    fitted = np.linalg.norm(marked.xyz_site_m[3] - adjusted.marked_xyz_site_m[3])
    assert 0.005 < fitted < np.linalg.norm(held_out[3])  # m
    error_m = np.linalg.norm(block.errors(adjusted.solution.state)[:, :3], axis=1)
    assert 0.001 < error_m.mean() < 0.02  # m; the block has not followed
    others = np.array([np.linalg.norm(left) for row, left in held_out.items() if row != 3])
    assert 0.005 < np.median(others) < 0.04  # m; 1 cm of survey an axis and the block


def test_a_model_holds_a_block_against_the_bias_of_its_gps() -> None:
    """It begins on the walls, as walls' alignment leaves it; GPS is more than a metre off and must not take it back."""
    block = build_small_block(points=400)
    means = []
    for seed in range(4):
        rng = np.random.default_rng(60 + seed)
        positions = add_gps(
            build_tie_point_problem(block, rng, tie_px=TIE_PX),
            block,
            rng,
            noise_m=0.3,
            bias_m=[[1.3, -0.8, 2.1]],
            bias_sigma_m=3.0,
        ).positions
        off = replace(SITE_FROM_SFM, translation=SITE_FROM_SFM.translation + rng.normal(0, 0.1, 3))
        model = SurfaceConstraint(surface=BoxSurface(), sigma_m=0.02)
        evidence = ControlObservations(positions=positions, attitudes=build_no_attitudes(), model=model)
        adjusted = adjust_block(build_reconstruction(block, rng, tie_px=TIE_PX), off, evidence)
        assert len(adjusted.problem.point_to_plane.wall_sigma_m) == 5
        assert len(adjusted.problem.point_to_plane.point) > 350
        means.append(block.errors(adjusted.solution.state)[:, :3].mean(axis=0))
        np.testing.assert_allclose(adjusted.gps_offset_m[0], [1.3, -0.8, 2.1], rtol=0, atol=0.4)  # m; 0.3 / sqrt(12)
        # Two opposite walls of 2 cm each fix their centre to 1.4 cm; the ground, being one, to 2 cm.
        np.testing.assert_allclose(np.sqrt(np.diag(adjusted.datum_covariance_m2)), 0.017, rtol=0, atol=0.012)  # m
    assert 1e-5 < np.abs(means).max() < 0.02  # m; the box is exact here, so nothing but images errs
