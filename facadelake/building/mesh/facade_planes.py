"""A bare mesh cut into facade planes: what stands for elements where no IFC says what the parts are.

A plane is what looks one way at one distance: all walls of one outward direction that lie within a metre of one
another, wherever they stand along the facade. Reveals, sills and cornices so count with their wall, a setback is a
plane of its own, and neither the mesh's connectivity nor the fineness of its triangles matters.
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
from facadelake.core.arrays import BoolArray, Float64Array, Int64Array
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import table_from_rows

SURFACE_CLASS = "Surface"  # stands where an IFC's class would: such an element is a part of a surface, no component
_NEIGHBOURS = 16
_NEIGHBOURHOOD_M = 1.0  # a wall's roughness (stones, noise of tie points) is finer than this
_SMOOTHING_ROUNDS = 2
_SAME_SIDE_COSINE = 0.5  # cosine between faces that look the same way
_DIRECTION_DEG = 25.0  # walls that turn by more than this from one another are two facades
_MIN_DIRECTION_SHARE = 0.02  # of all walls: less makes no facade of its own
_WALL_VARIANCE_RATIO = 0.01  # of variances: a wall is at least ten times as wide as deep
_PLANE_DEPTH_M = 1.0  # reveals and cornices stand off their wall by less, setbacks by more
_GRID_M = 0.1
_MIN_PLANE_SHARE = 0.01  # of all walls, within the bounds below: less is reveals, furniture or noise
_MIN_PLANE_BOUNDS_M2 = (4.0, 10.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class FacadePlanes:
    """The planes, and which of them each triangle (m,) belongs to.

    ``names`` such as "facade-S-1" (the largest plane that looks south), "level-1" (roofs, ground) or "inside-1";
    ``facades`` and ``azimuth_deg`` (NaN for level and inside) one a plane.
    """

    names: tuple[str, ...]
    facades: tuple[str, ...]
    azimuth_deg: Float64Array
    plane_of_triangle: Int64Array


def segment_facade_planes(surface: Surface) -> FacadePlanes:
    """Cut ``surface`` into facade planes; a triangle faces where it lies open to the sky, however it is wound."""
    centres = surface.vertices_site_m[surface.triangles].mean(axis=1)
    outward, is_open = _orient_normals(surface, centres)
    smooth = _smooth_normals(centres, outward, surface.areas_m2, is_open)
    flat = np.hypot(smooth[:, 0], smooth[:, 1])
    level = np.abs(smooth[:, 2]) > flat  # undersides too, though they see no sky
    wall = is_open & ~level
    keys: list[tuple[str, float, Int64Array]] = []
    rows = np.flatnonzero(wall)
    directions = _cluster_normals(smooth[rows], surface.areas_m2[rows])
    least_m2 = float(np.clip(_MIN_PLANE_SHARE * surface.areas_m2[rows].sum(), *_MIN_PLANE_BOUNDS_M2))
    nearest = np.argmax(smooth[rows] @ directions.T, axis=1) if len(directions) else np.zeros(0, dtype=np.int64)
    for number, direction in enumerate(directions):
        own = rows[nearest == number]
        if len(own) == 0:
            continue
        plane = _label_planes(centres[own] @ direction, surface.areas_m2[own], least_m2)
        largest = own[plane == np.argmax(np.bincount(plane, weights=surface.areas_m2[own]))]
        fitted = _fit_wall_normal(direction, centres[largest], surface.areas_m2[largest])
        azimuth = float(np.degrees(np.arctan2(fitted[0], fitted[1])) % 360.0)
        keys += [(compass_from_direction(fitted), azimuth, own[plane == k]) for k in np.unique(plane)]
    if level.any():
        keys.append((LEVEL, np.nan, np.flatnonzero(level)))
    inside = ~is_open & ~level
    if inside.any():
        keys.append((INSIDE, np.nan, np.flatnonzero(inside)))
    # The largest first, so that what noise adds or takes away at the small end leaves the others' names alone.
    keys.sort(key=lambda key: (key[0], -float(surface.areas_m2[key[2]].sum())))
    owner = np.full(len(surface.triangles), -1, dtype=np.int64)
    names: list[str] = []
    for number, (facade, _, triangles) in enumerate(keys):
        owner[triangles] = number
        count = sum(key[0] == facade for key in keys[: number + 1])
        names.append(f"{facade}-{count}" if facade in (LEVEL, INSIDE) else f"facade-{facade}-{count}")
    return FacadePlanes(
        names=tuple(names),
        facades=tuple(key[0] for key in keys),
        azimuth_deg=np.array([key[1] for key in keys]),
        plane_of_triangle=owner,
    )


def build_plane_elements(
    planes: FacadePlanes, surface: Surface, origin: SiteOrigin, storeys: Sequence[StoreyLevel]
) -> pa.Table:
    """Table ``elements``, one row a plane; a plane over several storeys has the one it begins in."""
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
                "ifc_class": SURFACE_CLASS,
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


def _orient_normals(surface: Surface, centres: Float64Array) -> tuple[Float64Array, BoolArray]:
    """Normals (m, 3) turned to the open side, and which triangles have one (m,).

    The winding is kept where the side it names is open: the back of a sheet, such as a campaign's own surface, is open
    too. A closed triangle beside an open one that faces alike is the bottom of a dent.
    """
    normals = surface.normals_site
    is_open = compute_openness(surface, centres, normals) > 0
    closed = np.flatnonzero(~is_open)
    if len(closed) == 0:
        return normals, is_open
    back = compute_openness(surface, centres[closed], -normals[closed]) > 0
    if is_open.any():
        opened = np.flatnonzero(is_open)
        apart, near = cKDTree(centres[opened]).query(centres[closed], distance_upper_bound=_NEIGHBOURHOOD_M)
        beside = opened[np.where(np.isfinite(apart), near, 0)]
        alike = np.einsum("ij,ij->i", normals[closed], normals[beside]) > _SAME_SIDE_COSINE
        dent = np.isfinite(apart) & alike
    else:
        dent = np.zeros(len(closed), dtype=bool)
    outward = normals.copy()
    outward[closed[back & ~dent]] *= -1.0
    is_open[closed[back | dent]] = True
    return outward, is_open


def _smooth_normals(centres: Float64Array, normals: Float64Array, areas: Float64Array, used: BoolArray) -> Float64Array:
    """Normals (m, 3) averaged with those around, half its own: noise goes, corners of clean walls stay."""
    rows = np.flatnonzero(used)
    smooth = normals.copy()
    count = min(_NEIGHBOURS, len(rows))
    if count < 2:
        return smooth
    apart, near = cKDTree(centres[rows]).query(centres[rows], k=count, distance_upper_bound=_NEIGHBOURHOOD_M)
    there = np.isfinite(apart)
    near = np.where(there, near, 0)
    weight = np.where(there, areas[rows][near], 0.0)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    own = normals[rows]
    for _ in range(_SMOOTHING_ROUNDS):
        mixed = own + np.einsum("ij,ijk->ik", weight, own[near])
        own = mixed / np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-12)
    smooth[rows] = own
    return smooth


def _cluster_normals(normals: Float64Array, areas: Float64Array) -> Float64Array:
    """Main horizontal directions (d, 3) of walls, that with most area first, each with what lies within 25 degrees."""
    azimuth = np.degrees(np.arctan2(normals[:, 0], normals[:, 1])) % 360.0
    weight = np.bincount(np.floor(azimuth).astype(np.int64) % 360, weights=areas, minlength=360)
    turn = np.abs((np.arange(360)[:, None] - np.arange(360)[None] + 180) % 360 - 180)
    core = turn <= _DIRECTION_DEG / 2
    found: list[Float64Array] = []
    total = weight.sum()
    while weight.sum() > _MIN_DIRECTION_SHARE * total:
        best = int(np.argmax(core @ weight))
        middles = np.radians(np.arange(360) + 0.5)
        share = weight * core[best]
        mean = np.array([share @ np.sin(middles), share @ np.cos(middles), 0.0])
        if share.sum() > _MIN_DIRECTION_SHARE * total:
            found.append(mean / np.linalg.norm(mean))
        weight = np.where(turn[best] <= _DIRECTION_DEG, 0.0, weight)
    return np.array(found).reshape(-1, 3)


def _fit_wall_normal(direction: Float64Array, places: Float64Array, areas: Float64Array) -> Float64Array:
    """The horizontal normal (3,) of the wall through ``places`` (n, 3), which rough normals tell to degrees alone.

    ``direction`` stays where the places make no wall: few of them, or as deep as wide.
    """
    flat = places[:, :2] - np.average(places[:, :2], axis=0, weights=areas)
    values, vectors = np.linalg.eigh((flat * areas[:, None]).T @ flat)
    normal = np.append(vectors[:, 0], 0.0)
    normal = normal if normal @ direction > 0 else -normal
    if values[0] > _WALL_VARIANCE_RATIO * values[1] or normal @ direction < np.cos(np.radians(_DIRECTION_DEG)):
        return direction
    return normal


def _label_planes(offset_m: Float64Array, areas: Float64Array, least_m2: float) -> Int64Array:
    """Number (n,) of the plane nearest to each triangle of one direction, by its offset along that direction.

    A plane is a peak of the area within half a metre, of ``least_m2`` or more (the largest peak of any), that falls to
    half of it before the next: the offsets of a curved wall have none but one.
    """
    order = np.argsort(offset_m, kind="stable")
    offset, summed = offset_m[order], np.concatenate([[0.0], np.cumsum(areas[order])])
    places = np.arange(offset[0] - _PLANE_DEPTH_M, offset[-1] + _PLANE_DEPTH_M + _GRID_M, _GRID_M)
    low = np.searchsorted(offset, places - _PLANE_DEPTH_M / 2)
    high = np.searchsorted(offset, places + _PLANE_DEPTH_M / 2, side="right")
    area = summed[high] - summed[low]
    peaks, _ = find_peaks(area)
    depth = peak_prominences(area, peaks)[0]
    kept = ((area[peaks] >= least_m2) & (depth >= 0.5 * area[peaks])) | (area[peaks] == area.max())
    middles = places[peaks[kept]]
    return np.searchsorted((middles[1:] + middles[:-1]) / 2, offset_m).astype(np.int64)
