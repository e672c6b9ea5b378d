"""Find the outward directions of a building's elements from their openness to the sky."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.building.surface.raycasting import Surface
from facadelake.core.arrays import Float64Array, Float64N, Float64Nx3, Float64x3, RowIndices
from facadelake.core.frames import COMPASS

LEVEL = "level"  # open mainly upward or downward: roofs, slabs, soffits
INSIDE = "inside"  # not open
AROUND = "around"  # open to several sides (curved walls, returns, columns): the normal at a point decides
_SKY_DIRECTIONS_DEG = [(azimuth, height) for height in (15.0, 40.0, 65.0) for azimuth in (-50.0, 0.0, 50.0)]
_START_OFFSET_M = 0.01
_BATCH = 200_000  # triangles processed at once: about 100 MB
_LARGE_TRIANGLE_M2 = 1.0
_SAME_PLANE_DEG = 2.0
_MAIN_PLANE_SHARE = 0.55  # a plane with more of an element's open upright area gives the element's direction
_CURVED_HALF_WIDTH_DEG = 30.0
_CURVED_SHARE = 0.75  # without such a plane, minimum share within 30 degrees of the mean direction
_OPEN_SHARE = 0.15  # a side that is open to less of the sky is a slot
_RETURN_DEG = 45.0
_RETURN_M = 1.0  # reveals and the ends of walls are narrower
_SAME_PLANE_M = 0.05
_ONE_SIDED_SHARE = 0.3  # minimum of net over total open area of an element with one outward direction


@dataclass(frozen=True, kw_only=True, eq=False)
class OpenSides:
    """Open sides of n elements.

    ``azimuth_deg`` (n,): main outward direction, NaN if none. ``area_m2`` (n,): open upright area. ``labels`` (n):
    "level", "inside" or "around" where the element does not belong to one facade, else "".
    """

    azimuth_deg: Float64N
    area_m2: Float64N
    labels: tuple[str, ...]


def compass_from_direction(direction_site: Float64x3) -> str:
    """Compass name of a direction (3,) in site, or "level" if it is closer to the vertical than to the horizontal."""
    x, y, z = direction_site
    if abs(z) > np.hypot(x, y):
        return LEVEL
    return COMPASS[round(float(np.degrees(np.arctan2(x, y))) / 45.0) % 8]


def find_open_sides(surface: Surface, element_of_triangle: RowIndices, elements: int) -> OpenSides:
    """Find the directions of each element's open sides.

    Sides are weighted by their openness to the sky, so the result depends neither on the winding of open shells nor on
    the inner faces of outer walls. A wall with two open sides faces away from the building's centre.
    """
    normals, areas = surface.normals_site, surface.areas_m2
    centres = surface.vertices_site_m[surface.triangles].mean(axis=1)
    front, back = _compute_both_sides(surface)
    upright = np.hypot(normals[:, 0], normals[:, 1])
    total = areas * (front + back)
    net = normals * (areas * (front - back))[:, None]
    building_centre = (centres * areas[:, None]).sum(axis=0) / areas.sum()
    order = np.argsort(element_of_triangle, kind="stable")
    ends = np.searchsorted(element_of_triangle[order], np.arange(elements + 1))
    azimuths, open_areas, labels = np.full(elements, np.nan), np.zeros(elements), []
    for element in range(elements):
        own = order[ends[element] : ends[element + 1]]
        sides = total[own] * upright[own]
        if total[own].sum() < 1e-3 * areas[own].sum():
            labels.append(INSIDE)
        elif (total[own] * np.abs(normals[own, 2])).sum() > sides.sum():
            labels.append(LEVEL)
        else:
            outward = net[own].sum(axis=0) * [1, 1, 0]
            if np.linalg.norm(outward) < _ONE_SIDED_SHARE * sides.sum():
                outward = _orient_two_sided(normals[own], sides, centres[own] - building_centre)
            main = _find_main_direction(normals[own], sides, outward)
            if main is not None:
                azimuths[element] = np.degrees(np.arctan2(main[0], main[1])) % 360.0
                open_areas[element] = sides.sum()
            open_triangles = own[sides > _OPEN_SHARE * areas[own] * upright[own]]
            is_around = main is None or _has_return(surface, open_triangles, main)
            labels.append(AROUND if is_around else "")
    return OpenSides(azimuth_deg=azimuths, area_m2=open_areas, labels=tuple(labels))


def _compute_both_sides(surface: Surface) -> tuple[Float64N, Float64N]:
    """Openness (m,) of each triangle on the side of its normal, and on the other side.

    A triangle of a square metre or more is sampled at four points, because its centre may be under a balcony.
    """
    rows = np.arange(len(surface.triangles))
    large = np.flatnonzero(surface.areas_m2 >= _LARGE_TRIANGLE_M2)
    triangle = np.concatenate([rows, np.repeat(large, 3)])  # of each sample
    corner = np.concatenate([np.full(len(rows), -1), np.tile(np.arange(3), len(large))])  # -1: the centre
    front, back = np.zeros(len(rows)), np.zeros(len(rows))
    for start in range(0, len(triangle), _BATCH):
        part = triangle[start : start + _BATCH]
        corners = surface.vertices_site_m[surface.triangles[part]]
        centres = corners.mean(axis=1)
        toward = corner[start : start + _BATCH]
        own = corners[np.arange(len(part)), np.maximum(toward, 0)]
        points = np.where((toward < 0)[:, None], centres, (centres + own) / 2)
        normals = surface.normals_site[part]
        np.add.at(front, part, compute_openness(surface, points, normals))
        np.add.at(back, part, compute_openness(surface, points, -normals))
    samples = np.bincount(triangle, minlength=len(rows))
    return front / samples, back / samples


def compute_openness(surface: Surface, points_site_m: Float64Nx3, normals_site: Float64Nx3) -> Float64N:
    """Share (n,) of upward and outward rays from each point that leave the building without another hit."""
    horizontal = np.hypot(normals_site[:, 0], normals_site[:, 1])
    ahead = np.where(
        (horizontal > 1e-3)[:, None],
        normals_site * [1, 1, 0] / np.maximum(horizontal, 1e-9)[:, None],
        np.array([1.0, 0.0, 0.0]),
    )
    aside = np.column_stack([-ahead[:, 1], ahead[:, 0], np.zeros(len(ahead))])
    starts = points_site_m + _START_OFFSET_M * normals_site
    share = np.zeros(len(points_site_m))
    for azimuth, height in _SKY_DIRECTIONS_DEG:
        a, h = np.radians([azimuth, height])
        ray = np.cos(h) * (np.cos(a) * ahead + np.sin(a) * aside) + [0, 0, np.sin(h)]
        outward = np.einsum("ij,ij->i", ray, normals_site) > 0
        share += outward & ~surface.cast(starts, ray).hit
    share /= len(_SKY_DIRECTIONS_DEG)
    return share


def _find_main_direction(normals: Float64Nx3, weights: Float64N, outward: Float64x3) -> Float64Array | None:
    """The direction (2,) of most of an element's open area, on its ``outward`` side; None if there is none.

    It is that of the largest plane if that has most of the area, so that elements of one plane have one direction
    however their reveals are open. Both sides of a wall count.
    """
    used = weights > 0
    flat = normals[used, :2] / np.linalg.norm(normals[used, :2], axis=1, keepdims=True)
    weight = weights[used]
    azimuth = np.degrees(np.arctan2(flat[:, 0], flat[:, 1])) % 180.0  # front and back of one plane together
    # Bins start off whole degrees, where buildings' directions are frequent; the last one closes the circle.
    step = np.floor(((azimuth + 0.71) % 180.0) / _SAME_PLANE_DEG).astype(np.int64)
    share = np.bincount(step, weights=weight) / weight.sum()
    if share.max() > _MAIN_PLANE_SHARE:
        core = step == int(np.argmax(share))
    else:
        mean = np.degrees(np.arctan2(outward[0], outward[1]))
        core = np.abs((azimuth - mean + 90.0) % 180.0 - 90.0) <= _CURVED_HALF_WIDTH_DEG
        if weight[core].sum() < _CURVED_SHARE * weight.sum():
            return None
    sign = np.where(flat[core] @ outward[:2] < 0, -1.0, 1.0)
    direction: Float64Array = (flat[core] * (weight[core] * sign)[:, None]).sum(axis=0)
    return direction


def _has_return(surface: Surface, triangles: RowIndices, main: Float64Array) -> bool:
    """Whether an open triangle (k,) belongs to a plane wider than 1 m at more than 45 degrees to ``main`` (2,)."""
    normals = surface.normals_site[triangles]
    upright = np.hypot(normals[:, 0], normals[:, 1])
    along = np.abs(normals[:, :2] @ main) / np.linalg.norm(main)
    aside = (upright > np.cos(np.radians(_RETURN_DEG))) & (along < np.cos(np.radians(_RETURN_DEG)) * upright)
    if not aside.any():
        return False
    flat = normals[aside, :2] / upright[aside, None]
    flat *= np.where((flat[:, 0] < 0) | ((flat[:, 0] == 0) & (flat[:, 1] < 0)), -1.0, 1.0)[:, None]
    corners = surface.vertices_site_m[surface.triangles[triangles[aside]]][:, :, :2]
    azimuth = np.degrees(np.arctan2(flat[:, 0], flat[:, 1]))
    offset = np.einsum("ij,ikj->ik", flat, corners).mean(axis=1)
    keys = np.column_stack([np.floor((azimuth + 0.71) / _SAME_PLANE_DEG), np.round(offset / _SAME_PLANE_M)])
    _, plane = np.unique(keys, axis=0, return_inverse=True)
    across = np.einsum("ij,ikj->ik", np.column_stack([-flat[:, 1], flat[:, 0]]), corners)
    low, high = np.full(plane.max() + 1, np.inf), np.full(plane.max() + 1, -np.inf)
    np.minimum.at(low, plane, across.min(axis=1))
    np.maximum.at(high, plane, across.max(axis=1))
    return bool((high - low).max() > _RETURN_M)


def _orient_two_sided(normals: Float64Nx3, weights: Float64N, from_centre: Float64Nx3) -> Float64x3:
    """Main direction of a body open on opposite sides, away from the building's centre (``from_centre`` (n, 3))."""
    flat = normals[:, :2]
    _, vectors = np.linalg.eigh((flat * weights[:, None]).T @ flat)
    direction = np.append(vectors[:, -1], 0.0)
    away = float((weights @ from_centre) @ direction)
    outward: Float64x3 = direction if away >= 0 else -direction
    return outward
