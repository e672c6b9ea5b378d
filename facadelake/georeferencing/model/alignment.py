"""Point-to-plane alignment of a block to the building model: tie points onto the surface that their cameras see.

Correspondences respect visibility: a tie point belongs to the face that the ray of a camera that shows it hits, never
to the back of a wall or a neighbouring plane. GPS takes part with its own error model: one common bias (metres) and a
noise of each photograph. Source: Chen and Medioni 1992 (point-to-plane distance).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from facadelake.core.arrays import Float64Array, Float64N, Float64Nx3, Float64x3, Int64Array
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.georeferencing.adjustment.point_to_plane import RaySurface, find_faces
from facadelake.georeferencing.gps.alignment import check_against_gps
from facadelake.georeferencing.gps.priors import GpsPriors
from facadelake.georeferencing.similarity_fit import apply_parameters
from facadelake.sfm import Reconstruction

# Sigma of the surface: relief that the model does not have (sills, cornices) and the model's own tolerance.
SURFACE_SIGMA_M = 0.05
# Gates of the correspondences in each iteration, narrowing from the error of GPS to that of the surface.
_GATES_M = (4.0, 3.0, 2.0, 1.5, 1.0, 0.7, 0.5, 0.4, 0.3, 0.3, 0.2, 0.2, 0.2)
_MAX_POINTS = 6000
_MIN_POINTS = 100
# A direction of shift is observed where at least this share of the correspondences depends on it.
MIN_OBSERVED_SHARE = 0.05
_FIXED_BIAS_SIGMA_M = 0.01
_FREE_ROTATION_BELOW_M = 1.0
_ROTATION_AND_SCALE = np.arange(10) // 3 == 1  # parameters 3 to 5
_ROTATION_AND_SCALE[6] = True


@dataclass(frozen=True, kw_only=True, eq=False)
class ShiftObservability:
    """A unit direction of shift (3,) in site, and the share (0 to 1) of the correspondences that depends on it."""

    direction: Float64x3
    share: float

    @property
    def observed(self) -> bool:
        """Whether the surface alone determines the shift."""
        return self.share >= MIN_OBSERVED_SHARE

    @property
    def description(self) -> str:
        """The direction in words."""
        east, north, up = self.direction
        if abs(up) > 0.9:
            return "height"
        azimuth = round(float(np.degrees(np.arctan2(east, north))) % 180.0)
        return f"the shift along azimuth {azimuth} deg" + ("" if abs(up) < 0.3 else " and in height")


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelAlignment:
    """The aligned block.

    ``residual_m``: point-to-plane distances (k,) of the points used, of ``points_total``. ``shifts``: observability of
    three orthogonal directions of shift.
    """

    site_from_sfm: Similarity
    residual_m: Float64N
    points_total: int
    shifts: tuple[ShiftObservability, ...]
    remarks: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class _PointPlanePairs:
    """Correspondences: points (k, 3) in sfm, and a point (k, 3) and the normal (k, 3) of their planes in site."""

    xyz_sfm: Float64Nx3
    on_plane: Float64Nx3
    normal: Float64Nx3


def align_to_model(
    start: Similarity, reconstruction: Reconstruction, priors: GpsPriors, surface: RaySurface, *, seed: int = 1
) -> ModelAlignment:
    """Refine a placement until the tie points lie on the visible surface.

    Args:
        start: initial similarity, from GPS.
        reconstruction: the free block.
        priors: GPS priors of its photographs, in site.
        surface: the model's surface.
        seed: seed of the draw of tie points.

    Returns:
        the aligned block, and which directions of shift the surface observes.

    Raises:
        GeoreferenceError: fewer than 100 tie points meet the surface (the start is too far off, or the model is of
            another building), or the result contradicts GPS.
    """
    points, cameras = select_tie_points(reconstruction, seed)
    centres = reconstruction.centres_sfm
    bounds = _compute_bounds(start, reconstruction, priors)
    pivot = np.median(start.apply(points), axis=0)
    site_from_sfm, parameters = start, np.zeros(10)
    for gate_m in _GATES_M:
        pairs = _find_correspondences(site_from_sfm, points, centres[cameras], surface, gate_m)
        if len(pairs.xyz_sfm) < _MIN_POINTS:
            raise GeoreferenceError(
                f"only {len(pairs.xyz_sfm)} of {len(points)} tie points lie within {gate_m} m of the model's visible "
                f"surface ({_MIN_POINTS} are needed): GPS is too inaccurate (also in height, where its datum is "
                "unknown), or the model is of another building; give control points, or georeference by gps"
            )
        problem = _AlignmentProblem(
            start=start,
            pivot=pivot,
            pairs=pairs,
            surface_sigma_m=max(SURFACE_SIGMA_M, gate_m / 4.0),
            shifts=_analyse_observability(pairs),
            centres_sfm=centres[priors.photo],
            priors=priors,
        )
        # GPS determines rotation and scale better than correspondences with errors of metres: first the shift alone.
        limits = np.where(_ROTATION_AND_SCALE, 1e-6, bounds) if gate_m > _FREE_ROTATION_BELOW_M else bounds
        parameters = _solve_alignment(problem, parameters, limits)
        site_from_sfm = apply_parameters(start, pivot, parameters[:7])
    check_against_gps(site_from_sfm, centres[priors.photo], priors, by="the model")
    pairs = _find_correspondences(site_from_sfm, points, centres[cameras], surface, _GATES_M[-1])
    shifts = _analyse_observability(pairs)
    return ModelAlignment(
        site_from_sfm=site_from_sfm,
        residual_m=np.abs(_compute_point_to_plane(site_from_sfm, pairs)),
        points_total=len(points),
        shifts=shifts,
        remarks=_build_remarks(shifts, priors),
    )


def select_tie_points(reconstruction: Reconstruction, seed: int) -> tuple[Float64Nx3, Int64Array]:
    """Tie points (n, 3) with three image points or more (a limited draw), and the nearest camera (n,) of each."""
    track_length = np.bincount(reconstruction.image_point_tie_point, minlength=len(reconstruction.xyz_sfm))
    chosen = np.flatnonzero(track_length >= 3)
    if len(chosen) > _MAX_POINTS:
        chosen = np.sort(np.random.default_rng(seed).choice(chosen, _MAX_POINTS, replace=False))
    distance = np.linalg.norm(
        reconstruction.xyz_sfm[reconstruction.image_point_tie_point]
        - reconstruction.centres_sfm[reconstruction.image_point_photo],
        axis=1,
    )
    order = np.lexsort((distance, reconstruction.image_point_tie_point))
    point, first = np.unique(reconstruction.image_point_tie_point[order], return_index=True)
    nearest = np.full(len(track_length), -1, dtype=np.int64)
    nearest[point] = reconstruction.image_point_photo[order][first]
    return reconstruction.xyz_sfm[chosen], nearest[chosen]


def _find_correspondences(
    site_from_sfm: Similarity, points: Float64Nx3, centres: Float64Nx3, surface: RaySurface, gate_m: float
) -> _PointPlanePairs:
    """Planes of the ``points`` (n, 3) that lie within ``gate_m`` of the face that the ray of their camera hits."""
    faces = find_faces(site_from_sfm.apply(points), site_from_sfm.apply(centres), surface)
    matched = faces.match(gate_m)
    return _PointPlanePairs(
        xyz_sfm=points[matched], on_plane=faces.foot_site_m[matched], normal=faces.normal_site[matched]
    )


def _compute_point_to_plane(site_from_sfm: Similarity, pairs: _PointPlanePairs) -> Float64N:
    """Signed distances (k,) of the points from their planes, in metres."""
    distance: Float64Array = np.einsum("ij,ij->i", pairs.normal, site_from_sfm.apply(pairs.xyz_sfm) - pairs.on_plane)
    return distance


@dataclass(frozen=True, kw_only=True, eq=False)
class _AlignmentProblem:
    """One least-squares problem: seven similarity parameters about ``pivot`` from ``start``, and the GPS bias (3).

    ``surface_sigma_m`` follows the gate, so that GPS contributes while correspondences have errors of metres.
    """

    start: Similarity
    pivot: Float64x3
    pairs: _PointPlanePairs
    surface_sigma_m: float
    shifts: tuple[ShiftObservability, ...]
    centres_sfm: Float64Nx3
    priors: GpsPriors


def _compute_bounds(start: Similarity, reconstruction: Reconstruction, priors: GpsPriors) -> Float64Array:
    """Bounds (10,) of the parameters: four sigmas of what GPS alone leaves undetermined.

    Without them a block can shrink onto one wall, where every point-to-plane distance is small.
    """
    residual = priors.xyz_site_m - start.apply(reconstruction.centres_sfm[priors.photo])
    noise = 1.4826 * np.median(np.abs(residual - np.median(residual, axis=0)), axis=0)
    arms = priors.xyz_site_m - priors.xyz_site_m.mean(axis=0)
    relative = float(np.linalg.norm(noise) / max(np.sqrt((arms**2).sum()), 1e-9))
    shift = 4.0 * priors.common_sigma_m
    return np.concatenate(
        [shift, np.full(3, max(4.0 * relative, np.radians(2.0))), [max(4.0 * relative, 0.005)], shift]
    )


def _solve_alignment(problem: _AlignmentProblem, start: Float64Array, limits: Float64Array) -> Float64Array:
    """Parameters (10,) by least squares from ``start`` (10,), within ``limits`` (10,).

    Along a direction that the surface does not observe, its residuals are left out and the bias is fixed at zero:
    otherwise a few sills and false correspondences would shift the block by metres, without contradiction.
    """
    priors, shifts = problem.priors, problem.shifts
    # The bias of a flight has the prior's sigma; the noise between photographs is about a third of it.
    noise = priors.sigma_m / 3.0
    along = np.array([shift.direction for shift in shifts])
    projector = along.T @ np.diag([float(shift.observed) for shift in shifts]) @ along  # onto observed directions
    pairs = replace(problem.pairs, normal=problem.pairs.normal @ projector)
    bias_sigma = np.where(
        [shift.observed for shift in shifts],
        [np.linalg.norm(priors.common_sigma_m * shift.direction) for shift in shifts],
        _FIXED_BIAS_SIGMA_M,
    )

    def compute_residuals(step: Float64Array) -> Float64Array:
        similarity = apply_parameters(problem.start, problem.pivot, step[:7])
        surface = _compute_point_to_plane(similarity, pairs) / problem.surface_sigma_m
        gps = (similarity.apply(problem.centres_sfm) + step[7:] - priors.xyz_site_m) / noise
        return np.concatenate([surface, gps.ravel(), along @ step[7:] / bias_sigma])

    begin = np.clip(np.concatenate([start[:7], projector @ start[7:]]), -0.999 * limits, 0.999 * limits)
    fit = least_squares(
        compute_residuals, begin, bounds=(-limits, limits), x_scale=limits, loss="soft_l1", max_nfev=30, method="trf"
    )
    parameters: Float64Array = fit.x
    return parameters


def _analyse_observability(pairs: _PointPlanePairs) -> tuple[ShiftObservability, ...]:
    """The three principal directions of shift, weakest first: eigenvectors of the normals' mean outer product.

    Rotation and scale are bounded by GPS (``_compute_bounds``), so they cannot replace a shift and are left out.
    """
    shares, directions = np.linalg.eigh(pairs.normal.T @ pairs.normal / len(pairs.normal))
    return tuple(
        ShiftObservability(direction=directions[:, k], share=max(0.0, float(shares[k]))) for k in range(len(shares))
    )


def _build_remarks(shifts: tuple[ShiftObservability, ...], priors: GpsPriors) -> tuple[str, ...]:
    observed = [f"{shift.description} ({shift.share:.3f})" for shift in shifts if shift.observed]
    remarks = [
        f"determined by the model's surface: {', '.join(observed) or 'no shift'} (share of correspondences, "
        f"{MIN_OBSERVED_SHARE} needed)"
    ]
    sigma = priors.common_sigma_m
    by_gps = [
        f"{shift.description} ({shift.share:.3f}; GPS sigma {np.linalg.norm(sigma * shift.direction):.1f} m)"
        for shift in shifts
        if not shift.observed
    ]
    if by_gps:
        remarks.append(f"not determined by the model, by GPS alone: {', '.join(by_gps)}")
    return tuple(remarks)
