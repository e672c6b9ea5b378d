"""The outline of a detection on the surface: each vertex in the plane of what is next to it; its extents."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from facadelake.building.surface import Hits
from facadelake.core.arrays import BoolArray, Float64Array, Int64Array
from facadelake.core.camera import PosedCamera
from facadelake.core.geodesy import SiteOrigin
from facadelake.registration.outline import TREE_SEPARATION, Outlines
from facadelake.registration.rays import compute_pixel_rays

_UP = np.array([0.0, 0.0, 1.0])
_FLAT_COSINE = np.cos(np.radians(0.2))  # a patch whose normals turn by less is flat: its corners are enough
COSINE_MIN = 0.02  # a plane seen flatter than this is not prolonged
_STRETCH_MAX = 2.0  # nor to more than this multiple of the distance at which it was met
_CORNER_PITCHES = 1.5  # pitches: the cells around one
_BATCHED_VERTICES_MAX = 8  # vertices: up to so many, as of boxes, patches are measured together


def compute_tangents(normals_site: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Unit horizontal and upward tangents (n, 3) of surfaces with ``normals_site`` (n, 3).

    On a level surface, which has no horizontal tangent of its own, they are east and north.
    """
    across = np.cross(_UP, normals_site)
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    level = length < 0.05
    across = np.where(level, np.array([1.0, 0.0, 0.0]), across / np.where(level, 1.0, length))
    upward = np.cross(normals_site, across)
    return across, upward / np.linalg.norm(upward, axis=-1, keepdims=True)


def convert_patches_to_wkb(polygons_site: NDArray[Any], origin: SiteOrigin) -> list[bytes]:
    """Site polygons (n,) as WKB in EPSG:4979."""
    placed = shapely.transform(polygons_site, origin.geo_from_site, include_z=True)
    wkb: list[bytes] = shapely.to_wkb(placed, output_dimension=3).tolist()
    return wkb


def patches_in_site(patches: list[bytes], origin: SiteOrigin) -> NDArray[Any]:
    """Column ``patch`` (WKB in EPSG:4979, n) as polygons in site metres."""
    in_site: NDArray[Any] = shapely.transform(shapely.from_wkb(patches), origin.site_from_geo, include_z=True)
    return in_site


def find_nearest_member(outlines: Outlines, member: BoolArray, rows: Int64Array, xy_img: Float64Array) -> Int64Array:
    """The member (m,) nearest to each pixel ``xy_img`` (m, 2) of detection ``rows`` (m,); -1 where there is none."""
    kept = np.flatnonzero(member)
    if not len(kept):
        return np.full(len(rows), -1, dtype=np.int64)
    # Distances count in pitches, so that a flat box's rows are as far apart as its columns.
    pitch = outlines.pitch_px
    tree = cKDTree(
        np.column_stack(
            [outlines.xy_img[kept] / pitch[outlines.detection[kept]], TREE_SEPARATION * outlines.detection[kept]]
        )
    )
    _, nearest = tree.query(np.column_stack([xy_img / pitch[rows], TREE_SEPARATION * rows]))
    chosen = kept[nearest]
    return np.where(outlines.detection[chosen] == rows, chosen, -1)


def intersect_planes(origin: Float64Array, direction: Float64Array, hits: Hits, anchor: Int64Array) -> Float64Array:
    """Where rays (m, 3) meet the planes of the hits ``anchor`` (m,); the hit itself where the plane is too flat."""
    normal, at = hits.normal_site[anchor], hits.xyz_site_m[anchor]
    cosine = np.einsum("ij,ij->i", normal, direction)
    height = np.einsum("ij,ij->i", normal, at - origin)
    distance = np.divide(height, cosine, out=np.full(len(height), np.nan), where=np.abs(cosine) > COSINE_MIN)
    ratio = distance / hits.distance_m[anchor]
    sound = (ratio > 1 / _STRETCH_MAX) & (ratio < _STRETCH_MAX)
    placed: Float64Array = np.where(sound[:, None], origin + distance[:, None] * direction, at)
    return placed


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceOutlines:
    """Outlines of the m patches in site, their vertices (c, 3), and which patch a vertex is of (c,), ascending."""

    polygon_site: NDArray[Any]
    vertex_site_m: Float64Array
    patch_of_vertex: Int64Array


