"""Occlusion by what the model does not contain: trees, vehicles, scaffolds.

The evidence is the campaign's own tie points: those that the photograph itself shows, and those of other photographs
that lie in its line of sight, whether they were matched here or not. They are triangulated in the image plane; where
all three corners of a triangle are well in front of the model, the photograph shows something else than the building. A
tie point on the wall breaks up the triangles around it: there the wall is visible.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, QhullError
from shapely import STRtree

from facadelake.building.surface import Surface
from facadelake.core.arrays import (
    BoolArray,
    Float64Array,
    Float64N,
    Float64Nx2,
    Float64Nx3,
    Float64Nx4,
    Int64Array,
    RowIndices,
)
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.registration.tie_points import TiePoints

_DIRECTIONS = 8  # compass directions of walls; horizontal surfaces are a ninth group
_LEVEL_DEG = 60.0  # inclination of a normal from which a surface counts as horizontal
# Tie points of the photograph itself that confirm an occluder: those of others may be of another time.
_CONFIRMING_POINTS_MIN = 3
# Ratio of the distance from the ray to that along it; beyond, the lens model has folded the point into the image.
_FOLDED_MAX = 0.02


@dataclass(frozen=True, kw_only=True)
class OcclusionSettings:
    """When tie points in front of the model are an occluder.

    ``gap_min_m``: minimum gap; relief, sills, pipes and small cornices are nearer to the wall, and a defect may be on
    them. ``gap_sigmas``: minimum gap in sigmas of tie point, placement of the campaign and offset of the facade from
    its model together. ``hole_max_m``: maximum distance between tie points of one triangle; through larger holes the
    wall may be visible. ``share_min``: share of a box that must be occluded. ``rays_per_side``: a box is sampled by the
    square of this many rays.
    """

    gap_min_m: float = 0.3
    gap_sigmas: float = 4.0
    hole_max_m: float = 1.0
    share_min: float = 0.5
    rays_per_side: int = 5

    def __post_init__(self) -> None:
        if min(self.gap_min_m, self.gap_sigmas, self.hole_max_m) <= 0 or not 0 < self.share_min <= 1:
            raise InputDataError(
                f"occlusion settings are out of range: {self}; required: gap_min_m, gap_sigmas and hole_max_m > 0, "
                "share_min in (0, 1]"
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxOcclusion:
    """Occlusion of n boxes.

    ``occluded`` (n,): an occluder stops at least ``share_min`` of the rays; ``share`` (n,): share of the rays that it
    stops; ``gap_m`` (n,): median gap along the ray; ``limit_m`` (n,): median minimum gap. Gap and limit are NaN where
    nothing is occluded.
    """

    occluded: BoolArray
    share: Float64N
    gap_m: Float64N
    limit_m: Float64N


@dataclass(frozen=True, kw_only=True, eq=False)
class _ImageTiePoints:
    """Tie points in one photograph.

    ``xy_img`` (k, 2) pixels; ``point`` (k,) rows of the tie points; ``observed`` (k,): they are image points of this
    photograph; ``before_model`` (k,): they are in front of the model, by more than ``limit_m`` (k,).
    """

    xy_img: Float64Nx2
    point: RowIndices
    observed: BoolArray
    before_model: BoolArray
    limit_m: Float64N


class Occluders:
    """The tie points of a campaign that are in front of the model.

    Args:
        points: the campaign's tie points.
        posed: cameras of the localised photographs by photo_id.
        surface: the building's surface.
        placement_sigma_m: one sigma of the campaign's position relative to the model.
        settings: limits of occlusion.
    """

    def __init__(
        self,
        points: TiePoints,
        posed: Mapping[str, PosedCamera],
        surface: Surface,
        *,
        placement_sigma_m: float,
        settings: OcclusionSettings,
    ) -> None:
        self._points, self._posed, self._surface, self._settings = points, posed, surface, settings
        self._model_distance_m = surface.measure_distance(points.xyz_site_m) if len(points.xyz_site_m) else np.zeros(0)
        self._offsets_m = np.hypot(self._estimate_offsets(), placement_sigma_m)

    def _estimate_offsets(self) -> Float64N:
        """Median distance (_DIRECTIONS + 1,) in m of the tie points of each direction's facades from the model.

        A campaign placed by GPS alone is metres off, which must not count as an occluder.
        """
        off, facing = [np.zeros(0)], [np.zeros(0, dtype=np.int64)]
        for photo_id, image_points in self._points.image_points.items():
            origins, directions = self._posed[photo_id].rays_site_from_img(image_points.xy_img)
            hits = self._surface.cast(origins, directions)
            hit = hits.hit
            offset = hits.xyz_site_m[hit] - self._points.xyz_site_m[image_points.point[hit]]
            off.append(np.abs(np.einsum("ij,ij->i", offset, hits.normal_site[hit])))
            facing.append(_group_by_direction(hits.normal_site[hit]))
        distance, direction = np.concatenate(off), np.concatenate(facing)
        overall = float(np.median(distance)) if len(distance) else 0.0
        groups = [distance[direction == k] for k in range(_DIRECTIONS + 1)]
        return np.array([np.median(group) if len(group) else overall for group in groups])

    def measure_occlusion(self, photo_id: str, boxes_px: Float64Nx4) -> BoxOcclusion:
        """Occlusion of the boxes (n, 4; x, y, width, height in pixels) of one photograph."""
        n, side = len(boxes_px), self._settings.rays_per_side
        unoccluded = BoxOcclusion(
            occluded=np.zeros(n, dtype=bool), share=np.zeros(n), gap_m=np.full(n, np.nan), limit_m=np.full(n, np.nan)
        )
        image = self._project_tie_points(photo_id)
        if image is None or image.before_model.sum() < 3:
            return unoccluded
        try:
            mesh = Delaunay(image.xy_img)
        except QhullError:  # all points are collinear
            return unoccluded
        corners = mesh.simplices[image.before_model[mesh.simplices].all(axis=1)]
        corners_xyz = self._points.xyz_site_m[image.point[corners]]
        longest = np.linalg.norm(corners_xyz - np.roll(corners_xyz, 1, axis=1), axis=2).max(axis=1, initial=0.0)
        corners = corners[longest <= self._settings.hole_max_m]
        corners = corners[_are_confirmed(corners, image.observed)]
        if not len(corners):
            return unoccluded
        share = (np.arange(side) + 0.5) / side
        grid = np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2)
        pixels = (boxes_px[:, None, :2] + grid[None] * boxes_px[:, None, 2:]).reshape(-1, 2)
        # Not Delaunay.find_simplex: it calls LAPACK per triangle, whose threads then compete.
        inside, facet = STRtree(shapely.polygons(image.xy_img[corners])).query(shapely.points(pixels), "intersects")
        inside, first = np.unique(inside, return_index=True)
        origins, directions = self._posed[photo_id].rays_site_from_img(pixels)
        hits = self._surface.cast(origins, directions)
        gap, limit = np.full(len(pixels), np.nan), np.full(len(pixels), np.nan)
        hit = hits.hit[inside]
        covered, triangle = inside[hit], corners[facet[first[hit]]]
        xyz = self._points.xyz_site_m[image.point[triangle]]
        gap[covered] = hits.distance_m[covered] - _intersect_triangles(origins[covered], directions[covered], xyz)
        limit[covered] = image.limit_m[triangle].max(axis=1)
        hidden = (np.nan_to_num(gap, nan=-np.inf) > np.nan_to_num(limit, nan=np.inf)).reshape(n, -1)
        on_model = hits.hit.reshape(n, -1).sum(axis=1)
        any_hidden = hidden.any(axis=1)
        gap, limit = (np.where(hidden, values.reshape(n, -1), np.nan) for values in (gap, limit))
        share = hidden.sum(axis=1) / np.maximum(on_model, 1)
        return BoxOcclusion(
            occluded=share >= self._settings.share_min,
            share=share,
            gap_m=_compute_row_medians(gap, any_hidden),
            limit_m=_compute_row_medians(limit, any_hidden),
        )

    def _project_tie_points(self, photo_id: str) -> _ImageTiePoints | None:
        """The photograph's image points and other tie points in front of the model; None if it has no image points."""
        image_points = self._points.image_points.get(photo_id)
        if image_points is None or not len(image_points.point):
            return None
        posed = self._posed[photo_id]
        others = np.setdiff1d(np.flatnonzero(self._model_distance_m > self._settings.gap_min_m), image_points.point)
        pixels = posed.project_site(self._points.xyz_site_m[others])
        inside = posed.camera.is_inside(pixels)
        others, pixels = others[inside], pixels[inside]
        before_model, limit = self._find_before_model(posed, pixels, others)
        own_before_model, own_limit = self._find_before_model(posed, image_points.xy_img, image_points.point)
        kept = np.flatnonzero(before_model)
        return _ImageTiePoints(
            xy_img=np.vstack([image_points.xy_img, pixels[kept]]),
            point=np.concatenate([image_points.point, others[kept]]),
            observed=np.arange(len(own_before_model) + len(kept)) < len(own_before_model),
            before_model=np.concatenate([own_before_model, before_model[kept]]),
            limit_m=np.concatenate([own_limit, limit[kept]]),
        )

    def _find_before_model(
        self, posed: PosedCamera, xy_img: Float64Nx2, point: RowIndices
    ) -> tuple[BoolArray, Float64N]:
        """Which tie points are in front of the model, and the gap that each must exceed.

        Args:
            posed: the photograph's camera.
            xy_img: pixels (k, 2) of the tie points.
            point: their rows (k,).

        Returns:
            Mask (k,), and minimum gaps (k,) in m.
        """
        origins, directions = posed.rays_site_from_img(xy_img)
        hits = self._surface.cast(origins, directions)
        along = np.einsum("ij,ij->i", self._points.xyz_site_m[point] - origins, directions)
        across = np.linalg.norm(self._points.xyz_site_m[point] - origins - along[:, None] * directions, axis=1)
        variance = np.einsum("ki,kij,kj->k", directions, self._points.covariance_site_m2[point], directions)
        offset = np.full(len(directions), self._offsets_m.max())
        offset[hits.hit] = self._offsets_m[_group_by_direction(hits.normal_site[hits.hit])]
        limit = np.maximum(self._settings.gap_min_m, self._settings.gap_sigmas * np.sqrt(variance + offset**2))
        # Along a grazing ray a small relief makes a long gap: the nearest surface must be as far away.
        before_model: BoolArray = (hits.distance_m - along > limit) & (self._model_distance_m[point] > limit)
        # Brown's polynomial maps points far outside the field of view back into the image.
        return before_model & (across < _FOLDED_MAX * along), limit


