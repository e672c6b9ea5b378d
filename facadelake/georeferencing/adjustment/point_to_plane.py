"""Point-to-plane observations: tie points on the faces of the building model that their cameras see them on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from facadelake.core.arrays import BoolArray, Float64N, Float64Nx3, Int64Array, RowIndices
from facadelake.georeferencing.adjustment.parameters import AdjustmentState
from facadelake.georeferencing.adjustment.problem import PointToPlaneTerms
from facadelake.georeferencing.adjustment.tie_points import TiePointSelection

_MIN_FACING_COSINE = 0.25  # beyond 75 degrees of incidence a ray determines its plane poorly
_MIN_POINTS_PER_WALL = 30  # walls with fewer points have no deviation of their own
_MIN_TRACK_LENGTH = 3


class RayHits(Protocol):
    """First hits of n rays: distances (n,), infinite for a miss; unit normals (n, 3) facing the ray's origin; and the
    element (n,) hit."""

    @property
    def distance_m(self) -> Float64N: ...

    @property
    def normal_site(self) -> Float64Nx3: ...

    @property
    def element(self) -> Int64Array: ...


class RaySurface(Protocol):
    """The building's surface in site; ``facadelake.building.surface.raycasting.Surface`` is one."""

    def cast(self, origins_site_m: Float64Nx3, directions_site: Float64Nx3, /) -> RayHits:
        """First hits of rays (n, 3) from origins (n, 3), in site metres."""


def build_empty_terms() -> PointToPlaneTerms:
    """No point-to-plane observations, for a block without a model."""
    return PointToPlaneTerms(
        point=np.zeros(0, dtype=np.int64),
        normal_site=np.zeros((0, 3)),
        distance_m=np.zeros(0),
        wall=np.zeros(0, dtype=np.int64),
        sigma_m=np.zeros(0),
        wall_sigma_m=np.zeros(0),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class VisibleFaces:
    """The faces that the rays from cameras through n points hit.

    ``facing`` (n,): a face is hit, at less than 75 degrees of incidence. ``foot_site_m`` (n, 3): the point hit;
    ``normal_site`` (n, 3), zero for a miss; ``distance_m`` (n,): signed distance of the point from the face's plane;
    ``element`` (n,).
    """

    facing: BoolArray
    foot_site_m: Float64Nx3
    normal_site: Float64Nx3
    distance_m: Float64N
    element: Int64Array

    def match(self, gate_m: float) -> BoolArray:
        """The points (n,) within ``gate_m`` of their face."""
        matched: BoolArray = self.facing & (np.abs(self.distance_m) < gate_m)
        return matched


def find_faces(xyz_site_m: Float64Nx3, origin_site_m: Float64Nx3, surface: RaySurface) -> VisibleFaces:
    """The faces hit by the rays from ``origin_site_m`` (n, 3) through ``xyz_site_m`` (n, 3)."""
    ray = xyz_site_m - origin_site_m
    direction = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    hits = surface.cast(origin_site_m, direction)
    hit = np.isfinite(hits.distance_m)
    normal = np.where(hit[:, None], hits.normal_site, 0.0)
    foot = origin_site_m + np.where(hit, hits.distance_m, 0.0)[:, None] * direction
    return VisibleFaces(
        facing=hit & (-np.einsum("ij,ij->i", normal, direction) > _MIN_FACING_COSINE),
        foot_site_m=foot,
        normal_site=normal,
        distance_m=np.einsum("ij,ij->i", normal, xyz_site_m - foot),
        element=hits.element,
    )


def match_points_to_surface(
    tie_points: TiePointSelection, state: AdjustmentState, surface: RaySurface, *, gate_m: float, model_sigma_m: float
) -> PointToPlaneTerms:
    """Match tie points with the faces of the model.

    A point belongs to the face that the ray of its nearest camera hits, never to the back of a wall or a neighbouring
    plane. Points on one element with one direction share that wall's deviation.

    Args:
        tie_points: the tie points; those with fewer than three image points are not matched.
        state: cameras and points at which rays are cast.
        surface: the model's surface.
        gate_m: largest distance of a point from its face.
        model_sigma_m: one sigma of a wall's deviation from the model, and of a single point's (relief).

    Returns:
        one observation for each matched tie point.
    """
    point, origin = select_points_with_origins(tie_points, state)
    faces = find_faces(state.xyz_site_m[point], origin, surface)
    matched = faces.match(gate_m)
    point, normal, foot = point[matched], faces.normal_site[matched], faces.foot_site_m[matched]
    wall, count = _group_by_wall(faces.element[matched], normal)
    return PointToPlaneTerms(
        point=point,
        normal_site=normal,
        distance_m=np.einsum("ij,ij->i", normal, foot),
        wall=wall,
        sigma_m=np.full(len(point), model_sigma_m),
        wall_sigma_m=np.full(count, model_sigma_m),
    )


def select_points_with_origins(tie_points: TiePointSelection, state: AdjustmentState) -> tuple[RowIndices, Float64Nx3]:
    """The tie points (k,) with three image points or more, and the centre (k, 3) of the nearest camera of each."""
    xyz = state.xyz_site_m[: len(tie_points)]
    track_length = np.bincount(tie_points.point, minlength=len(xyz))
    camera = _find_nearest_camera(tie_points, state, xyz)
    point = np.flatnonzero(track_length >= _MIN_TRACK_LENGTH)
    return point, state.centre_site_m[camera[point]]


def _find_nearest_camera(tie_points: TiePointSelection, state: AdjustmentState, xyz: Float64Nx3) -> RowIndices:
    """The photograph (t,) nearest to each tie point among those that show it."""
    distance = np.linalg.norm(xyz[tie_points.point] - state.centre_site_m[tie_points.photo], axis=1)
    order = np.lexsort((distance, tie_points.point))
    point, first = np.unique(tie_points.point[order], return_index=True)
    camera = np.zeros(len(xyz), dtype=np.int64)
    camera[point] = tie_points.photo[order][first]
    return camera


def _group_by_wall(element: Int64Array, normal: Float64Nx3) -> tuple[RowIndices, int]:
    """A wall (k,) for each point, -1 for those of walls with few points, and the number of walls."""
    if not len(element):
        return np.zeros(0, dtype=np.int64), 0
    key = np.column_stack([element, np.round(2 * normal).astype(np.int64)])
    _, group, size = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    number = np.full(len(size), -1)
    number[size >= _MIN_POINTS_PER_WALL] = np.arange(int((size >= _MIN_POINTS_PER_WALL).sum()))
    return number[group.ravel()], int((size >= _MIN_POINTS_PER_WALL).sum())
