"""Segment a mesh into facade planes, which stand for elements where there is no IFC.

A plane consists of all walls with one outward direction whose offsets along it differ by less than a metre, wherever
they are along the facade. Reveals, sills and cornices therefore belong to their wall, and a setback is a plane of its
own. The result depends neither on the mesh's connectivity nor on the size of its triangles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import shapely
from scipy.signal import find_peaks, peak_prominences
from scipy.spatial import cKDTree

from facadelake.building.facades.openness import INSIDE, LEVEL, compass_from_direction, compute_openness
from facadelake.building.storeys import StoreyLevel, find_storey
from facadelake.building.surface.footprint import compute_outline, lon_lat_from_site
from facadelake.building.surface.raycasting import Surface
from facadelake.core.arrays import BoolArray, Float64N, Float64Nx3, Float64x3, Int64Array, RowIndices
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import table_from_rows

_SURFACE_CLASS = "Surface"  # replaces the IFC class: a facade plane is not a component
_NEIGHBOURS = 16
_NEIGHBOURHOOD_M = 1.0  # larger than a wall's roughness (stones, noise of tie points)
_SMOOTHING_ROUNDS = 2
_SAME_SIDE_COSINE = 0.5  # minimum cosine between normals that face the same side
_DIRECTION_DEG = 25.0  # walls whose directions differ by more are two facades
_MIN_DIRECTION_SHARE = 0.02  # minimum share of the wall area for a facade of its own
_WALL_VARIANCE_RATIO = 0.01  # depth over width variance: a wall is at least ten times as wide as deep
_PLANE_DEPTH_M = 1.0  # reveals and cornices are nearer to their wall than this, setbacks are not
_GRID_M = 0.1
_MIN_PLANE_SHARE = 0.01  # minimum share of the wall area, within the bounds below; less is reveals, furniture or noise
_MIN_PLANE_BOUNDS_M2 = (4.0, 10.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class FacadePlanes:
    """The p planes of a mesh of m triangles.

    ``names`` (p) such as "facade-S-1" (the largest plane that faces south), "level-1" (roofs, ground) or "inside-1".
    ``facades`` (p): compass name, "level" or "inside". ``azimuth_deg`` (p,): NaN for level and inside.
    ``plane_of_triangle`` (m,): number of the plane of each triangle.
    """

    names: tuple[str, ...]
    facades: tuple[str, ...]
    azimuth_deg: Float64N
    plane_of_triangle: Int64Array


def segment_facade_planes(surface: Surface) -> FacadePlanes:
    """Segment ``surface`` into facade planes; a triangle faces its side open to the sky, whatever its winding."""
    centres = surface.vertices_site_m[surface.triangles].mean(axis=1)
    outward, is_open = _orient_normals(surface, centres)
    smooth = _smooth_normals(centres, outward, surface.areas_m2, is_open)
    horizontal = np.hypot(smooth[:, 0], smooth[:, 1])
    level = np.abs(smooth[:, 2]) > horizontal  # also undersides, although they see no sky
    wall = is_open & ~level
    planes: list[tuple[str, float, RowIndices]] = []  # facade, azimuth, triangles
    rows = np.flatnonzero(wall)
    directions = _cluster_normals(smooth[rows], surface.areas_m2[rows])
    min_area_m2 = float(np.clip(_MIN_PLANE_SHARE * surface.areas_m2[rows].sum(), *_MIN_PLANE_BOUNDS_M2))
    nearest = np.argmax(smooth[rows] @ directions.T, axis=1) if len(directions) else np.zeros(0, dtype=np.int64)
    for number, direction in enumerate(directions):
        own = rows[nearest == number]
        if len(own) == 0:
            continue
        plane = _label_planes(centres[own] @ direction, surface.areas_m2[own], min_area_m2)
        largest = own[plane == np.argmax(np.bincount(plane, weights=surface.areas_m2[own]))]
        normal = _fit_wall_normal(direction, centres[largest], surface.areas_m2[largest])
        azimuth = float(np.degrees(np.arctan2(normal[0], normal[1])) % 360.0)
        planes += [(compass_from_direction(normal), azimuth, own[plane == k]) for k in np.unique(plane)]
    if level.any():
        planes.append((LEVEL, np.nan, np.flatnonzero(level)))
    inside = ~is_open & ~level
    if inside.any():
        planes.append((INSIDE, np.nan, np.flatnonzero(inside)))
    # Largest first: small planes that noise adds or removes do not change the names of the others.
    planes.sort(key=lambda plane: (plane[0], -float(surface.areas_m2[plane[2]].sum())))
    plane_of_triangle = np.full(len(surface.triangles), -1, dtype=np.int64)
    names: list[str] = []
    for number, (facade, _, triangles) in enumerate(planes):
        plane_of_triangle[triangles] = number
        count = sum(plane[0] == facade for plane in planes[: number + 1])
        names.append(f"{facade}-{count}" if facade in (LEVEL, INSIDE) else f"facade-{facade}-{count}")
    return FacadePlanes(
        names=tuple(names),
        facades=tuple(plane[0] for plane in planes),
        azimuth_deg=np.array([plane[1] for plane in planes]),
        plane_of_triangle=plane_of_triangle,
    )


def build_plane_elements(
    planes: FacadePlanes, surface: Surface, origin: SiteOrigin, storeys: Sequence[StoreyLevel]
) -> pa.Table:
    """Build table ``elements`` with one row per plane.

    Args:
        planes: the planes of ``surface``.
        surface: the mesh in site.
        origin: origin of the site frame.
        storeys: levels of the storeys, sorted; a plane over several storeys gets the lowest.

    Returns:
        A table of kind ``elements``.
    """
    rows: list[dict[str, Any]] = []
    for number, (name, facade) in enumerate(zip(planes.names, planes.facades, strict=True)):
        own = planes.plane_of_triangle == number
        corners = surface.vertices_site_m[surface.triangles[own]]
        low = float(corners[:, :, 2].min())
        storey = find_storey(storeys, low) if facade not in (LEVEL, INSIDE) else ""
        azimuth = float(planes.azimuth_deg[number])
        rows.append(
            {
                "element_guid": name,
                "ifc_class": _SURFACE_CLASS,
                "element_name": name.replace("-", " "),
                "storey": storey or None,
                "storey_source": "elevation" if storey else None,
                "is_external": facade != INSIDE,
                "facade": facade,
                "facade_azimuth_deg": azimuth if np.isfinite(azimuth) else None,
                "surface_area_m2": float(surface.areas_m2[own].sum()),
                "triangles": int(own.sum()),
                "geometry": shapely.to_wkb(lon_lat_from_site(compute_outline(corners), low, origin)),
            }
        )
    return table_from_rows("elements", rows)


def _orient_normals(surface: Surface, centres: Float64Nx3) -> tuple[Float64Nx3, BoolArray]:
    """Normals (m, 3) oriented to the open side, and a mask (m,) of the triangles that have one.

    The winding is kept where its side is open, because the back of an open sheet, such as an as-built surface, is open
    too. A closed triangle next to an open one with the same orientation is the bottom of a dent.
    """
    normals = surface.normals_site
    is_open = compute_openness(surface, centres, normals) > 0
    closed = np.flatnonzero(~is_open)
    if len(closed) == 0:
        return normals, is_open
    back = compute_openness(surface, centres[closed], -normals[closed]) > 0
    if is_open.any():
        opened = np.flatnonzero(is_open)
        distance, nearest = cKDTree(centres[opened]).query(centres[closed], distance_upper_bound=_NEIGHBOURHOOD_M)
        neighbour = opened[np.where(np.isfinite(distance), nearest, 0)]
        same_side = np.einsum("ij,ij->i", normals[closed], normals[neighbour]) > _SAME_SIDE_COSINE
        dent = np.isfinite(distance) & same_side
    else:
        dent = np.zeros(len(closed), dtype=bool)
    outward = normals.copy()
    outward[closed[back & ~dent]] *= -1.0
    is_open[closed[back | dent]] = True
    return outward, is_open


def _smooth_normals(centres: Float64Nx3, normals: Float64Nx3, areas: Float64N, used: BoolArray) -> Float64Nx3:
    """Average normals (m, 3) with their neighbours', half weight each: removes noise, keeps corners of smooth walls."""
    rows = np.flatnonzero(used)
    smooth = normals.copy()
    count = min(_NEIGHBOURS, len(rows))
    if count < 2:
        return smooth
    distance, near = cKDTree(centres[rows]).query(centres[rows], k=count, distance_upper_bound=_NEIGHBOURHOOD_M)
    found = np.isfinite(distance)
    near = np.where(found, near, 0)
    weight = np.where(found, areas[rows][near], 0.0)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    own = normals[rows]
    for _ in range(_SMOOTHING_ROUNDS):
        total = own + np.einsum("ij,ijk->ik", weight, own[near])
        own = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
    smooth[rows] = own
    return smooth


