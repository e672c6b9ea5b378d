"""The reduced camera system: normal equations from which the object points are eliminated (Schur complement), dense.

Source: Triggs et al. 2000, Bundle adjustment: a modern synthesis, section 6. A thousand photographs are a matrix of
6,000 rows, 300 MB and a few seconds to factorise; object points are eliminated in batches, each dense in the
photographs that show it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_matrix

from facadelake.core.arrays import Float64Array, Float64N, Float64Nx3, Float64Nx3x3, Int64Array
from facadelake.georeferencing.adjustment.linearise import (
    LinearisedPointToPlane,
    LinearisedReprojection,
    linearise_point_priors,
    linearise_point_to_plane,
    linearise_reprojection,
)
from facadelake.georeferencing.adjustment.parameter_priors import add_parameter_priors
from facadelake.georeferencing.adjustment.parameters import AdjustmentState, ParameterIndex
from facadelake.georeferencing.adjustment.problem import AdjustmentProblem

_POINTS_PER_BATCH = 2048  # neighbours share photographs, so a batch is dense in a few hundred parameters
# Eigenvalues of a point's information are raised to this share of its largest (and to this value, 1/m2), so that it can
# be inverted. Added to every point instead, it would constrain the whole block: thousands of points move with it.
_MIN_EIGENVALUE_SHARE = 1e-10
_MIN_INFORMATION = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Coupling:
    """Off-diagonal blocks of the normal matrix between the reduced system's parameters and the object points.

    Entry k couples parameter ``row[k]`` with the three coordinates of ``point[k]`` by ``value[k]`` (3,); sorted by
    point.
    """

    row: Int64Array
    point: Int64Array
    value: Float64Nx3


@dataclass(frozen=True, kw_only=True, eq=False)
class ReducedCameraSystem:
    """The reduced system and what back-substitution needs.

    ``matrix`` (g, g) and ``gradient`` (g,) after elimination; ``point_covariance_m2`` (m, 3, 3) and ``point_gradient``
    (m, 3): inverse of the object points' diagonal blocks, and their gradient; ``cost``: the robust cost.
    """

    matrix: Float64Array
    gradient: Float64N
    point_covariance_m2: Float64Nx3x3
    point_gradient: Float64Nx3
    coupling: Coupling
    cost: float

    def compute_point_step(self, step: Float64N) -> Float64Nx3:
        """Back-substitution: the object points' step (m, 3) that belongs to the parameters' ``step`` (g,)."""
        gradient = self.point_gradient + _sum_by_point(
            self.coupling.point, self.coupling.value * step[self.coupling.row][:, None], len(self.point_gradient)
        )
        point_step: Float64Array = -np.einsum("mij,mj->mi", self.point_covariance_m2, gradient)
        return point_step


def _sum_by_point(point: Int64Array, values: Float64Array, count: int) -> Float64Array:
    """Sums (count, ...) of ``values`` (k, ...) over equal ``point`` (k,)."""
    flat = values.reshape(len(values), int(np.prod(values.shape[1:])))
    sums = np.zeros((count, flat.shape[1]))
    for j in range(flat.shape[1]):
        sums[:, j] = np.bincount(point, weights=flat[:, j], minlength=count)
    return sums.reshape(count, *values.shape[1:])


def compute_cost(problem: AdjustmentProblem, state: AdjustmentState, tie_sigma_px: float) -> float:
    """The robust cost of a state, without the normal equations."""
    size = ParameterIndex.build(problem).size
    return (
        linearise_reprojection(problem, state, tie_sigma_px).cost
        + linearise_point_to_plane(problem, state).cost
        + linearise_point_priors(problem, state).cost
        + add_parameter_priors(problem, state, np.zeros((size, size)), np.zeros(size))
    )


def build_reduced_system(
    problem: AdjustmentProblem, state: AdjustmentState, tie_sigma_px: float
) -> ReducedCameraSystem:
    """Linearise about ``state`` and eliminate the object points; tie points have ``tie_sigma_px`` per axis."""
    index, count = ParameterIndex.build(problem), len(state.xyz_site_m)
    matrix, gradient = np.zeros((index.size, index.size)), np.zeros(index.size)
    reprojection, planes, priors = (
        linearise_reprojection(problem, state, tie_sigma_px),
        linearise_point_to_plane(problem, state),
        linearise_point_priors(problem, state),
    )
    cost = reprojection.cost + planes.cost + priors.cost + add_parameter_priors(problem, state, matrix, gradient)
    _add_reprojection(problem, reprojection, index, matrix, gradient)
    _add_wall_deviations(problem, planes, index, matrix, gradient)
    by_image_point, by_plane, by_prior = (
        problem.image_points.point,
        problem.point_to_plane.point,
        problem.point_priors.point,
    )
    information = (
        _sum_by_point(
            by_image_point,
            np.einsum("kai,kaj->kij", reprojection.jacobian_point, reprojection.jacobian_point),
            count,
        )
        + _sum_by_point(by_plane, np.einsum("ki,kj->kij", planes.jacobian_point, planes.jacobian_point), count)
        + _sum_by_point(by_prior, priors.information, count)
    )
    point_gradient = (
        _sum_by_point(
            by_image_point, np.einsum("kai,ka->ki", reprojection.jacobian_point, reprojection.residual), count
        )
        + _sum_by_point(by_plane, planes.jacobian_point * planes.residual[:, None], count)
        + _sum_by_point(by_prior, priors.gradient, count)
    )
    information = _floor_information(information)
    coupling = _build_coupling(problem, reprojection, planes, index)
    _eliminate_points(coupling, information, point_gradient, matrix, gradient)
    return ReducedCameraSystem(
        matrix=matrix,
        gradient=gradient,
        point_covariance_m2=np.linalg.inv(information).astype(np.float64),
        point_gradient=point_gradient,
        coupling=coupling,
        cost=cost,
    )


def _floor_information(information: Float64Nx3x3) -> Float64Nx3x3:
    """``information`` (m, 3, 3) with the eigenvalues of undetermined directions raised, so that it can be inverted."""
    size = np.trace(information, axis1=1, axis2=2)
    # The determinant finds every point with an undetermined direction; only these are decomposed.
    weak = np.linalg.det(information) <= np.maximum(_MIN_EIGENVALUE_SHARE * size, _MIN_INFORMATION) * size**2
    values, axes = np.linalg.eigh(information[weak])
    raised = np.maximum(values, np.maximum(_MIN_EIGENVALUE_SHARE * values[:, -1:], _MIN_INFORMATION))
    out = information.copy()
    out[weak] = (axes * raised[:, None, :]) @ axes.transpose(0, 2, 1)
    return out


def _index_camera_parameters(problem: AdjustmentProblem, index: ParameterIndex) -> Int64Array:
    """Parameters (k, 14) of each image point: the six of its photograph and the eight of its lens."""
    photo = problem.image_points.photo
    lens = problem.block.camera_of_photo[photo]
    return np.hstack([6 * photo[:, None] + np.arange(6), index.lens + 8 * lens[:, None] + np.arange(8)])


def _add_reprojection(
    problem: AdjustmentProblem,
    reprojection: LinearisedReprojection,
    index: ParameterIndex,
    matrix: Float64Array,
    gradient: Float64N,
) -> None:
    """Add the diagonal blocks of photographs and lenses in place."""
    columns = _index_camera_parameters(problem, index)
    order = np.argsort(problem.image_points.photo, kind="stable")
    ends = np.searchsorted(problem.image_points.photo[order], np.arange(len(problem.block.centre_site_m) + 1))
    for begin, end in pairwise(ends):
        if begin == end:
            continue
        rows = order[begin:end]
        jacobian = np.concatenate(
            [reprojection.jacobian_photo[rows], reprojection.jacobian_lens[rows]], axis=2
        ).reshape(-1, 14)
        parameters = columns[rows[0]]
        matrix[np.ix_(parameters, parameters)] += jacobian.T @ jacobian
        gradient[parameters] += jacobian.T @ reprojection.residual[rows].ravel()


def _add_wall_deviations(
    problem: AdjustmentProblem,
    planes: LinearisedPointToPlane,
    index: ParameterIndex,
    matrix: Float64Array,
    gradient: Float64N,
) -> None:
    """Add the diagonal of the walls' deviations in place."""
    has_wall = problem.point_to_plane.wall >= 0
    rows = index.wall + problem.point_to_plane.wall[has_wall]
    np.add.at(matrix, (rows, rows), planes.jacobian_wall[has_wall] ** 2)
    np.add.at(gradient, rows, planes.jacobian_wall[has_wall] * planes.residual[has_wall])


