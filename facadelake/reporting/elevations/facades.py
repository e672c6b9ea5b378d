"""The facades of a building: walls that look the same way, nearest to the viewer first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from facadelake.building import BuildingModel
from facadelake.building.surface import Surface
from facadelake.core.arrays import Float64Array, Int64Array
from facadelake.core.camera import PosedCamera
from facadelake.reporting.elevations.wall_directions import (
    ModelTriangles,
    azimuth_of,
    collect_triangles,
    estimate_element_azimuths,
    turn_deg,
)
from facadelake.reporting.inspection import PictureSettings

_COMPASS = ("North", "North-east", "East", "South-east", "South", "South-west", "West", "North-west")
_WINDOW_DEG = 25.0  # elements that look within this angle of one another make one facade
_FULL_HEIGHT_SHARE = 0.6  # of the tallest facade's height
_MIN_VISIBLE_SHARE = 0.3  # of an element's area, to count as shown in an elevation


@dataclass(frozen=True, kw_only=True, eq=False)
class Facade:
    """A vertical picture plane in ``site``: ``u`` to the viewer's right, ``v`` up (z), ``w`` towards the viewer.

    ``elements`` are rows of the model's elements; the extents are metres along u and v of ``site``'s origin;
    ``near_w_m`` is where the view begins, ``far_w_m`` the rearmost of its walls.
    """

    name: str
    azimuth_deg: float
    elements: Int64Array
    area_m2: float
    u_min_m: float
    u_max_m: float
    v_min_m: float
    v_max_m: float
    near_w_m: float
    far_w_m: float

    @property
    def title(self) -> str:
        """The name for people: "South-east facade", or "East facade 2" where two look one way."""
        words, _, number = self.name.partition(" ")
        return f"{words} facade {number}".rstrip()

    @property
    def axes_site(self) -> Float64Array:
        """Rows u, v, w (3, 3): unit directions in site; right-handed, so a wall's writing reads as on the wall."""
        azimuth = np.radians(self.azimuth_deg)
        outward = np.array([np.sin(azimuth), np.cos(azimuth), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        return np.array([np.cross(up, outward), up, outward])

    def uvw_from_site(self, xyz_site_m: Float64Array) -> Float64Array:
        """Points (n, 3) of site along the facade's axes, metres."""
        return np.asarray(xyz_site_m, dtype=np.float64) @ self.axes_site.T


def _cluster_azimuths(azimuth: Float64Array, area: Float64Array) -> list[tuple[float, Int64Array]]:
    """Groups of elements that look one way: the direction with most area first, its neighbours within 25 degrees."""
    left = np.isfinite(azimuth) & (area > 0)
    groups: list[tuple[float, Int64Array]] = []
    while left.any():
        rows = np.flatnonzero(left)
        near = turn_deg(azimuth[rows][:, None], azimuth[rows][None, :]) <= _WINDOW_DEG / 2
        middle = float(azimuth[rows][np.argmax(near @ area[rows])])
        core = rows[turn_deg(azimuth[rows], middle) <= _WINDOW_DEG / 2]
        vectors = np.column_stack([np.sin(np.radians(azimuth[core])), np.cos(np.radians(azimuth[core]))])
        middle = azimuth_of((vectors * area[core, None]).sum(axis=0))
        members = rows[turn_deg(azimuth[rows], middle) <= _WINDOW_DEG]
        groups.append((middle, members))
        left[members] = False
    return groups


def _split_by_depth(
    middle_deg: float, members: Int64Array, walls: ModelTriangles, surface: Surface, settings: PictureSettings
) -> list[Int64Array]:
    """Split elements that look one way where some stand behind others (a courtyard's far side), front first."""
    outward = np.array([np.sin(np.radians(middle_deg)), np.cos(np.radians(middle_deg)), 0.0])
    depth = walls.centre @ outward
    facing = (walls.normal @ outward > 0.5) & (walls.area > 0)
    layers: list[Int64Array] = []
    left = members
    while len(left):
        ask = np.flatnonzero(facing & np.isin(walls.element, left))
        start = depth[ask].max() + settings.clip_m
        origins = walls.centre[ask] + (start - depth[ask])[:, None] * outward
        hits = surface.cast(origins, np.broadcast_to(-outward, origins.shape).copy())
        shown = np.abs(hits.distance_m - (start - depth[ask])) <= settings.visibility_tolerance_m
        area = np.bincount(walls.element[ask], walls.area[ask], minlength=left.max() + 1)[left]
        visible = np.bincount(walls.element[ask], walls.area[ask] * shown, minlength=left.max() + 1)[left]
        front = visible >= _MIN_VISIBLE_SHARE * np.maximum(area, 1e-9)
        if not front.any():
            front = np.ones(len(left), dtype=bool)
        layers.append(left[front])
        left = left[~front]
    return layers


def find_facades(
    building: BuildingModel,
    surface: Surface,
    posed: Mapping[str, PosedCamera],
    defect_guids: frozenset[str],
    settings: PictureSettings,
) -> list[Facade]:
    """The main facades, clockwise from north; smaller ones only where an element of ``defect_guids`` is on them."""
    walls = collect_triangles(building, surface)
    azimuth, area = estimate_element_azimuths(building, walls, surface, posed, settings.visibility_tolerance_m)
    guids = np.array(building.elements.column("element_guid").to_pylist(), dtype=object)
    facades: list[Facade] = []
    for middle, members in _cluster_azimuths(azimuth, area):
        for elements in _split_by_depth(middle, members, walls, surface, settings):
            wanted = defect_guids.intersection(guids[elements])
            if area[elements].sum() < settings.min_facade_share * area.sum() and not wanted:
                continue
            facades.append(_create_facade(middle, elements, float(area[elements].sum()), walls, building, settings))
    facades.sort(key=lambda f: (f.azimuth_deg, -f.near_w_m))
    return _name_facades(_align_heights(facades))


def _create_facade(
    middle_deg: float,
    elements: Int64Array,
    area_m2: float,
    walls: ModelTriangles,
    building: BuildingModel,
    settings: PictureSettings,
) -> Facade:
    mine = np.isin(walls.element, elements)
    draft = Facade(
        name="", azimuth_deg=middle_deg, elements=elements, area_m2=area_m2, u_min_m=0, u_max_m=1, v_min_m=0, v_max_m=1,
        near_w_m=0, far_w_m=0,
    )  # fmt: skip
    uvw = draft.uvw_from_site(building.vertices_site_m[np.unique(building.triangles[mine])])
    low, high = uvw.min(axis=0), uvw.max(axis=0)
    return Facade(
        name="", azimuth_deg=middle_deg, elements=elements, area_m2=area_m2,
        u_min_m=float(low[0]) - 0.5, u_max_m=float(high[0]) + 0.5,
        v_min_m=float(low[1]) - 0.3, v_max_m=float(high[1]) + 0.3,
        near_w_m=float(high[2]) + settings.clip_m, far_w_m=float(low[2]),
    )  # fmt: skip


def _align_heights(facades: list[Facade]) -> list[Facade]:
    """Facades of about one height get one vertical extent, so that their sheets can be laid side by side."""
    if not facades:
        return facades
    low, high = min(f.v_min_m for f in facades), max(f.v_max_m for f in facades)
    return [
        replace(f, v_min_m=low, v_max_m=high) if f.v_max_m - f.v_min_m > _FULL_HEIGHT_SHARE * (high - low) else f
        for f in facades
    ]


def _name_facades(facades: list[Facade]) -> list[Facade]:
    """Each facade with the words of its direction; a number where two share them."""
    words = [_name_direction(f.azimuth_deg) for f in facades]
    named = []
    for i, facade in enumerate(facades):
        number = words[: i + 1].count(words[i])
        name = words[i] if words.count(words[i]) == 1 else f"{words[i]} {number}"
        named.append(replace(facade, name=name))
    return named


def _name_direction(azimuth_deg: float) -> str:
    """The nearest of the eight compass directions."""
    return _COMPASS[round(azimuth_deg / 45.0) % 8]