def _cluster_normals(normals: Float64Nx3, areas: Float64N) -> Float64Nx3:
    """Main horizontal directions (d, 3) of walls, largest area first, at least 25 degrees apart."""
    azimuth = np.degrees(np.arctan2(normals[:, 0], normals[:, 1])) % 360.0
    weight = np.bincount(np.floor(azimuth).astype(np.int64) % 360, weights=areas, minlength=360)
    turn = np.abs((np.arange(360)[:, None] - np.arange(360)[None] + 180) % 360 - 180)
    core = turn <= _DIRECTION_DEG / 2
    found: list[Float64x3] = []
    total = weight.sum()
    while weight.sum() > _MIN_DIRECTION_SHARE * total:
        best = int(np.argmax(core @ weight))
        bin_centres = np.radians(np.arange(360) + 0.5)
        share = weight * core[best]
        mean = np.array([share @ np.sin(bin_centres), share @ np.cos(bin_centres), 0.0])
        if share.sum() > _MIN_DIRECTION_SHARE * total:
            found.append(mean / np.linalg.norm(mean))
        weight = np.where(turn[best] <= _DIRECTION_DEG, 0.0, weight)
    return np.array(found).reshape(-1, 3)


def _fit_wall_normal(direction: Float64x3, points: Float64Nx3, areas: Float64N) -> Float64x3:
    """Fit the horizontal normal (3,) of the wall through ``points`` (n, 3); rough normals give it to degrees only.

    ``direction`` (3,) is returned where the points do not form a wall: too few of them, or as deep as wide.
    """
    plan = points[:, :2] - np.average(points[:, :2], axis=0, weights=areas)
    values, vectors = np.linalg.eigh((plan * areas[:, None]).T @ plan)
    normal = np.append(vectors[:, 0], 0.0)
    normal = normal if normal @ direction > 0 else -normal
    if values[0] > _WALL_VARIANCE_RATIO * values[1] or normal @ direction < np.cos(np.radians(_DIRECTION_DEG)):
        return direction
    return normal