def _group_by_direction(normals: Float64Nx3) -> Int64Array:
    """Group (n,) of unit normals (n, 3): compass direction of walls; _DIRECTIONS for horizontal surfaces."""
    azimuth = np.degrees(np.arctan2(normals[:, 0], normals[:, 1]))
    group = np.round(azimuth / (360 / _DIRECTIONS)).astype(np.int64) % _DIRECTIONS
    return np.where(np.abs(normals[:, 2]) > np.sin(np.radians(_LEVEL_DEG)), _DIRECTIONS, group)


def _are_confirmed(corners: Int64Array, observed: BoolArray) -> BoolArray:
    """Which triangles (t, 3) are connected to enough image points of the photograph itself (``observed`` (k,))."""
    edges = np.vstack([corners[:, [0, 1]], corners[:, [1, 2]]]).T
    graph = coo_array((np.ones(edges.shape[1], dtype=bool), (edges[0], edges[1])), shape=(len(observed), len(observed)))
    components, component = connected_components(graph, directed=False)
    confirmed = np.bincount(component[observed], minlength=components) >= _CONFIRMING_POINTS_MIN
    return np.asarray(confirmed[component[corners[:, 0]]])


def _intersect_triangles(origins: Float64Nx3, directions: Float64Nx3, corners: Float64Array) -> Float64N:
    """Distances (n,) along rays (n, 3) to the planes of their triangles.

    ``corners`` (n, 3, 3); a distance is clipped to those of the triangle's corners.
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    slope = np.einsum("ij,ij->i", normal, directions)
    height = np.einsum("ij,ij->i", normal, corners[:, 0] - origins)
    corner_distance = np.linalg.norm(corners - origins[:, None], axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        plane = np.where(slope == 0, corner_distance[:, 0], height / slope)
    clipped: Float64Array = np.clip(plane, corner_distance.min(axis=1), corner_distance.max(axis=1))
    return clipped


def _compute_row_medians(values: Float64Array, found: BoolArray) -> Float64Array:
    """Median of each row (n, k), ignoring NaN; NaN in rows that are not ``found``."""
    out = np.full(len(values), np.nan)
    out[found] = np.nanmedian(values[found], axis=1)
    return out
