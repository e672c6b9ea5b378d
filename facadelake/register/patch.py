"""The part of the surface that a detection covers: what of its rays' hits hang together, where it is, how large."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from facadelake.camera import PosedCamera
from facadelake.frames import Array
from facadelake.geobim.surface import Hits
from facadelake.geodesy import SiteOrigin
from facadelake.register.attribution import most_voted
from facadelake.register.outline import Outlines
from facadelake.register.rays import PixelRays, rays_of

_UP = np.array([0.0, 0.0, 1.0])
_FLAT_COSINE = np.cos(np.radians(0.2))  # a patch whose normals turn by less is flat: its corners are enough
_SAME_SIDE_COSINE = np.cos(np.radians(45.0))
_LEAST_COSINE = 0.02  # a plane seen flatter than this is not prolonged
_MOST_STRETCH = 2.0  # nor to more than this multiple of the distance at which it was met
_REACH = 4.1  # pitches over which a surface is found again behind what parts it in a picture
_CORNER = 1.5  # pitches: the cells around one
_FEW = 8  # vertices: up to so many, as of boxes, patches are measured together
_APART = 1e7  # px; keeps detections apart in one search tree


@dataclass(frozen=True, kw_only=True, eq=False)
class Patches:
    """Patches of n detections; NaN, None or -1 where no ray met the building.

    ``member`` (k,): which of the outlines' pixels belong to the patch. ``anchor`` (n,): the pixel in whose plane the
    position lies. ``ray``: the n rays of the positions ``xyz_site_m`` (n, 3), at ``distance_m`` (n,) from the
    camera, where the surface has ``normal_site`` (n, 3). ``polygon_site`` (n,): 3D outlines in site. ``width_m`` (n,)
    along the horizontal tangent, ``height_m`` across it, ``length_m`` the longest extent, ``area_m2``.
    ``target_share`` (n,): rays that met the building. ``member_share`` (n,): rays in the patch.
    """

    member: NDArray[np.bool_]
    anchor: NDArray[np.int64]
    xyz_site_m: Array
    normal_site: Array
    ray: PixelRays
    distance_m: Array
    polygon_site: NDArray[Any]
    width_m: Array
    height_m: Array
    length_m: Array
    area_m2: Array
    target_share: Array
    member_share: Array

    @property
    def incidence_deg(self) -> Array:
        """Angle (n,) between the positions' rays and the surface's normals."""
        cosine = np.clip(-np.einsum("ij,ij->i", self.ray.direction_site, self.normal_site), 0.0, 1.0)
        angle: Array = np.degrees(np.arccos(cosine))
        return angle


def tangents_of(normals_site: Array) -> tuple[Array, Array]:
    """Unit horizontal and upward tangents (n, 3) of surfaces with ``normals_site`` (n, 3).

    On a level surface, which has no horizontal tangent of its own, they are east and north.
    """
    across = np.cross(_UP, normals_site)
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    level = length < 0.05
    across = np.where(level, np.array([1.0, 0.0, 0.0]), across / np.where(level, 1.0, length))
    upward = np.cross(normals_site, across)
    return across, upward / np.linalg.norm(upward, axis=-1, keepdims=True)


def members_of(outlines: Outlines, hits: Hits, step_m: float) -> NDArray[np.bool_]:
    """Which pixels (k,) belong to their detection's patch: those that hang together on the surface with most votes.

    Neighbours hang together where one lies in the other's tangent plane to ``step_m``: round an edge one plane still
    holds, over a jump neither does. Where neighbours part, those a little further off are asked too, so that a wall
    seen through a railing, or round a deep window, stays one patch.
    """
    holds = _hold_together(hits, outlines.beside, step_m)
    parted = np.zeros(len(outlines), dtype=bool)
    parted[outlines.detection[outlines.beside[~holds, 0]]] = True
    member: NDArray[np.bool_] = ~parted[outlines.detection] & hits.hit  # without neighbours: one pixel alone
    own = np.flatnonzero(parted[outlines.detection])
    if not len(own):
        return member
    detection, vote = outlines.detection[own], np.where(hits.hit[own], outlines.vote[own], 0.0)
    tree = cKDTree(np.column_stack([outlines.xy_img[own] / outlines.pitch_px[detection], _APART * detection]))
    near = tree.query_pairs(_REACH, output_type="ndarray")
    beside = outlines.beside[holds & parted[outlines.detection[outlines.beside[:, 0]]]]
    pairs = np.vstack([near[_hold_together(hits, own[near], step_m)], np.searchsorted(own, beside)])
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(own), len(own)))
    parts, part = connected_components(graph, directed=False)
    votes = np.bincount(part, weights=vote, minlength=parts)
    first = np.full(parts, len(own))
    np.minimum.at(first, part, np.arange(len(own)))
    # The best part of each detection; of parts with equal votes the one whose first pixel comes first.
    order = np.lexsort((first, -np.round(votes, 12), detection[first]))
    best = order[np.unique(detection[first][order], return_index=True)[1]]
    member[own] = np.isin(part, best) & hits.hit[own]
    return member


def _hold_together(hits: Hits, pairs: NDArray[np.int64], step_m: float) -> NDArray[np.bool_]:
    """Which pairs (e, 2) of hits lie on one surface, one in the other's tangent plane."""
    a, b = pairs.T
    step = hits.xyz_site_m[b] - hits.xyz_site_m[a]
    off = np.minimum(
        np.abs(np.einsum("ij,ij->i", step, hits.normal_site[a])),
        np.abs(np.einsum("ij,ij->i", step, hits.normal_site[b])),
    )
    return np.asarray(off < step_m)  # NaN, a miss, is never below