def map_outlines(
    outlines: Outlines,
    hits: Hits,
    member: BoolArray,
    some_member: Int64Array,
    cameras: list[PosedCamera],
    camera_of: Int64Array,
) -> SurfaceOutlines:
    """Outlines of the patches that have a member (``some_member`` (n,), else -1), on the surface.

    Every vertex lies in the plane of the member next to it, so a patch that ends at an edge of the building does not
    reach over it.
    """
    owner, rows = outlines.detection, np.flatnonzero(some_member >= 0)
    polygons = outlines.polygon_img.copy()
    whole = np.bincount(owner, weights=member, minlength=len(outlines)) == np.bincount(owner, minlength=len(outlines))
    for row in rows[~whole[rows]]:
        polygons[row] = _clip_to_members(outlines, member, int(row))
    turned = np.where(member, np.einsum("ij,ij->i", hits.normal_site, hits.normal_site[some_member[owner]]), 1.0)
    flattest = np.ones(len(outlines))
    np.minimum.at(flattest, owner, turned)
    bent = rows[flattest[rows] < _FLAT_COSINE]
    polygons[bent] = shapely.segmentize(polygons[bent], outlines.pitch_px[bent].max(axis=1))
    # One kind for all: a mixture with single polygons would be laid out by what else is in the batch.
    parts, part_of = shapely.get_parts(polygons[rows], return_index=True)
    many = shapely.multipolygons(parts, indices=part_of)
    _, xy, offsets = shapely.to_ragged_array(many)
    rings, per_polygon, per_many = (np.asarray(level, dtype=np.int64) for level in offsets)
    of_vertex = np.searchsorted(rings[per_polygon[per_many]], np.arange(len(xy)), side="right") - 1
    detection = rows[of_vertex]
    anchor = find_nearest_member(outlines, member, detection, xy)
    edge = compute_pixel_rays(cameras, camera_of[detection], xy)
    vertex = intersect_planes(edge.origin_site_m, edge.direction_site, hits, anchor)
    placed = shapely.from_ragged_array(shapely.GeometryType.MULTIPOLYGON, vertex, offsets)
    return SurfaceOutlines(polygon_site=_unwrap_single_parts(placed), vertex_site_m=vertex, patch_of_vertex=of_vertex)


def _clip_to_members(outlines: Outlines, member: BoolArray, row: int) -> Any:
    """The part of an outline that lies in the cells of its members: its own surface's, to half a pitch.

    A cell that an outline only cuts a corner off has no pixel of its own; it goes with the pixel next to it.
    """
    first, last = np.searchsorted(outlines.detection, (row, row + 1))
    xy, pitch = outlines.xy_img[first:last], outlines.pitch_px[row]
    # Corners are counted from one place, so that cells side by side share theirs to the last bit.
    place = np.round((xy - xy[0]) / pitch).astype(np.int64)
    low, high = place.min(axis=0) - 1, place.max(axis=0) + 1
    grid = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True))), axis=-1)
    gap, nearest = cKDTree(place).query(grid.reshape(-1, 2))
    cell = grid.reshape(-1, 2)[(gap < _CORNER_PITCHES) & member[first:last][nearest]]
    cells = shapely.coverage_union_all(
        shapely.box(*(xy[0] + (cell - 0.5) * pitch).T, *(xy[0] + (cell + 0.5) * pitch).T)
    )
    cut = shapely.intersection(cells, outlines.polygon_img[row])
    parts = [part for part in shapely.get_parts(cut) if part.geom_type == "Polygon" and part.area > 0]
    return shapely.multipolygons(parts) if parts else cells


def _unwrap_single_parts(polygons: NDArray[Any]) -> NDArray[Any]:
    """Multipolygons of one part as polygons."""
    return np.where(shapely.get_num_geometries(polygons) == 1, shapely.get_geometry(polygons, 0), polygons)


def measure_extents(
    coords: Float64Array, of_vertex: Int64Array, xyz: Float64Array, normal: Float64Array
) -> Float64Array:
    """Horizontal, upward and longest extent (n, 3) of vertices (c, 3), given in the order of their patches."""
    across, upward = compute_tangents(normal)
    starts = np.searchsorted(of_vertex, np.arange(len(xyz)))
    away = coords - xyz[of_vertex]
    out = np.empty((len(xyz), 3))
    for axis, tangent in enumerate((across, upward)):
        along = np.einsum("ij,ij->i", away, tangent[of_vertex])
        out[:, axis] = np.maximum.reduceat(along, starts) - np.minimum.reduceat(along, starts)
    counts = np.diff(np.append(starts, len(coords)))
    for count in np.unique(counts[counts <= _BATCHED_VERTICES_MAX]):
        rows = np.flatnonzero(counts == count)
        points = coords[starts[rows, None] + np.arange(count)]
        out[rows, 2] = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1).max(axis=(1, 2))
    for row in np.flatnonzero(counts > _BATCHED_VERTICES_MAX):
        out[row, 2] = pdist(coords[starts[row] : starts[row] + counts[row]]).max()
    return out
