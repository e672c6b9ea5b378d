"""The normal equations with the nodes eliminated (Schur complement), dense in the unknowns that are kept.

Source: Triggs et al. 2000, Bundle adjustment: a modern synthesis, section 6. A thousand photographs are a matrix of
6,000 rows, 300 MB and a few seconds to factorise; nodes are eliminated in batches, each dense in the photographs that
see it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_matrix

from facadelake.core.arrays import Float64Array, Int64Array
from facadelake.georeferencing.adjustment.linearise import (
    AdjustmentState,
    LinearisedPointToPlane,
    LinearisedReprojection,
    ParameterIndex,
    linearise_point_priors,
    linearise_point_to_plane,
    linearise_reprojection,
)
from facadelake.georeferencing.adjustment.parameter_priors import add_parameter_priors
from facadelake.georeferencing.adjustment.problem import AdjustmentProblem

_POINTS_PER_BATCH = 2048  # neighbours see the same photographs, so a batch is dense in a few hundred unknowns
# A direction in which a node is known worse than this share of its best (or, 1/m2, not at all) is held up to it, so
# that the node can be inverted. Added to every node, it would hold the whole block: thousands of nodes move with it.
_MIN_EIGENVALUE_SHARE = 1e-10
_MIN_INFORMATION = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Coupling:
    """Derivative products between kept unknowns and nodes: entry k couples unknown ``row`` with ``point`` by (3,)."""

    row: Int64Array
    point: Int64Array
    value: Float64Array


@dataclass(frozen=True, kw_only=True, eq=False)
class ReducedCameraSystem:
    """``matrix`` (g, g) and ``gradient`` (g,) of the kept unknowns, the nodes' inverse information (m, 3, 3) and
    gradient (m, 3), the coupling, sorted by node, and the robust cost."""

    matrix: Float64Array
    gradient: Float64Array
    point_covariance_m2: Float64Array
    point_gradient: Float64Array
    coupling: Coupling
    cost: float

    def compute_point_step(self, step: Float64Array) -> Float64Array:
        """The nodes' step (m, 3) that goes with the kept unknowns' ``step`` (g,)."""
        pull = self.point_gradient + _sum_by_point(
            self.coupling.point, self.coupling.value * step[self.coupling.row][:, None], len(self.point_gradient)
        )
        nodes: Float64Array = -np.einsum("mij,mj->mi", self.point_covariance_m2, pull)
        return nodes


def _sum_by_point(node: Int64Array, values: Float64Array, count: int) -> Float64Array:
    """Sums (count, ...) of ``values`` (k, ...) over equal ``point``."""
    flat = values.reshape(len(values), int(np.prod(values.shape[1:])))
    sums = np.zeros((count, flat.shape[1]))
    for j in range(flat.shape[1]):
        sums[:, j] = np.bincount(node, weights=flat[:, j], minlength=count)
    return sums.reshape(count, *values.shape[1:])


def compute_cost(problem: AdjustmentProblem, state: AdjustmentState, tie_sigma_px: float) -> float:
    """The robust cost of a state, without its derivatives' sums."""
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
    """Linearise about ``state`` and eliminate the nodes."""
    layout, count = ParameterIndex.build(problem), len(state.xyz_site_m)
    matrix, gradient = np.zeros((layout.size, layout.size)), np.zeros(layout.size)
    seen, walls, priors = (
        linearise_reprojection(problem, state, tie_sigma_px),
        linearise_point_to_plane(problem, state),
        linearise_point_priors(problem, state),
    )
    cost = seen.cost + walls.cost + priors.cost + add_parameter_priors(problem, state, matrix, gradient)
    _add_reprojection(problem, seen, layout, matrix, gradient)
    _add_wall_deviations(problem, walls, layout, matrix, gradient)
    information = (
        _sum_by_point(
            problem.image_points.point, np.einsum("kai,kaj->kij", seen.jacobian_point, seen.jacobian_point), count
        )
        + _sum_by_point(
            problem.point_to_plane.point, np.einsum("ki,kj->kij", walls.jacobian_point, walls.jacobian_point), count
        )
        + _sum_by_point(problem.point_priors.point, priors.information, count)
    )
    node_gradient = (
        _sum_by_point(problem.image_points.point, np.einsum("kai,ka->ki", seen.jacobian_point, seen.residual), count)
        + _sum_by_point(problem.point_to_plane.point, walls.jacobian_point * walls.residual[:, None], count)
        + _sum_by_point(problem.point_priors.point, priors.gradient, count)
    )
    information = _floor_information(information)
    coupling = _build_coupling(problem, seen, walls, layout)
    _eliminate_points(coupling, information, node_gradient, matrix, gradient)
    return ReducedCameraSystem(
        matrix=matrix,
        gradient=gradient,
        point_covariance_m2=np.linalg.inv(information).astype(np.float64),
        point_gradient=node_gradient,
        coupling=coupling,
        cost=cost,
    )