def patches_of(
    outlines: Outlines,
    hits: Hits,
    rays: PixelRays,
    cameras: list[PosedCamera],
    camera_of: NDArray[np.int64],
    step_m: float,
) -> Patches:
    """Patches of ``outlines`` (n), whose pixels' ``rays`` met the surface at ``hits``.

    ``camera_of`` (n,): the outlines' cameras in ``cameras``. ``step_m`` as in ``members_of``.
    """
    count, owner = len(outlines), outlines.detection
    member = members_of(outlines, hits, step_m)
    sampled = np.bincount(owner, minlength=count)
    cosine = np.maximum(-np.einsum("ij,ij->i", rays.direction_site, hits.normal_site), _LEAST_COSINE)
    pixel_m2 = np.where(member, hits.distance_m**2 * rays.solid_angle / cosine, 0.0)
    area = np.bincount(owner, weights=pixel_m2, minlength=count) * outlines.area_px2 / sampled
    members = np.bincount(owner, weights=member, minlength=count)
    target_share = np.bincount(owner, weights=hits.hit, minlength=count) / sampled

    kept = np.flatnonzero(member)
    owners, first = np.unique(owner[kept], return_index=True)
    some_member = np.full(count, -1, dtype=np.int64)
    some_member[owners] = kept[first]
    found = some_member >= 0
    polygons = np.full(count, None, dtype=object)
    middle = outlines.centre_img.copy()
    if found.any():
        mapped = _mapped(outlines, hits, member, some_member, cameras, camera_of)
        polygons[found] = mapped.polygon_site
        for row in np.flatnonzero(found & outlines.masked):
            middle[row] = _middle_of_mask(outlines, hits, pixel_m2, int(row), polygons[row], cameras[camera_of[row]])
    anchor = _nearest_member(outlines, _main_side(outlines, hits, member), np.arange(count), middle)
    ray = rays_of(cameras, camera_of, middle)
    xyz, normal = np.full((count, 3), np.nan), np.full((count, 3), np.nan)
    xyz[found] = _on_planes(ray.origin_site_m[found], ray.direction_site[found], hits, anchor[found])
    normal[found] = hits.normal_site[anchor[found]]
    sizes = np.full((count, 3), np.nan)
    if found.any():
        sizes[found] = _extents(mapped.vertex_site_m, mapped.of_vertex, xyz[found], normal[found])
    return Patches(
        member=member,
        anchor=anchor,
        xyz_site_m=xyz,
        normal_site=normal,
        ray=ray,
        distance_m=np.linalg.norm(xyz - ray.origin_site_m, axis=1),
        polygon_site=polygons,
        width_m=sizes[:, 0],
        height_m=sizes[:, 1],
        length_m=sizes[:, 2],
        area_m2=np.where(found, area, np.nan),
        target_share=target_share,
        member_share=members / sampled,
    )


