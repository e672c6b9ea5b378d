"""Patches: outlines of detections on the surface, vertex by vertex on the plane of the nearest sample, and extents."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from facadelake.building.surface import Hits
from facadelake.core.arrays import BoolArray, Float64Array, Float64Nx2, Float64Nx3, RowIndices
from facadelake.core.camera import PosedCamera
from facadelake.core.geodesy import SiteOrigin
from facadelake.registration.outline import TREE_SEPARATION, Outlines
from facadelake.registration.rays import compute_pixel_rays

_UP = np.array([0.0, 0.0, 1.0])
_FLAT_COSINE = np.cos(np.radians(0.2))  # a patch whose normals vary by less is flat: its corners suffice
COSINE_MIN = 0.02  # a plane at a larger incidence is not extrapolated
_STRETCH_MAX = 2.0  # limit of extrapolation, as a ratio of distances from the camera (and its inverse)
_CORNER_PITCHES = 1.5  # reaches the cells around a sample
_BATCHED_VERTICES_MAX = 8  # patches of up to this many vertices, such as boxes, are measured together


def compute_tangents(normals_site: Float64Nx3) -> tuple[Float64Nx3, Float64Nx3]:
    """Unit horizontal and upward tangents (n, 3) of surfaces with unit normals ``normals_site`` (n, 3).

    On a horizontal surface, whose horizontal tangent is undefined, they are east and north.
    """
    across = np.cross(_UP, normals_site)
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    horizontal = length < 0.05
    across = np.where(horizontal, np.array([1.0, 0.0, 0.0]), across / np.where(horizontal, 1.0, length))
    upward = np.cross(normals_site, across)
    return across, upward / np.linalg.norm(upward, axis=-1, keepdims=True)


def convert_patches_to_wkb(polygons_site: NDArray[Any], origin: SiteOrigin) -> list[bytes]:
    """Polygons (n,) in site as WKB in EPSG:4979."""
    polygons_geo = shapely.transform(polygons_site, origin.geo_from_site, include_z=True)
    wkb: list[bytes] = shapely.to_wkb(polygons_geo, output_dimension=3).tolist()
    return wkb


def find_nearest_member(outlines: Outlines, member: BoolArray, rows: RowIndices, xy_img: Float64Nx2) -> RowIndices:
    """The member sample nearest to each pixel, within the pixel's detection.

    Args:
        outlines: the outlines (n) with their samples (k).
        member: which samples (k,) belong to their detection's patch.
        rows: detection (m,) of each pixel.
        xy_img: pixels (m, 2).

    Returns:
        Samples (m,); -1 where the detection has no member.
    """
    kept = np.flatnonzero(member)
    if not len(kept):
        return np.full(len(rows), -1, dtype=np.int64)
    # Distances are measured in pitches, so that rows and columns of an elongated box are equally far apart.
    pitch = outlines.pitch_px
    tree = cKDTree(
        np.column_stack(
            [
                outlines.xy_img[kept] / pitch[outlines.detection[kept]],
                TREE_SEPARATION * outlines.detection[kept],
            ]
        )
    )
    _, nearest = tree.query(np.column_stack([xy_img / pitch[rows], TREE_SEPARATION * rows]))
    found = kept[nearest]
    return np.where(outlines.detection[found] == rows, found, -1)


def intersect_planes(origin: Float64Nx3, direction: Float64Nx3, hits: Hits, anchor: RowIndices) -> Float64Nx3:
    """Intersections of rays with the tangent planes of hits.

    Args:
        origin: origins (m, 3) in site.
        direction: unit directions (m, 3) in site.
        hits: hits of the samples (k).
        anchor: sample (m,) whose hit gives the plane of each ray.

    Returns:
        Points (m, 3) in site; the hit itself where the plane would be extrapolated too far.
    """
    normal, point = hits.normal_site[anchor], hits.xyz_site_m[anchor]
    cosine = np.einsum("ij,ij->i", normal, direction)
    height = np.einsum("ij,ij->i", normal, point - origin)
    distance = np.divide(height, cosine, out=np.full(len(height), np.nan), where=np.abs(cosine) > COSINE_MIN)
    ratio = distance / hits.distance_m[anchor]
    valid = (ratio > 1 / _STRETCH_MAX) & (ratio < _STRETCH_MAX)
    intersection: Float64Array = np.where(valid[:, None], origin + distance[:, None] * direction, point)
    return intersection


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceOutlines:
    """Outlines (m,) of patches in site, their vertices (c, 3), and the patch (c,) of each vertex, ascending."""

    polygon_site: NDArray[Any]
    vertex_site_m: Float64Nx3
    patch_of_vertex: RowIndices


def map_outlines(
    outlines: Outlines,
    hits: Hits,
    member: BoolArray,
    first_member: RowIndices,
    cameras: list[PosedCamera],
    camera_index: RowIndices,
) -> SurfaceOutlines:
    """Map the outlines of detections onto the surface.

    Each vertex lies in the plane of the member next to it, so a patch that ends at an edge of the building does not
    extend beyond it.

    Args:
        outlines: the outlines (n) with their samples (k).
        hits: hits of the samples (k).
        member: which samples (k,) belong to their detection's patch.
        first_member: a member (n,) of each patch; -1 where it has none, and then it has no outline.
        cameras: cameras of the photographs.
        camera_index: the camera (n,) of each detection, in ``cameras``.

    Returns:
        Outlines of the m patches that have a member, in the order of the detections.
    """
    owner, rows = outlines.detection, np.flatnonzero(first_member >= 0)
    polygons = outlines.polygon_img.copy()
    complete = np.bincount(owner, weights=member, minlength=len(outlines)) == np.bincount(
        owner, minlength=len(outlines)
    )
    for row in rows[~complete[rows]]:
        polygons[row] = _clip_to_members(outlines, member, int(row))
    alignment = np.where(member, np.einsum("ij,ij->i", hits.normal_site, hits.normal_site[first_member[owner]]), 1.0)
    alignment_min = np.ones(len(outlines))
    np.minimum.at(alignment_min, owner, alignment)
    curved = rows[alignment_min[rows] < _FLAT_COSINE]
    polygons[curved] = shapely.segmentize(polygons[curved], outlines.pitch_px[curved].max(axis=1))
    # All are multipolygons: the layout of a ragged array must not depend on the other patches of the batch.
    parts, part_of = shapely.get_parts(polygons[rows], return_index=True)
    multipolygons = shapely.multipolygons(parts, indices=part_of)
    _, xy, offsets = shapely.to_ragged_array(multipolygons)
    rings, per_polygon, per_multipolygon = (np.asarray(level, dtype=np.int64) for level in offsets)
    patch_of_vertex = np.searchsorted(rings[per_polygon[per_multipolygon]], np.arange(len(xy)), side="right") - 1
    detection = rows[patch_of_vertex]
    anchor = find_nearest_member(outlines, member, detection, xy)
    rays = compute_pixel_rays(cameras, camera_index[detection], xy)
    vertex = intersect_planes(rays.origin_site_m, rays.direction_site, hits, anchor)
    polygon_site = shapely.from_ragged_array(shapely.GeometryType.MULTIPOLYGON, vertex, offsets)
    return SurfaceOutlines(
        polygon_site=_unwrap_single_parts(polygon_site), vertex_site_m=vertex, patch_of_vertex=patch_of_vertex
    )


def _clip_to_members(outlines: Outlines, member: BoolArray, row: int) -> Any:
    """The part of an outline inside the cells of its member samples, to half a pitch.

    A cell at the outline's border that contains no sample belongs with the sample next to it.
    """
    first, last = np.searchsorted(outlines.detection, (row, row + 1))
    xy, pitch = outlines.xy_img[first:last], outlines.pitch_px[row]
    # Cell corners are multiples of the pitch from one sample, so that adjacent cells share them to the last bit.
    lattice = np.round((xy - xy[0]) / pitch).astype(np.int64)
    low, high = lattice.min(axis=0) - 1, lattice.max(axis=0) + 1
    grid = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True))), axis=-1)
    gap, nearest = cKDTree(lattice).query(grid.reshape(-1, 2))
    cell = grid.reshape(-1, 2)[(gap < _CORNER_PITCHES) & member[first:last][nearest]]
    cells = shapely.coverage_union_all(
        shapely.box(*(xy[0] + (cell - 0.5) * pitch).T, *(xy[0] + (cell + 0.5) * pitch).T)
    )
    clipped = shapely.intersection(cells, outlines.polygon_img[row])
    parts = [part for part in shapely.get_parts(clipped) if part.geom_type == "Polygon" and part.area > 0]
    return shapely.multipolygons(parts) if parts else cells


def _unwrap_single_parts(polygons: NDArray[Any]) -> NDArray[Any]:
    """Multipolygons (n,); those of one part as polygons."""
    return np.where(shapely.get_num_geometries(polygons) == 1, shapely.get_geometry(polygons, 0), polygons)


def measure_extents(
    vertex_site_m: Float64Nx3, patch_of_vertex: RowIndices, xyz_site_m: Float64Nx3, normal_site: Float64Nx3
) -> Float64Nx3:
    """Extents of patches on the surface.

    Args:
        vertex_site_m: vertices (c, 3) in site, in the order of their patches.
        patch_of_vertex: patch (c,) of each vertex, ascending.
        xyz_site_m: positions (n, 3) of the patches in site.
        normal_site: unit normals (n, 3) at the positions.

    Returns:
        Horizontal extent, upward extent and the largest distance of two vertices (n, 3), in m.
    """
    across, upward = compute_tangents(normal_site)
    starts = np.searchsorted(patch_of_vertex, np.arange(len(xyz_site_m)))
    offset = vertex_site_m - xyz_site_m[patch_of_vertex]
    out = np.empty((len(xyz_site_m), 3))
    for axis, tangent in enumerate((across, upward)):
        along = np.einsum("ij,ij->i", offset, tangent[patch_of_vertex])
        out[:, axis] = np.maximum.reduceat(along, starts) - np.minimum.reduceat(along, starts)
    counts = np.diff(np.append(starts, len(vertex_site_m)))
    for count in np.unique(counts[counts <= _BATCHED_VERTICES_MAX]):
        rows = np.flatnonzero(counts == count)
        points = vertex_site_m[starts[rows, None] + np.arange(count)]
        out[rows, 2] = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1).max(axis=(1, 2))
    for row in np.flatnonzero(counts > _BATCHED_VERTICES_MAX):
        out[row, 2] = pdist(vertex_site_m[starts[row] : starts[row] + counts[row]]).max()
    return out
