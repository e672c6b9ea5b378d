"""Which way the open sides of a building's elements look, and the names that facades have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facadelake.frames import Array
from facadelake.geobim.surface import Surface

COMPASS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
LEVEL = "level"  # open mainly upward or downward: roofs, slabs, soffits
INSIDE = "inside"  # open nowhere
AROUND = "around"  # open to many sides: curved walls, columns; the place's own normal decides
_SKY = [(azimuth, height) for height in (15.0, 40.0, 65.0) for azimuth in (-50.0, 0.0, 50.0)]
_LIFT_M = 0.01
_CHUNK = 200_000  # triangles whose openness is found at once: some 100 MB
_SAME_PLANE_DEG = 2.0
_MAIN_SHARE = 0.55  # of an element's open upright area: a plane that has more is the element's direction
_WITHIN_DEG = 30.0
_ROUND_SHARE = 0.75  # without such a plane, the share within 30 degrees that makes a mean direction meaningful
_ONE_SIDED = 0.3  # net over total open area above which an element has one outward direction


@dataclass(frozen=True, kw_only=True, eq=False)
class OpenSides:
    """For n elements: the outward azimuth in degrees (NaN: none), its open upright area in m2, and a word.

    The word is "level", "inside" or "around" where an element has no direction, else empty.
    """

    azimuth_deg: Array
    area_m2: Array
    words: tuple[str, ...]


def compass_of(direction_site: Array) -> str:
    """Compass name of a direction (3,) in site, or "level" where it is more up or down than sideways."""
    x, y, z = direction_site
    if abs(z) > np.hypot(x, y):
        return LEVEL
    return COMPASS[round(float(np.degrees(np.arctan2(x, y))) / 45.0) % 8]


def open_sides_of(surface: Surface, element_of_triangle: NDArray[np.int64], elements: int) -> OpenSides:
    """Which way each element's open sides look.

    A side counts as far as rays from it reach the sky, so neither the winding of open shells nor the inner faces of
    outer walls matter. A wall with two open sides faces away from the building's middle.
    """
    normals, areas = surface.normals_site, surface.areas_m2
    centres = surface.vertices_site_m[surface.triangles].mean(axis=1)
    front, back = np.empty(len(areas)), np.empty(len(areas))
    for start in range(0, len(areas), _CHUNK):
        part = slice(start, start + _CHUNK)
        front[part] = openness(surface, centres[part], normals[part])
        back[part] = openness(surface, centres[part], -normals[part])
    upright = np.hypot(normals[:, 0], normals[:, 1])
    total = areas * (front + back)
    net = normals * (areas * (front - back))[:, None]
    middle = (centres * areas[:, None]).sum(axis=0) / areas.sum()
    order = np.argsort(element_of_triangle, kind="stable")
    ends = np.searchsorted(element_of_triangle[order], np.arange(elements + 1))
    azimuths, open_areas, words = np.full(elements, np.nan), np.zeros(elements), []
    for element in range(elements):
        own = order[ends[element] : ends[element + 1]]
        sides = total[own] * upright[own]
        if total[own].sum() < 1e-3 * areas[own].sum():
            words.append(INSIDE)
        elif (total[own] * np.abs(normals[own, 2])).sum() > sides.sum():
            words.append(LEVEL)
        else:
            outward = net[own].sum(axis=0) * [1, 1, 0]
            if np.linalg.norm(outward) < _ONE_SIDED * sides.sum():
                outward = _two_sided(normals[own], sides, centres[own] - middle)
            main = _main_side(normals[own], sides, outward)
            words.append(AROUND if main is None else "")
            if main is not None:
                azimuths[element] = np.degrees(np.arctan2(main[0], main[1])) % 360.0
                open_areas[element] = sides.sum()
    return OpenSides(azimuth_deg=azimuths, area_m2=open_areas, words=tuple(words))


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


def _main_side(normals: Array, weights: Array, outward: Array) -> Array | None:
    """The direction (2,) that most of an element's open area has, on its ``outward`` side; None where none has.

    It is that of the largest plane if that makes up most of the area, so that elements of one plane have one direction
    however unevenly their reveals lie open. Both sides of a wall count for its direction.
    """
    used = weights > 0
    flat = normals[used, :2] / np.linalg.norm(normals[used, :2], axis=1, keepdims=True)
    weight = weights[used]
    azimuth = np.degrees(np.arctan2(flat[:, 0], flat[:, 1])) % 180.0  # front and back of one plane together
    # Bins begin off the whole degrees that buildings like; the last one closes the circle.
    step = np.floor(((azimuth + 0.71) % 180.0) / _SAME_PLANE_DEG).astype(np.int64)
    share = np.bincount(step, weights=weight) / weight.sum()
    if share.max() > _MAIN_SHARE:
        core = step == int(np.argmax(share))
    else:
        mean = np.degrees(np.arctan2(outward[0], outward[1]))
        core = np.abs((azimuth - mean + 90.0) % 180.0 - 90.0) <= _WITHIN_DEG
        if weight[core].sum() < _ROUND_SHARE * weight.sum():
            return None
    turned = np.where(flat[core] @ outward[:2] < 0, -1.0, 1.0)
    direction: Array = (flat[core] * (weight[core] * turned)[:, None]).sum(axis=0)
    return direction


def _two_sided(normals: Array, weights: Array, from_middle: Array) -> Array:
    """The main direction of a body open on opposite sides, turned away from the building's middle."""
    flat = normals[:, :2]
    _, vectors = np.linalg.eigh((flat * weights[:, None]).T @ flat)
    direction = np.append(vectors[:, -1], 0.0)
    away = float((weights @ from_middle) @ direction)
    chosen: Array = direction if away >= 0 else -direction
    return chosen