def patches_on_the_globe(polygons_site: NDArray[Any], origin: SiteOrigin) -> list[bytes]:
    """Site polygons (n,) as WKB in EPSG:4979."""
    placed = shapely.transform(polygons_site, origin.geo_from_site, include_z=True)
    wkb: list[bytes] = shapely.to_wkb(placed, output_dimension=3).tolist()
    return wkb


def patches_in_site(patches: list[bytes], origin: SiteOrigin) -> NDArray[Any]:
    """Column ``patch`` (WKB in EPSG:4979, n) as polygons in site metres."""
    in_site: NDArray[Any] = shapely.transform(shapely.from_wkb(patches), origin.site_from_geo, include_z=True)
    return in_site


def _main_side(outlines: Outlines, hits: Hits, member: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Members (k,) on the side of the patch that the defect is on: of the element with most votes, facing as it mainly
    does. A wall's crack that ends over a deep window's glass lies in the wall's face, not on glass or reveal."""
    kept = np.flatnonzero(member)
    owner, count = outlines.detection[kept], len(outlines)
    of_main = hits.element[kept] == most_voted(owner, hits.element[kept], outlines.vote[kept], count)[owner]
    kept, owner = kept[of_main], owner[of_main]
    normal = hits.normal_site[kept]
    facing = np.zeros((count, 3))
    np.add.at(facing, owner, normal * outlines.vote[kept, None])
    facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-12)
    ahead = np.einsum("ij,ij->i", normal, facing[owner]) > _SAME_SIDE_COSINE
    without = ~np.isin(owner, owner[ahead])  # an element that faces all ways: any of its sides
    main = np.zeros_like(member)
    main[kept[ahead | without]] = True
    return main


def _middle_of_mask(
    outlines: Outlines, hits: Hits, pixel_m2: Array, row: int, polygon_site: Any, camera: PosedCamera
) -> Array:
    """The pixel (2,) of a mask's middle: the centroid of its area on the surface.

    Other than the centroid of its pixels, it is one place for all photographs. Round a corner, where the outline is not
    flat, it is that of the pixels' areas.
    """
    first, last = np.searchsorted(outlines.detection, (row, row + 1))
    own = slice(first, last)
    weight, normals = pixel_m2[own], hits.normal_site[own]
    heaviest = normals[np.argmax(weight)]
    middle = np.average(hits.xyz_site_m[own][weight > 0], axis=0, weights=weight[weight > 0])
    if np.all(normals[weight > 0] @ heaviest > _FLAT_COSINE):
        axes = np.vstack([*(tangent[0] for tangent in tangents_of(heaviest[None])), heaviest])
        flat = shapely.transform(polygon_site, lambda xyz: (xyz - middle) @ axes.T, include_z=True)
        middle = middle + shapely.get_coordinates(shapely.centroid(flat))[0] @ axes[:2]
    pixel: Array = camera.project_site(middle[None])[0]
    return pixel


def _nearest_member(
    outlines: Outlines, member: NDArray[np.bool_], rows: NDArray[np.int64], xy_img: Array
) -> NDArray[np.int64]:
    """The member (m,) nearest to each pixel ``xy_img`` (m, 2) of detection ``rows`` (m,); -1 where there is none."""
    kept = np.flatnonzero(member)
    if not len(kept):
        return np.full(len(rows), -1, dtype=np.int64)
    # Distances count in pitches, so that a flat box's rows are as far apart as its columns.
    pitch = outlines.pitch_px
    tree = cKDTree(
        np.column_stack([outlines.xy_img[kept] / pitch[outlines.detection[kept]], _APART * outlines.detection[kept]])
    )
    _, nearest = tree.query(np.column_stack([xy_img / pitch[rows], _APART * rows]))
    chosen = kept[nearest]
    return np.where(outlines.detection[chosen] == rows, chosen, -1)