def _label_planes(offset_m: Float64N, areas: Float64N, min_area_m2: float) -> Int64Array:
    """Number (n,) of the plane nearest to each triangle of one direction, by its offset along that direction.

    A plane is a peak of the area within half a metre of an offset. The peak has at least ``min_area_m2`` and a
    prominence of half its height, or is the largest; a curved wall therefore has one.
    """
    order = np.argsort(offset_m, kind="stable")
    offset, cumulative = offset_m[order], np.concatenate([[0.0], np.cumsum(areas[order])])
    grid = np.arange(offset[0] - _PLANE_DEPTH_M, offset[-1] + _PLANE_DEPTH_M + _GRID_M, _GRID_M)
    low = np.searchsorted(offset, grid - _PLANE_DEPTH_M / 2)
    high = np.searchsorted(offset, grid + _PLANE_DEPTH_M / 2, side="right")
    area = cumulative[high] - cumulative[low]
    peaks, _ = find_peaks(area)
    prominence = peak_prominences(area, peaks)[0]
    kept = ((area[peaks] >= min_area_m2) & (prominence >= 0.5 * area[peaks])) | (area[peaks] == area.max())
    plane_offsets = grid[peaks[kept]]
    return np.searchsorted((plane_offsets[1:] + plane_offsets[:-1]) / 2, offset_m).astype(np.int64)
