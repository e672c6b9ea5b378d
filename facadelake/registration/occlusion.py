"""What stands before the building: trees, vehicles, scaffolds, that the photographs saw and the model does not know.

The campaign's own tie points are the evidence: those that the photograph itself saw, and those of others that stand in
its line of sight, for matter hides the wall whether it was matched here or not. They are meshed in the picture; where
all three corners of a triangle stand in the open, well before the model, the photograph shows something else than the
building there. A tie point on the wall breaks the triangles about it: there the wall is seen.
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
from facadelake.core.arrays import BoolArray, Float64Array, Int64Array
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.registration.tie_points import TiePoints

_DIRECTIONS = 8  # of walls; what lies level is a ninth
_LEVEL_DEG = 60.0
_CONFIRMING_POINTS_MIN = (
    3  # own sightings that an occluder must have: what others saw may have been there at another time
)
_FOLDED_MAX = 0.02  # a point this far off the ray of its own pixel, by its distance, was not projected truly


@dataclass(frozen=True, kw_only=True)
class OcclusionSettings:
    """When something before the model is an occluder.

    ``gap_min_m``: relief, sills, pipes and small cornices stand nearer to the wall, and a defect may be on them.
    ``gap_sigmas``: the gap must also be so many sigma of the tie point, of the campaign's placement and of how far the
    facade stands off its model, together. ``hole_max_m``: between tie points further apart one may see past the
    occluder. ``share_min``: this share of a box must be hidden. ``rays_per_side``: a box is sampled by its square.
    """

    gap_min_m: float = 0.3
    gap_sigmas: float = 4.0
    hole_max_m: float = 1.0
    share_min: float = 0.5
    rays_per_side: int = 5

    def __post_init__(self) -> None:
        if min(self.gap_min_m, self.gap_sigmas, self.hole_max_m) <= 0 or not 0 < self.share_min <= 1:
            raise InputDataError(f"occlusion settings {self} are out of range: lengths above 0, share_min in 0..1")


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxOcclusion:
    """Of n boxes: the share (n,) of their rays that an occluder stops, the limit of the gap (n,) and its median (n,),
    metres along the ray, NaN where nothing is hidden."""

    share: Float64Array
    gap_m: Float64Array
    limit_m: Float64Array


@dataclass(frozen=True, kw_only=True, eq=False)
class _ImageTiePoints:
    """Tie points in one photograph: pixels (k, 2), rows of the tie points, whether the photograph itself saw them,
    whether they stand before the model, and by how much they must."""

    xy_img: Float64Array
    point: Int64Array
    observed: BoolArray
    before_model: BoolArray
    limit_m: Float64Array


class Occluders:
    """Tie points judged against the model; ``placement_sigma_m`` is one sigma of where the campaign lies."""

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
        self._apart_m = surface.measure_distance(points.xyz_site_m) if len(points.xyz_site_m) else np.zeros(0)
        self._offsets_m = np.hypot(self._estimate_offsets(), placement_sigma_m)

    def _estimate_offsets(self) -> Float64Array:
        """How far the facades of each direction stand off the model (_DIRECTIONS + 1,): the median over tie points.

        A campaign placed by GPS alone is metres off, and then that is no occluder.
        """
        off, facing = [np.zeros(0)], [np.zeros(0, dtype=np.int64)]
        for photo_id, sights in self._points.image_points.items():
            origins, directions = self._posed[photo_id].rays_site_from_img(sights.xy_img)
            hits = self._surface.cast(origins, directions)
            met = hits.hit
            between = hits.xyz_site_m[met] - self._points.xyz_site_m[sights.point[met]]
            off.append(np.abs(np.einsum("ij,ij->i", between, hits.normal_site[met])))
            facing.append(_group_by_direction(hits.normal_site[met]))
        distance, direction = np.concatenate(off), np.concatenate(facing)
        usual = float(np.median(distance)) if len(distance) else 0.0
        groups = [distance[direction == k] for k in range(_DIRECTIONS + 1)]
        return np.array([np.median(group) if len(group) else usual for group in groups])

    def measure_occlusion(self, photo_id: str, boxes_px: Float64Array) -> BoxOcclusion:
        """What stands before the model in the boxes (n, 4; x, y, width, height) of one photograph."""
        n, side = len(boxes_px), self._settings.rays_per_side
        nothing = BoxOcclusion(share=np.zeros(n), gap_m=np.full(n, np.nan), limit_m=np.full(n, np.nan))
        seen = self._project_tie_points(photo_id)
        if seen is None or seen.before_model.sum() < 3:
            return nothing
        try:
            mesh = Delaunay(seen.xy_img)
        except QhullError:  # all on one line
            return nothing
        corners = mesh.simplices[seen.before_model[mesh.simplices].all(axis=1)]
        corners_xyz = self._points.xyz_site_m[seen.point[corners]]
        longest = np.linalg.norm(corners_xyz - np.roll(corners_xyz, 1, axis=1), axis=2).max(axis=1, initial=0.0)
        corners = corners[longest <= self._settings.hole_max_m]
        corners = corners[_are_confirmed(corners, seen.observed)]
        if not len(corners):
            return nothing
        share = (np.arange(side) + 0.5) / side
        grid = np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2)
        pixels = (boxes_px[:, None, :2] + grid[None] * boxes_px[:, None, 2:]).reshape(-1, 2)
        # Not by Delaunay.find_simplex, which sets LAPACK on each triangle by itself, and its threads on one another.
        inside, facet = STRtree(shapely.polygons(seen.xy_img[corners])).query(shapely.points(pixels), "intersects")
        inside, first = np.unique(inside, return_index=True)
        origins, directions = self._posed[photo_id].rays_site_from_img(pixels)
        hits = self._surface.cast(origins, directions)
        gap, wanted = np.full(len(pixels), np.nan), np.full(len(pixels), np.nan)
        met = hits.hit[inside]
        covered, triangle = inside[met], corners[facet[first[met]]]
        xyz = self._points.xyz_site_m[seen.point[triangle]]
        gap[covered] = hits.distance_m[covered] - _intersect_triangles(origins[covered], directions[covered], xyz)
        wanted[covered] = seen.limit_m[triangle].max(axis=1)
        hidden = (np.nan_to_num(gap, nan=-np.inf) > np.nan_to_num(wanted, nan=np.inf)).reshape(n, -1)
        on_model = hits.hit.reshape(n, -1).sum(axis=1)
        found = hidden.any(axis=1)
        gap, wanted = (np.where(hidden, values.reshape(n, -1), np.nan) for values in (gap, wanted))
        return BoxOcclusion(
            share=hidden.sum(axis=1) / np.maximum(on_model, 1),
            gap_m=_compute_row_medians(gap, found),
            limit_m=_compute_row_medians(wanted, found),
        )

    def _project_tie_points(self, photo_id: str) -> _ImageTiePoints | None:
        """The photograph's own tie points, and others' that stand before the model in it; None without its own."""
        sights = self._points.image_points.get(photo_id)
        if sights is None or not len(sights.point):
            return None
        posed = self._posed[photo_id]
        others = np.setdiff1d(np.flatnonzero(self._apart_m > self._settings.gap_min_m), sights.point)
        pixels = posed.project_site(self._points.xyz_site_m[others])
        inside = posed.camera.is_inside(pixels)
        others, pixels = others[inside], pixels[inside]
        standing, limit = self._find_before_model(posed, pixels, others)
        mine, my_limit = self._find_before_model(posed, sights.xy_img, sights.point)
        kept = np.flatnonzero(standing)
        return _ImageTiePoints(
            xy_img=np.vstack([sights.xy_img, pixels[kept]]),
            point=np.concatenate([sights.point, others[kept]]),
            observed=np.arange(len(mine) + len(kept)) < len(mine),
            before_model=np.concatenate([mine, standing[kept]]),
            limit_m=np.concatenate([my_limit, limit[kept]]),
        )

    def _find_before_model(
        self, posed: PosedCamera, xy_img: Float64Array, point: Int64Array
    ) -> tuple[BoolArray, Float64Array]:
        """Which tie points (k,) at pixels (k, 2) stand in the open before the model, and the gap each must have."""
        origins, directions = posed.rays_site_from_img(xy_img)
        hits = self._surface.cast(origins, directions)
        along = np.einsum("ij,ij->i", self._points.xyz_site_m[point] - origins, directions)
        across = np.linalg.norm(self._points.xyz_site_m[point] - origins - along[:, None] * directions, axis=1)
        variance = np.einsum("ki,kij,kj->k", directions, self._points.covariance_site_m2[point], directions)
        offset = np.full(len(directions), self._offsets_m.max())
        offset[hits.hit] = self._offsets_m[_group_by_direction(hits.normal_site[hits.hit])]
        limit = np.maximum(self._settings.gap_min_m, self._settings.gap_sigmas * np.sqrt(variance + offset**2))
        # Along a grazing ray a little relief makes a long gap: the point must stand off the model in every direction.
        standing: BoolArray = (hits.distance_m - along > limit) & (self._apart_m[point] > limit)
        # Far outside the picture Brown's polynomial folds points back into it.
        return standing & (across < _FOLDED_MAX * along), limit


def _group_by_direction(normals: Float64Array) -> Int64Array:
    """Group (n,) of unit normals (n, 3): the compass direction of walls, _DIRECTIONS for what lies level."""
    azimuth = np.degrees(np.arctan2(normals[:, 0], normals[:, 1]))
    group = np.round(azimuth / (360 / _DIRECTIONS)).astype(np.int64) % _DIRECTIONS
    return np.where(np.abs(normals[:, 2]) > np.sin(np.radians(_LEVEL_DEG)), _DIRECTIONS, group)


def _are_confirmed(corners: Int64Array, own: BoolArray) -> BoolArray:
    """Which triangles (t, 3) hang together with enough points that the photograph itself saw, (k,)."""
    edges = np.vstack([corners[:, [0, 1]], corners[:, [1, 2]]]).T
    graph = coo_array((np.ones(edges.shape[1], dtype=bool), (edges[0], edges[1])), shape=(len(own), len(own)))
    count, body = connected_components(graph, directed=False)
    enough = np.bincount(body[own], minlength=count) >= _CONFIRMING_POINTS_MIN
    return np.asarray(enough[body[corners[:, 0]]])


def _intersect_triangles(origins: Float64Array, directions: Float64Array, corners: Float64Array) -> Float64Array:
    """Where rays (n, 3) meet the planes of their triangles (n, 3, 3), kept between the triangle's own distances."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    slope = np.einsum("ij,ij->i", normal, directions)
    height = np.einsum("ij,ij->i", normal, corners[:, 0] - origins)
    reach = np.linalg.norm(corners - origins[:, None], axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        plane = np.where(slope == 0, reach[:, 0], height / slope)
    kept: Float64Array = np.clip(plane, reach.min(axis=1), reach.max(axis=1))
    return kept


def _compute_row_medians(values: Float64Array, found: BoolArray) -> Float64Array:
    """Median of each row (n, k) without its NaN; NaN in rows that are not ``found``."""
    out = np.full(len(values), np.nan)
    out[found] = np.nanmedian(values[found], axis=1)
    return out
