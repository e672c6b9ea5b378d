"""The building's model as observations: tie points on its walls, its edges in the photographs."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from facadelake.core.arrays import Float64Array, Int64Array, RowIndices
from facadelake.georeferencing.adjustment.linearise import AdjustmentState
from facadelake.georeferencing.adjustment.problem import PointToPlaneTerms
from facadelake.georeferencing.adjustment.tie_points import TiePointSelection

_MIN_FACING_COSINE = 0.25  # rays more grazing than 75 degrees tell little of the plane they meet
_MIN_POINTS_PER_WALL = 30  # walls with fewer points have no deviation of their own
_MIN_TRACK_LENGTH = 3


class RayHits(Protocol):
    """What a ray cast gives: distances (n,), inf for a miss, unit normals (n, 3) turned to the ray's origin, and the
    element (n,) that was met."""

    @property
    def distance_m(self) -> Float64Array: ...

    @property
    def normal_site(self) -> Float64Array: ...

    @property
    def element(self) -> Int64Array: ...


class RaySurface(Protocol):
    """The building's surface in site; ``facadelake.building.surface.raycasting.Surface`` is one."""

    def cast(self, origins_site_m: Float64Array, directions_site: Float64Array, /) -> RayHits:
        """First hits of rays (n, 3) from origins (n, 3), in site metres."""


def build_empty_terms() -> PointToPlaneTerms:
    """No model."""
    return PointToPlaneTerms(
        point=np.zeros(0, dtype=np.int64),
        normal_site=np.zeros((0, 3)),
        distance_m=np.zeros(0),
        wall=np.zeros(0, dtype=np.int64),
        sigma_m=np.zeros(0),
        wall_sigma_m=np.zeros(0),
    )


def match_points_to_surface(
    ties: TiePointSelection, state: AdjustmentState, surface: RaySurface, *, gate_m: float, model_sigma_m: float
) -> PointToPlaneTerms:
    """Tie points seen three times or more that lie within ``gate_m`` of the face that a camera saw them on.

    A point belongs to the face that the ray of its nearest camera meets, never to the back of a wall or a
    neighbouring plane. Points of one element and facing share the element's deviation; ``model_sigma_m`` is the sigma
    of both, the wall's and the single point's (relief).
    """
    xyz = state.xyz_site_m[: len(ties.reconstruction_point)]
    seen = np.bincount(ties.point, minlength=len(xyz))
    camera = _find_nearest_camera(ties, state, xyz)
    node = np.flatnonzero(seen >= _MIN_TRACK_LENGTH)
    origin = state.centre_site_m[camera[node]]
    ray = xyz[node] - origin
    direction = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    hits = surface.cast(origin, direction)
    met = np.isfinite(hits.distance_m)
    normal = np.where(met[:, None], hits.normal_site, 0.0)
    foot = origin + np.where(met, hits.distance_m, 0.0)[:, None] * direction
    away = np.einsum("ij,ij->i", normal, xyz[node] - foot)
    facing = -np.einsum("ij,ij->i", normal, direction)
    good = met & (facing > _MIN_FACING_COSINE) & (np.abs(away) < gate_m)
    node, normal, foot = node[good], normal[good], foot[good]
    wall, count = _group_by_wall(hits.element[good], normal)
    return PointToPlaneTerms(
        point=node,
        normal_site=normal,
        distance_m=np.einsum("ij,ij->i", normal, foot),
        wall=wall,
        sigma_m=np.full(len(node), model_sigma_m),
        wall_sigma_m=np.full(count, model_sigma_m),
    )


def _find_nearest_camera(ties: TiePointSelection, state: AdjustmentState, xyz: Float64Array) -> RowIndices:
    distance = np.linalg.norm(xyz[ties.point] - state.centre_site_m[ties.photo], axis=1)
    order = np.lexsort((distance, ties.point))
    node, first = np.unique(ties.point[order], return_index=True)
    camera = np.zeros(len(xyz), dtype=np.int64)
    camera[node] = ties.photo[order][first]
    return camera


def _group_by_wall(element: Int64Array, normal: Float64Array) -> tuple[RowIndices, int]:
    """A wall (k,) for each point, -1 for those of walls with few points, and how many walls there are."""
    if not len(element):
        return np.zeros(0, dtype=np.int64), 0
    key = np.column_stack([element, np.round(2 * normal).astype(np.int64)])
    _, group, size = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    number = np.full(len(size), -1)
    number[size >= _MIN_POINTS_PER_WALL] = np.arange(int((size >= _MIN_POINTS_PER_WALL).sum()))
    return number[group.ravel()], int((size >= _MIN_POINTS_PER_WALL).sum())