def _build_coupling(
    problem: AdjustmentProblem,
    reprojection: LinearisedReprojection,
    planes: LinearisedPointToPlane,
    index: ParameterIndex,
) -> Coupling:
    jacobian = np.concatenate([reprojection.jacobian_photo, reprojection.jacobian_lens], axis=2)
    product = np.einsum("kag,kai->kgi", jacobian, reprojection.jacobian_point)
    has_wall = problem.point_to_plane.wall >= 0
    row = np.concatenate(
        [_index_camera_parameters(problem, index).ravel(), index.wall + problem.point_to_plane.wall[has_wall]]
    )
    point = np.concatenate([np.repeat(problem.image_points.point, 14), problem.point_to_plane.point[has_wall]])
    value = np.concatenate(
        [product.reshape(-1, 3), planes.jacobian_wall[has_wall][:, None] * planes.jacobian_point[has_wall]]
    )
    order = np.argsort(point, kind="stable")
    return Coupling(row=row[order], point=point[order], value=value[order])


def _eliminate_points(
    coupling: Coupling,
    information: Float64Nx3x3,
    point_gradient: Float64Nx3,
    matrix: Float64Array,
    gradient: Float64N,
) -> None:
    """Subtract the Schur complement of the object points from ``matrix`` and ``gradient`` in place."""
    # information = L L^T, so its inverse is M^T M with M = inv(L)
    root = np.linalg.inv(np.linalg.cholesky(information))
    count = len(information)
    for begin in range(0, count, _POINTS_PER_BATCH):
        end = min(count, begin + _POINTS_PER_BATCH)
        first, last = np.searchsorted(coupling.point, (begin, end))
        if first < last:
            rows, local = np.unique(coupling.row[first:last], return_inverse=True)
            points = coupling.point[first:last] - begin
            shape = (len(rows), 3 * (end - begin))
            columns = (3 * points[:, None] + np.arange(3)).ravel()
            dense = coo_matrix(
                (coupling.value[first:last].ravel(), (np.repeat(local, 3), columns)), shape=shape
            ).toarray()
            white = np.einsum("gmi,mji->gmj", dense.reshape(len(rows), -1, 3), root[begin:end]).reshape(shape)
            matrix[np.ix_(rows, rows)] -= white @ white.T
            gradient[rows] -= white @ np.einsum("mij,mj->mi", root[begin:end], point_gradient[begin:end]).ravel()
