"""Which facade an element belongs to: the compass direction of the part of its surface that is open to the sky."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facadelake.frames import Array
from facadelake.geobim.surface import Surface

COMPASS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
LEVEL = "level"
INSIDE = "inside"
_SKY = [(azimuth, height) for height in (15.0, 40.0, 65.0) for azimuth in (-50.0, 0.0, 50.0)]
_LIFT_M = 0.01
_SAME_PLANE_DEG = 2.0
_MAIN_SHARE = 0.5  # of an element's open area: below it the element is round, and its mean direction counts
_ONE_SIDED = 0.3  # net over total open area above which an element has one outward direction


def compass_of(direction_site: Array) -> str:
    """Compass name of a direction (3,) in site, or "level" where it is more up or down than sideways."""
    x, y, z = direction_site
    if abs(z) > np.hypot(x, y):
        return LEVEL
    return COMPASS[round(float(np.degrees(np.arctan2(x, y))) / 45.0) % 8]


def facade_seen(element_facade: str, normal_site: Array) -> str:
    """Facade of a place on an element, seen where its surface has ``normal_site`` (3,).

    It is the element's, so that a reveal counts with its wall, unless the place is on the element's other side or the
    element has no direction of its own: then it is the direction the place itself faces.
    """
    if element_facade not in COMPASS:
        return compass_of(normal_site)
    angle = np.radians(45.0 * COMPASS.index(element_facade))
    flat = float(np.hypot(normal_site[0], normal_site[1]))
    ahead = float(normal_site[0] * np.sin(angle) + normal_site[1] * np.cos(angle))
    behind = flat > 0.5 and ahead < flat * np.cos(np.radians(112.5))
    return compass_of(normal_site) if behind else element_facade


def facades_of(surface: Surface, element_of_triangle: NDArray[np.int64], elements: int) -> list[str]:
    """Facade of each element: "N" .. "NW", "level" where its open area lies mainly flat, "inside" where none is open.

    A side counts as far as rays from it reach the sky, so neither the winding of open shells nor the inner faces of
    outer walls matter. A wall with two open sides faces away from the building's middle.
    """
    normals, areas = surface.normals_site, surface.areas_m2
    centres = surface.vertices_site_m[surface.triangles].mean(axis=1)
    names = []
    open_front, open_back = openness(surface, centres, normals), openness(surface, centres, -normals)
    net = normals * (areas * (open_front - open_back))[:, None]
    total = areas * (open_front + open_back)
    sides = total * np.hypot(normals[:, 0], normals[:, 1])
    flat = total * np.abs(normals[:, 2])
    middle = (centres * areas[:, None]).sum(axis=0) / areas.sum()
    for element in range(elements):
        own = element_of_triangle == element
        if total[own].sum() < 1e-3 * areas[own].sum():
            names.append(INSIDE)
        elif flat[own].sum() > sides[own].sum():
            names.append(LEVEL)
        else:
            outward = net[own].sum(axis=0) * [1, 1, 0]
            if np.linalg.norm(outward) < _ONE_SIDED * sides[own].sum():
                outward = _two_sided(normals[own], sides[own], centres[own] - middle)
            names.append(compass_of(_main_side(net[own] * [1, 1, 0], outward)))
    return names


def openness(surface: Surface, points_site_m: Array, normals_site: Array) -> Array:
    """Share (n,) of directions upward and outward of each point that leave the building without meeting it again."""
    flat = np.hypot(normals_site[:, 0], normals_site[:, 1])
    ahead = np.where(
        (flat > 1e-3)[:, None], normals_site * [1, 1, 0] / np.maximum(flat, 1e-9)[:, None], np.array([1.0, 0.0, 0.0])
    )
    aside = np.column_stack([-ahead[:, 1], ahead[:, 0], np.zeros(len(ahead))])
    starts = points_site_m + _LIFT_M * normals_site
    share = np.zeros(len(points_site_m))
    for azimuth, height in _SKY:
        a, h = np.radians([azimuth, height])
        ray = np.cos(h) * (np.cos(a) * ahead + np.sin(a) * aside) + [0, 0, np.sin(h)]
        outward = np.einsum("ij,ij->i", ray, normals_site) > 0
        share += outward & ~surface.cast(starts, ray).hit
    share /= len(_SKY)
    return share


def _main_side(net: Array, outward: Array) -> Array:
    """The direction of the flat face that makes up most of the open area on the ``outward`` side, if one does.

    Elements of one plane then have one direction, however unevenly their reveals lie open.
    """
    area = np.linalg.norm(net, axis=1)
    ahead = (area > 0) & (net @ outward > 0)
    if not ahead.any():
        return outward
    azimuth = np.degrees(np.arctan2(net[ahead, 0], net[ahead, 1]))
    # Bins begin off the whole degrees that buildings like, and off the jump from 180 to -180.
    step = np.floor(((azimuth + 0.71) % 360.0) / _SAME_PLANE_DEG).astype(np.int64)
    _, where = np.unique(step, return_inverse=True)
    weight = np.bincount(where, weights=area[ahead])
    if weight.max() < _MAIN_SHARE * weight.sum():
        return outward
    main: Array = net[ahead][where == int(np.argmax(weight))].sum(axis=0)
    return main


def _two_sided(normals: Array, weights: Array, from_middle: Array) -> Array:
    """The main direction of a body open on opposite sides, turned away from the building's middle."""
    flat = normals[:, :2]
    _, vectors = np.linalg.eigh((flat * weights[:, None]).T @ flat)
    direction = np.append(vectors[:, -1], 0.0)
    away = float((weights @ from_middle) @ direction)
    chosen: Array = direction if away >= 0 else -direction
    return chosen
