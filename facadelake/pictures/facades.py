"""The facades of a building: walls that look the same way, nearest to the viewer first."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facadelake.camera import PosedCamera
from facadelake.frames import Array
from facadelake.geobim.model import BuildingModel
from facadelake.geobim.surface import Surface
from facadelake.pictures.inspection import PictureSettings
from facadelake.pictures.palette import compass_word
from facadelake.pictures.sight import sees

log = logging.getLogger(__name__)

_COMPASS_DEG = {"N": 0, "NE": 45, "E": 90, "SE": 135, "S": 180, "SW": 225, "W": 270, "NW": 315}
_WINDOW_DEG = 25.0  # elements that look within this angle of one another make one facade
_MIN_VISIBLE_SHARE = 0.3  # of an element's area, to count as shown in an elevation
_MAX_JUDGED_TRIANGLES = 20_000
_MAX_JUDGING_CAMERAS = 150


@dataclass(frozen=True, kw_only=True, eq=False)
class Facade:
    """A vertical picture plane in ``site``: ``u`` to the viewer's right, ``v`` up (z), ``w`` towards the viewer.

    ``elements`` are rows of the model's elements; the extents are metres along u and v of ``site``'s origin;
    ``near_w_m`` is where the view begins, ``far_w_m`` the rearmost of its walls.
    """

    name: str
    azimuth_deg: float
    elements: NDArray[np.int64]
    area_m2: float
    u_min_m: float
    u_max_m: float
    v_min_m: float
    v_max_m: float
    near_w_m: float
    far_w_m: float

    @property
    def axes_site(self) -> Array:
        """Rows u, v, w (3, 3): unit directions in site; right-handed, so a wall's writing reads as on the wall."""
        azimuth = np.radians(self.azimuth_deg)
        outward = np.array([np.sin(azimuth), np.cos(azimuth), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        return np.array([np.cross(up, outward), up, outward])

    def uvw(self, xyz_site_m: Array) -> Array:
        """Points (n, 3) of site along the facade's axes, metres."""
        return np.asarray(xyz_site_m, dtype=np.float64) @ self.axes_site.T


@dataclass(frozen=True, kw_only=True, eq=False)
class _Walls:
    """Triangles of the model with what facades need to know of them."""

    normal: Array
    area: Array
    centre: Array
    element: NDArray[np.int64]


def _walls(building: BuildingModel, surface: Surface) -> _Walls:
    return _Walls(
        normal=surface.normals_site,
        area=np.where(np.abs(surface.normals_site[:, 2]) < 0.35, surface.areas_m2, 0.0),
        centre=surface.vertices_site_m[surface.triangles].mean(axis=1),
        element=np.asarray(building.element_of_triangle, dtype=np.int64),
    )


def _azimuth(vector: Array) -> float:
    return float(np.degrees(np.arctan2(vector[0], vector[1])) % 360.0)


def _turn(a_deg: Array | float, b_deg: Array | float) -> Array:
    """Smallest angle between azimuths, degrees."""
    return np.abs((np.asarray(a_deg) - b_deg + 180.0) % 360.0 - 180.0)


def _seen_area(walls: _Walls, surface: Surface, posed: Mapping[str, PosedCamera], tolerance_m: float) -> Array:
    """Area of each triangle (n,) if any camera sees its centre from in front, else 0."""
    largest = np.argsort(-walls.area)[:_MAX_JUDGED_TRIANGLES]
    largest = largest[walls.area[largest] > 0]
    seen = np.zeros(len(walls.area), dtype=bool)
    cameras = list(posed.values())
    for camera in cameras[:: max(1, len(cameras) // _MAX_JUDGING_CAMERAS)]:
        ask = largest[~seen[largest]]
        if len(ask) == 0:
            break
        view = sees(
            camera, surface, walls.centre[ask], walls.normal[ask], tolerance_m=tolerance_m, max_incidence_deg=80
        )
        seen[ask[view.visible]] = True
    return np.where(seen, walls.area, 0.0)


def _element_azimuths(building: BuildingModel, walls: _Walls, seen_area: Array) -> tuple[Array, Array]:
    """Outward azimuth (elements,) in degrees, NaN where an element has none, and the area (elements,) that looks so.

    The model's own word (column facade) is kept unless the photographs see another side of the element: a wall has
    two sides, and round a courtyard only the cameras know which of them is outside.
    """
    count = len(building.elements)
    azimuth, area = np.full(count, np.nan), np.zeros(count)
    words = building.elements.column("facade").to_pylist()
    external = building.elements.column("is_external").to_pylist()
    order = np.argsort(walls.element, kind="stable")
    starts = np.searchsorted(walls.element[order], np.arange(count + 1))
    side = np.degrees(np.arctan2(walls.normal[:, 0], walls.normal[:, 1])) % 360.0
    for row in range(count):
        mine = order[starts[row] : starts[row + 1]]
        mine = mine[walls.area[mine] > 0]
        if len(mine) == 0 or (external[row] is False and not seen_area[mine].any()):
            continue
        told = _COMPASS_DEG.get(words[row])
        seen = seen_area[mine]
        if seen.any() and (told is None or seen[_turn(side[mine], told) <= 60].sum() < 0.25 * seen.sum()):
            told_deg = float(side[mine][np.argmax(seen)])
        elif told is None:
            continue
        else:
            told_deg = float(told)
        facing = mine[_turn(side[mine], told_deg) <= 60]
        if len(facing):
            azimuth[row] = _azimuth((walls.normal[facing] * walls.area[facing, None]).sum(axis=0))
            area[row] = walls.area[facing].sum()
    return azimuth, area


def _directions(azimuth: Array, area: Array) -> list[tuple[float, NDArray[np.int64]]]:
    """Groups of elements that look one way: the direction with most area first, its neighbours within 25 degrees."""
    left = np.isfinite(azimuth) & (area > 0)
    groups: list[tuple[float, NDArray[np.int64]]] = []
    while left.any():
        rows = np.flatnonzero(left)
        near = _turn(azimuth[rows][:, None], azimuth[rows][None, :]) <= _WINDOW_DEG / 2
        middle = float(azimuth[rows][np.argmax(near @ area[rows])])
        core = rows[_turn(azimuth[rows], middle) <= _WINDOW_DEG / 2]
        vectors = np.column_stack([np.sin(np.radians(azimuth[core])), np.cos(np.radians(azimuth[core]))])
        middle = _azimuth((vectors * area[core, None]).sum(axis=0))
        members = rows[_turn(azimuth[rows], middle) <= _WINDOW_DEG]
        groups.append((middle, members))
        left[members] = False
    return groups


def _layers(
    middle_deg: float, members: NDArray[np.int64], walls: _Walls, surface: Surface, settings: PictureSettings
) -> list[NDArray[np.int64]]:
    """Split elements that look one way where some stand behind others (a courtyard's far side), front first."""
    outward = np.array([np.sin(np.radians(middle_deg)), np.cos(np.radians(middle_deg)), 0.0])
    depth = walls.centre @ outward
    facing = (walls.normal @ outward > 0.5) & (walls.area > 0)
    layers: list[NDArray[np.int64]] = []
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
    walls = _walls(building, surface)
    seen_area = _seen_area(walls, surface, posed, settings.visibility_tolerance_m)
    azimuth, area = _element_azimuths(building, walls, seen_area)
    guids = np.array(building.elements.column("element_guid").to_pylist(), dtype=object)
    facades: list[Facade] = []
    for middle, members in _directions(azimuth, area):
        for elements in _layers(middle, members, walls, surface, settings):
            wanted = defect_guids.intersection(guids[elements])
            if area[elements].sum() < settings.min_facade_share * area.sum() and not wanted:
                continue
            facades.append(_facade(middle, elements, float(area[elements].sum()), walls, building, settings))
    facades.sort(key=lambda f: (f.azimuth_deg, -f.near_w_m))
    return _named(facades)


def _facade(
    middle_deg: float,
    elements: NDArray[np.int64],
    area_m2: float,
    walls: _Walls,
    building: BuildingModel,
    settings: PictureSettings,
) -> Facade:
    mine = np.isin(walls.element, elements)
    draft = Facade(
        name="", azimuth_deg=middle_deg, elements=elements, area_m2=area_m2, u_min_m=0, u_max_m=1, v_min_m=0, v_max_m=1,
        near_w_m=0, far_w_m=0,
    )  # fmt: skip
    uvw = draft.uvw(building.vertices_site_m[np.unique(building.triangles[mine])])
    low, high = uvw.min(axis=0), uvw.max(axis=0)
    return Facade(
        name="", azimuth_deg=middle_deg, elements=elements, area_m2=area_m2,
        u_min_m=float(low[0]) - 0.5, u_max_m=float(high[0]) + 0.5,
        v_min_m=float(low[1]) - 0.3, v_max_m=float(high[1]) + 0.3,
        near_w_m=float(high[2]) + settings.clip_m, far_w_m=float(low[2]),
    )  # fmt: skip


def _named(facades: list[Facade]) -> list[Facade]:
    """Each facade with the words of its direction; a number where two share them."""
    words = [compass_word(f.azimuth_deg) for f in facades]
    named = []
    for i, facade in enumerate(facades):
        number = words[: i + 1].count(words[i])
        name = words[i] if words.count(words[i]) == 1 else f"{words[i]} {number}"
        named.append(Facade(**{**facade.__dict__, "name": name}))
    return named