def _floor_information(information: Float64Array) -> Float64Array:
    """``information`` (m, 3, 3), its open directions raised to what can be inverted."""
    size = np.trace(information, axis1=1, axis2=2)
    # No node with an open direction passes by its determinant; few others are looked at.
    weak = np.linalg.det(information) <= np.maximum(_MIN_EIGENVALUE_SHARE * size, _MIN_INFORMATION) * size**2
    values, axes = np.linalg.eigh(information[weak])
    raised = np.maximum(values, np.maximum(_MIN_EIGENVALUE_SHARE * values[:, -1:], _MIN_INFORMATION))
    out = information.copy()
    out[weak] = (axes * raised[:, None, :]) @ axes.transpose(0, 2, 1)
    return out


def _index_camera_parameters(problem: AdjustmentProblem, layout: ParameterIndex) -> Int64Array:
    """The kept unknowns (k, 14) of each sighting: its photograph's six and its lens's eight."""
    photo = problem.image_points.photo
    lens = problem.block.camera_of_photo[photo]
    return np.hstack([6 * photo[:, None] + np.arange(6), layout.lens + 8 * lens[:, None] + np.arange(8)])


def _add_reprojection(
    problem: AdjustmentProblem,
    seen: LinearisedReprojection,
    layout: ParameterIndex,
    matrix: Float64Array,
    gradient: Float64Array,
) -> None:
    columns = _index_camera_parameters(problem, layout)
    order = np.argsort(problem.image_points.photo, kind="stable")
    ends = np.searchsorted(problem.image_points.photo[order], np.arange(len(problem.block.centre_site_m) + 1))
    for begin, end in pairwise(ends):
        if begin == end:
            continue
        rows = order[begin:end]
        jacobian = np.concatenate([seen.jacobian_photo[rows], seen.jacobian_lens[rows]], axis=2).reshape(-1, 14)
        at = columns[rows[0]]
        matrix[np.ix_(at, at)] += jacobian.T @ jacobian
        gradient[at] += jacobian.T @ seen.residual[rows].ravel()


def _add_wall_deviations(
    problem: AdjustmentProblem,
    rows: LinearisedPointToPlane,
    layout: ParameterIndex,
    matrix: Float64Array,
    gradient: Float64Array,
) -> None:
    on = problem.point_to_plane.wall >= 0
    place = layout.wall + problem.point_to_plane.wall[on]
    np.add.at(matrix, (place, place), rows.jacobian_wall[on] ** 2)
    np.add.at(gradient, place, rows.jacobian_wall[on] * rows.residual[on])


def _build_coupling(
    problem: AdjustmentProblem, seen: LinearisedReprojection, walls: LinearisedPointToPlane, layout: ParameterIndex
) -> Coupling:
    jacobian = np.concatenate([seen.jacobian_photo, seen.jacobian_lens], axis=2)
    product = np.einsum("kag,kai->kgi", jacobian, seen.jacobian_point)
    on = problem.point_to_plane.wall >= 0
    row = np.concatenate(
        [_index_camera_parameters(problem, layout).ravel(), layout.wall + problem.point_to_plane.wall[on]]
    )
    node = np.concatenate([np.repeat(problem.image_points.point, 14), problem.point_to_plane.point[on]])
    value = np.concatenate([product.reshape(-1, 3), walls.jacobian_wall[on][:, None] * walls.jacobian_point[on]])
    order = np.argsort(node, kind="stable")
    return Coupling(row=row[order], point=node[order], value=value[order])


def _eliminate_points(
    coupling: Coupling,
    information: Float64Array,
    node_gradient: Float64Array,
    matrix: Float64Array,
    gradient: Float64Array,
) -> None:
    """Subtract the nodes' part from ``matrix`` and ``gradient`` in place."""
    # information = L L^T, so its inverse is M^T M with M = inv(L)
    root = np.linalg.inv(np.linalg.cholesky(information))
    count = len(information)
    for begin in range(0, count, _POINTS_PER_BATCH):
        end = min(count, begin + _POINTS_PER_BATCH)
        first, last = np.searchsorted(coupling.point, (begin, end))
        if first < last:
            touched, local = np.unique(coupling.row[first:last], return_inverse=True)
            nodes = coupling.point[first:last] - begin
            shape = (len(touched), 3 * (end - begin))
            columns = (3 * nodes[:, None] + np.arange(3)).ravel()
            dense = coo_matrix(
                (coupling.value[first:last].ravel(), (np.repeat(local, 3), columns)), shape=shape
            ).toarray()
            white = np.einsum("gmi,mji->gmj", dense.reshape(len(touched), -1, 3), root[begin:end]).reshape(shape)
            matrix[np.ix_(touched, touched)] -= white @ white.T
            gradient[touched] -= white @ np.einsum("mij,mj->mi", root[begin:end], node_gradient[begin:end]).ravel()
