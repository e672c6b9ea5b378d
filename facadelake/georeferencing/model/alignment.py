"""Alignment to the building's model: tie points onto the surface that their own cameras see.

A similarity is refined point-to-plane. Correspondences respect visibility: a tie point belongs to the face that the ray
from a camera that observed it meets, never to the back of a wall or a neighbouring plane. GPS stays in, with its
own error model: one common bias (metres) plus a noise of each photograph.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from facadelake.core.arrays import Float64Array, Int64Array
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.georeferencing.adjustment.point_to_plane import RaySurface
from facadelake.georeferencing.gps.alignment import check_against_gps
from facadelake.georeferencing.gps.priors import GpsPriors
from facadelake.georeferencing.similarity_fit import apply_parameters
from facadelake.sfm import Reconstruction

# Relief that the model does not have (sills, cornices) and its own tolerance: a residual of this size is ordinary.
SURFACE_SIGMA_M = 0.05
# Gate for a correspondence, closing from the error of GPS to that of the surface.
_GATES_M = (4.0, 3.0, 2.0, 1.5, 1.0, 0.7, 0.5, 0.4, 0.3, 0.3, 0.2, 0.2, 0.2)
_MAX_POINTS = 6000
_MIN_POINTS = 100
_MIN_FACING_COSINE = 0.25  # rays more grazing than 75 degrees tell little of the plane they meet
# A direction of shift is called observed where at least this share of the correspondences would notice it.
MIN_OBSERVED_SHARE = 0.05
_FIXED_BIAS_SIGMA_M = 0.01
_FREE_ROTATION_BELOW_M = 1.0
_ROTATION_AND_SCALE = np.arange(10) // 3 == 1  # parameters 3 to 5
_ROTATION_AND_SCALE[6] = True


@dataclass(frozen=True, kw_only=True, eq=False)
class ShiftObservability:
    """A direction of shift (3,), unit, in site, and the share (0 to 1) of the correspondences that would notice a
    shift along it."""

    direction: Float64Array
    share: float

    @property
    def observed(self) -> bool:
        """Whether the surface alone can be trusted with it."""
        return self.share >= MIN_OBSERVED_SHARE

    @property
    def description(self) -> str:
        """The direction for people."""
        east, north, up = self.direction
        if abs(up) > 0.9:
            return "height"
        azimuth = round(float(np.degrees(np.arctan2(east, north))) % 180.0)
        return f"the shift along azimuth {azimuth} deg" + ("" if abs(up) < 0.3 else " and in height")


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelAlignment:
    """``site_from_sfm``; point-to-plane residuals (m) of the points used; how many were offered; what was observable.

    ``shifts`` says how well each of three directions of shift is observed; ``gps_bias_m`` (3,) is the common error of
    the GPS priors as estimated (0 along directions that the surface does not observe).
    """

    site_from_sfm: Similarity
    residual_m: Float64Array
    points_total: int
    shifts: tuple[ShiftObservability, ...]
    gps_bias_m: Float64Array
    remarks: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class _PointPlanePairs:
    """Correspondences: points in sfm (k, 3) and the planes they belong to (point and normal (k, 3), site)."""

    xyz_sfm: Float64Array
    on_plane: Float64Array
    normal: Float64Array


def align_to_model(
    start: Similarity, reconstruction: Reconstruction, priors: GpsPriors, surface: RaySurface, *, seed: int = 1
) -> ModelAlignment:
    """Refine ``start`` (from GPS) until the tie points lie on the visible surface.

    Raises GeoreferenceError where fewer than 100 tie points meet the surface: the start is too far off, or the model
    is of another building.
    """
    points, cameras = _select_tie_points(reconstruction, seed)
    centres = reconstruction.centres_sfm
    limits = _compute_bounds(start, reconstruction, priors)
    pivot = np.median(start.apply(points), axis=0)
    now, found = start, np.zeros(10)
    for gate_m in _GATES_M:
        planes = _find_correspondences(now, points, centres[cameras], surface, gate_m)
        if len(planes.xyz_sfm) < _MIN_POINTS:
            raise GeoreferenceError(
                f"only {len(planes.xyz_sfm)} of {len(points)} tie points lie within {gate_m} m of the model's visible "
                f"surface ({_MIN_POINTS} are needed): GPS is too far off (in height too, where its datum is unknown) "
                "or the model is of another place; give control points, or georeference by gps"
            )
        problem = _AlignmentProblem(
            start=start,
            pivot=pivot,
            planes=planes,
            surface_sigma_m=max(SURFACE_SIGMA_M, gate_m / 4.0),
            shifts=_analyse_observability(planes),
            centres_sfm=centres[priors.photo],
            priors=priors,
        )
        # GPS knows turn and scale better than correspondences that are still metres off: first the shift alone.
        held = np.where(_ROTATION_AND_SCALE, 1e-6, limits) if gate_m > _FREE_ROTATION_BELOW_M else limits
        found = _solve_alignment(problem, found, held)
        now = apply_parameters(start, pivot, found[:7])
    check_against_gps(now, centres[priors.photo], priors, by="the model")
    planes = _find_correspondences(now, points, centres[cameras], surface, _GATES_M[-1])
    shifts = _analyse_observability(planes)
    return ModelAlignment(
        site_from_sfm=now,
        residual_m=np.abs(_compute_point_to_plane(now, planes)),
        points_total=len(points),
        shifts=shifts,
        gps_bias_m=found[7:],
        remarks=_build_remarks(shifts, priors),
    )


def _select_tie_points(reconstruction: Reconstruction, seed: int) -> tuple[Float64Array, Int64Array]:
    """Tie points seen three times or more (a limited draw) and for each the nearest camera that observed it."""
    seen = np.bincount(reconstruction.image_point_tie_point, minlength=len(reconstruction.xyz_sfm))
    chosen = np.flatnonzero(seen >= 3)
    if len(chosen) > _MAX_POINTS:
        chosen = np.sort(np.random.default_rng(seed).choice(chosen, _MAX_POINTS, replace=False))
    distance = np.linalg.norm(
        reconstruction.xyz_sfm[reconstruction.image_point_tie_point]
        - reconstruction.centres_sfm[reconstruction.image_point_photo],
        axis=1,
    )
    order = np.lexsort((distance, reconstruction.image_point_tie_point))
    point, first = np.unique(reconstruction.image_point_tie_point[order], return_index=True)
    nearest = np.full(len(seen), -1, dtype=np.int64)
    nearest[point] = reconstruction.image_point_photo[order][first]
    return reconstruction.xyz_sfm[chosen], nearest[chosen]


def _find_correspondences(
    site_from_sfm: Similarity, points: Float64Array, centres: Float64Array, surface: RaySurface, gate_m: float
) -> _PointPlanePairs:
    xyz, origin = site_from_sfm.apply(points), site_from_sfm.apply(centres)
    ray = xyz - origin
    length = np.linalg.norm(ray, axis=1)
    direction = ray / length[:, None]
    hits = surface.cast(origin, direction)
    met = np.isfinite(hits.distance_m)
    normal = np.where(met[:, None], hits.normal_site, 0.0)
    foot = origin + np.where(met, hits.distance_m, 0.0)[:, None] * direction
    facing = -np.einsum("ij,ij->i", normal, direction)
    off_m = np.abs(np.einsum("ij,ij->i", normal, xyz - foot))
    good = met & (facing > _MIN_FACING_COSINE) & (off_m < gate_m)
    return _PointPlanePairs(xyz_sfm=points[good], on_plane=foot[good], normal=normal[good])


def _compute_point_to_plane(site_from_sfm: Similarity, planes: _PointPlanePairs) -> Float64Array:
    distance: Float64Array = np.einsum("ij,ij->i", planes.normal, site_from_sfm.apply(planes.xyz_sfm) - planes.on_plane)
    return distance


@dataclass(frozen=True, kw_only=True, eq=False)
class _AlignmentProblem:
    """One least-squares problem: seven parameters about ``pivot`` from ``start``, and the common GPS bias (3).

    The surface's sigma follows the gate: while correspondences are still metres off, GPS must be heard too.
    """

    start: Similarity
    pivot: Float64Array
    planes: _PointPlanePairs
    surface_sigma_m: float
    shifts: tuple[ShiftObservability, ...]
    centres_sfm: Float64Array
    priors: GpsPriors


def _compute_bounds(start: Similarity, reconstruction: Reconstruction, priors: GpsPriors) -> Float64Array:
    """How far (10,) the parameters may leave the start: four sigmas of what GPS alone leaves open.

    Without them a block can shrink onto one wall, where every point-to-plane distance is small.
    """
    left = priors.xyz_site_m - start.apply(reconstruction.centres_sfm[priors.photo])
    noise = 1.4826 * np.median(np.abs(left - np.median(left, axis=0)), axis=0)
    arms = priors.xyz_site_m - priors.xyz_site_m.mean(axis=0)
    relative = float(np.linalg.norm(noise) / max(np.sqrt((arms**2).sum()), 1e-9))
    shift = 4.0 * priors.common_sigma_m
    return np.concatenate(
        [shift, np.full(3, max(4.0 * relative, np.radians(2.0))), [max(4.0 * relative, 0.005)], shift]
    )


def _solve_alignment(problem: _AlignmentProblem, found: Float64Array, limits: Float64Array) -> Float64Array:
    """Least squares from ``found`` (10,).

    Along a direction that the surface does not observe, its residuals are left out and the bias is held at zero: else
    a handful of sills and false correspondences would move the block by metres, and nothing would speak against them.
    """
    priors, shifts = problem.priors, problem.shifts
    # The bias of a flight has the prior's sigma; what is left between photographs is about a third of it.
    noise = priors.sigma_m / 3.0
    along = np.array([shift.direction for shift in shifts])
    seen = along.T @ np.diag([float(shift.observed) for shift in shifts]) @ along  # projects on what is observed
    planes = replace(problem.planes, normal=problem.planes.normal @ seen)
    bias_sigma = np.where(
        [shift.observed for shift in shifts],
        [np.linalg.norm(priors.common_sigma_m * shift.direction) for shift in shifts],
        _FIXED_BIAS_SIGMA_M,
    )

    def residuals(step: Float64Array) -> Float64Array:
        moved = apply_parameters(problem.start, problem.pivot, step[:7])
        surface = _compute_point_to_plane(moved, planes) / problem.surface_sigma_m
        gps = (moved.apply(problem.centres_sfm) + step[7:] - priors.xyz_site_m) / noise
        return np.concatenate([surface, gps.ravel(), along @ step[7:] / bias_sigma])

    begin = np.clip(np.concatenate([found[:7], seen @ found[7:]]), -0.999 * limits, 0.999 * limits)
    fit = least_squares(
        residuals, begin, bounds=(-limits, limits), x_scale=limits, loss="soft_l1", max_nfev=30, method="trf"
    )
    solved: Float64Array = fit.x
    return solved


def _analyse_observability(planes: _PointPlanePairs) -> tuple[ShiftObservability, ...]:
    """The three principal directions of shift, weakest first: eigenvectors of the normals' mean outer product.

    Turn and scale are bounded by GPS (``_compute_bounds``), so they cannot answer for a shift and are not asked.
    """
    shares, directions = np.linalg.eigh(planes.normal.T @ planes.normal / len(planes.normal))
    return tuple(
        ShiftObservability(direction=directions[:, k], share=max(0.0, float(shares[k]))) for k in range(len(shares))
    )


def _build_remarks(shifts: tuple[ShiftObservability, ...], priors: GpsPriors) -> tuple[str, ...]:
    seen = [f"{shift.description} ({shift.share:.3f})" for shift in shifts if shift.observed]
    remarks = [f"the model's surface observes {', '.join(seen) or 'no shift'} (share needed: {MIN_OBSERVED_SHARE})"]
    sigma = priors.common_sigma_m
    held = [
        f"{shift.description} ({shift.share:.3f}; GPS sigma {np.linalg.norm(sigma * shift.direction):.1f} m)"
        for shift in shifts
        if not shift.observed
    ]
    if held:
        remarks.append(f"not observed by the model, held by GPS alone: {', '.join(held)}")
    return tuple(remarks)