def _on_planes(origin: Array, direction: Array, hits: Hits, anchor: NDArray[np.int64]) -> Array:
    """Where rays (m, 3) meet the planes of the hits ``anchor`` (m,); the hit itself where the plane is too flat."""
    normal, at = hits.normal_site[anchor], hits.xyz_site_m[anchor]
    cosine = np.einsum("ij,ij->i", normal, direction)
    height = np.einsum("ij,ij->i", normal, at - origin)
    distance = np.divide(height, cosine, out=np.full(len(height), np.nan), where=np.abs(cosine) > _LEAST_COSINE)
    ratio = distance / hits.distance_m[anchor]
    sound = (ratio > 1 / _MOST_STRETCH) & (ratio < _MOST_STRETCH)
    placed: Array = np.where(sound[:, None], origin + distance[:, None] * direction, at)
    return placed


@dataclass(frozen=True, kw_only=True, eq=False)
class _Mapped:
    """Outlines of the m patches in site, their vertices (c, 3), and which patch a vertex is of (c,), ascending."""

    polygon_site: NDArray[Any]
    vertex_site_m: Array
    of_vertex: NDArray[np.int64]


def _mapped(
    outlines: Outlines,
    hits: Hits,
    member: NDArray[np.bool_],
    some_member: NDArray[np.int64],
    cameras: list[PosedCamera],
    camera_of: NDArray[np.int64],
) -> _Mapped:
    """Outlines of the patches that have a member (``some_member`` (n,), else -1), on the surface.

    Every vertex lies in the plane of the member next to it, so a patch that ends at an edge of the building does not
    reach over it.
    """
    owner, rows = outlines.detection, np.flatnonzero(some_member >= 0)
    polygons = outlines.polygon_img.copy()
    whole = np.bincount(owner, weights=member, minlength=len(outlines)) == np.bincount(owner, minlength=len(outlines))
    for row in rows[~whole[rows]]:
        polygons[row] = _cut(outlines, member, int(row))
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
    anchor = _nearest_member(outlines, member, detection, xy)
    edge = rays_of(cameras, camera_of[detection], xy)
    vertex = _on_planes(edge.origin_site_m, edge.direction_site, hits, anchor)
    placed = shapely.from_ragged_array(shapely.GeometryType.MULTIPOLYGON, vertex, offsets)
    return _Mapped(polygon_site=_single(placed), vertex_site_m=vertex, of_vertex=of_vertex)


def _cut(outlines: Outlines, member: NDArray[np.bool_], row: int) -> Any:
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
    cell = grid.reshape(-1, 2)[(gap < _CORNER) & member[first:last][nearest]]
    cells = shapely.coverage_union_all(
        shapely.box(*(xy[0] + (cell - 0.5) * pitch).T, *(xy[0] + (cell + 0.5) * pitch).T)
    )
    cut = shapely.intersection(cells, outlines.polygon_img[row])
    parts = [part for part in shapely.get_parts(cut) if part.geom_type == "Polygon" and part.area > 0]
    return shapely.multipolygons(parts) if parts else cells


def _single(polygons: NDArray[Any]) -> NDArray[Any]:
    """Multipolygons of one part as polygons."""
    return np.where(shapely.get_num_geometries(polygons) == 1, shapely.get_geometry(polygons, 0), polygons)


def _extents(coords: Array, of_vertex: NDArray[np.int64], xyz: Array, normal: Array) -> Array:
    """Horizontal, upward and longest extent (n, 3) of vertices (c, 3), given in the order of their patches."""
    across, upward = tangents_of(normal)
    starts = np.searchsorted(of_vertex, np.arange(len(xyz)))
    away = coords - xyz[of_vertex]
    out = np.empty((len(xyz), 3))
    for axis, tangent in enumerate((across, upward)):
        along = np.einsum("ij,ij->i", away, tangent[of_vertex])
        out[:, axis] = np.maximum.reduceat(along, starts) - np.minimum.reduceat(along, starts)
    counts = np.diff(np.append(starts, len(coords)))
    for count in np.unique(counts[counts <= _FEW]):
        rows = np.flatnonzero(counts == count)
        points = coords[starts[rows, None] + np.arange(count)]
        out[rows, 2] = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1).max(axis=(1, 2))
    for row in np.flatnonzero(counts > _FEW):
        out[row, 2] = pdist(coords[starts[row] : starts[row] + counts[row]]).max()
    return out
