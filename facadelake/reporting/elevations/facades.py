"""Facades to be drawn as elevations: elements that face one direction, split by depth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from facadelake.building import BuildingModel
from facadelake.building.facades import azimuth_from_direction, measure_turn_deg
from facadelake.building.surface import Surface
from facadelake.core.arrays import Float64N, Float64Nx3, Float64x3x3, RowIndices
from facadelake.core.camera import PosedCamera
from facadelake.reporting.elevations.wall_directions import (
    ModelTriangles,
    collect_triangles,
    estimate_element_azimuths,
)
from facadelake.reporting.inspection import PictureSettings

_COMPASS = ("North", "North-east", "East", "South-east", "South", "South-west", "West", "North-west")
_WINDOW_DEG = 25.0  # elements within this angle of a direction belong to its facade
_FULL_HEIGHT_SHARE = 0.6  # facades of at least this share of the total height get a common vertical extent
_MIN_VISIBLE_SHARE = 0.3  # of an element's area, for the element to belong to the front layer


@dataclass(frozen=True, kw_only=True, eq=False)
class Facade:
    """The vertical picture plane of an elevation: ``u`` to the viewer's right, ``v`` up, ``w`` towards the viewer.

    All coordinates are in metres from ``site``'s origin. ``elements`` are rows of table ``elements``; ``near_w_m`` is
    the plane where the view begins, ``far_w_m`` the rearmost point of its walls.
    """

    name: str
    azimuth_deg: float
    elements: RowIndices
    area_m2: float
    u_min_m: float
    u_max_m: float
    v_min_m: float
    v_max_m: float
    near_w_m: float
    far_w_m: float

    @property
    def title(self) -> str:
        """The name in titles: "South-east facade", or "East facade 2" where two facades face one direction."""
        direction, _, number = self.name.partition(" ")
        return f"{direction} facade {number}".rstrip()

    @property
    def axes_site(self) -> Float64x3x3:
        """Unit vectors u, v, w in site as rows; right-handed, so that the elevation is not mirrored."""
        azimuth = np.radians(self.azimuth_deg)
        outward = np.array([np.sin(azimuth), np.cos(azimuth), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        return np.array([np.cross(up, outward), up, outward])

    def uvw_from_site(self, xyz_site_m: Float64Nx3) -> Float64Nx3:
        """Coordinates u, v, w of points of site, metres."""
        return np.asarray(xyz_site_m, dtype=np.float64) @ self.axes_site.T


def _cluster_azimuths(azimuth: Float64N, area: Float64N) -> list[tuple[float, RowIndices]]:
    """Clusters of elements that face one direction: (azimuth in degrees, rows), the direction with most area first."""
    unassigned = np.isfinite(azimuth) & (area > 0)
    clusters: list[tuple[float, RowIndices]] = []
    while unassigned.any():
        rows = np.flatnonzero(unassigned)
        near = measure_turn_deg(azimuth[rows][:, None], azimuth[rows][None, :]) <= _WINDOW_DEG / 2
        centre_deg = float(azimuth[rows][np.argmax(near @ area[rows])])
        core = rows[measure_turn_deg(azimuth[rows], centre_deg) <= _WINDOW_DEG / 2]
        vectors = np.column_stack([np.sin(np.radians(azimuth[core])), np.cos(np.radians(azimuth[core]))])
        centre_deg = azimuth_from_direction((vectors * area[core, None]).sum(axis=0))
        members = rows[measure_turn_deg(azimuth[rows], centre_deg) <= _WINDOW_DEG]
        clusters.append((centre_deg, members))
        unassigned[members] = False
    return clusters


def _split_by_depth(
    azimuth_deg: float, members: RowIndices, walls: ModelTriangles, surface: Surface, settings: PictureSettings
) -> list[RowIndices]:
    """Split elements that face one direction into layers where some hide others, as in a courtyard; front first."""
    outward = np.array([np.sin(np.radians(azimuth_deg)), np.cos(np.radians(azimuth_deg)), 0.0])
    depth = walls.centre @ outward
    facing = (walls.normal @ outward > 0.5) & (walls.area > 0)
    layers: list[RowIndices] = []
    remaining = members
    while len(remaining):
        rows = np.flatnonzero(facing & np.isin(walls.element, remaining))
        start = depth[rows].max() + settings.clip_m
        origins = walls.centre[rows] + (start - depth[rows])[:, None] * outward
        hits = surface.cast(origins, np.broadcast_to(-outward, origins.shape).copy())
        is_visible = np.abs(hits.distance_m - (start - depth[rows])) <= settings.visibility_tolerance_m
        count = remaining.max() + 1
        area = np.bincount(walls.element[rows], walls.area[rows], minlength=count)[remaining]
        visible_area = np.bincount(walls.element[rows], walls.area[rows] * is_visible, minlength=count)[remaining]
        front = visible_area >= _MIN_VISIBLE_SHARE * np.maximum(area, 1e-9)
        if not front.any():
            front = np.ones(len(remaining), dtype=bool)
        layers.append(remaining[front])
        remaining = remaining[~front]
    return layers


def find_facades(
    building: BuildingModel,
    surface: Surface,
    posed: Mapping[str, PosedCamera],
    defect_guids: frozenset[str],
    settings: PictureSettings,
) -> list[Facade]:
    """Facades to be drawn, clockwise from north: the main ones, and smaller ones that carry a defect.

    Args:
        building: building model.
        surface: its surface, for ray casting.
        posed: cameras with poses, by photo_id; they show which side of a wall is outside.
        defect_guids: GlobalIds of elements with a defect.
        settings: smallest share of a facade, distance of the view plane, tolerance of visibility.

    Returns:
        The facades, named by compass direction.
    """
    walls = collect_triangles(building, surface)
    azimuth, area = estimate_element_azimuths(building, walls, surface, posed, settings.visibility_tolerance_m)
    guids = np.array(building.elements.column("element_guid").to_pylist(), dtype=object)
    facades: list[Facade] = []
    for azimuth_deg, members in _cluster_azimuths(azimuth, area):
        for elements in _split_by_depth(azimuth_deg, members, walls, surface, settings):
            has_defect = defect_guids.intersection(guids[elements])
            facade_area = area[elements].sum()
            if facade_area < settings.min_facade_share * area.sum() and not has_defect:
                continue
            facades.append(_create_facade(azimuth_deg, elements, float(facade_area), walls, building, settings))
    facades.sort(key=lambda f: (f.azimuth_deg, -f.near_w_m))
    return _name_facades(_align_heights(facades))


def _create_facade(
    azimuth_deg: float,
    elements: RowIndices,
    area_m2: float,
    walls: ModelTriangles,
    building: BuildingModel,
    settings: PictureSettings,
) -> Facade:
    """A facade whose extents contain the triangles of its elements, with a margin; its name is given later."""
    own = np.isin(walls.element, elements)
    draft = Facade(
        name="", azimuth_deg=azimuth_deg, elements=elements, area_m2=area_m2,
        u_min_m=0, u_max_m=1, v_min_m=0, v_max_m=1, near_w_m=0, far_w_m=0,
    )  # fmt: skip
    uvw = draft.uvw_from_site(building.vertices_site_m[np.unique(building.triangles[own])])
    low, high = uvw.min(axis=0), uvw.max(axis=0)
    return Facade(
        name="", azimuth_deg=azimuth_deg, elements=elements, area_m2=area_m2,
        u_min_m=float(low[0]) - 0.5, u_max_m=float(high[0]) + 0.5,
        v_min_m=float(low[1]) - 0.3, v_max_m=float(high[1]) + 0.3,
        near_w_m=float(high[2]) + settings.clip_m, far_w_m=float(low[2]),
    )  # fmt: skip


def _align_heights(facades: list[Facade]) -> list[Facade]:
    """Give facades of similar height one vertical extent, so that their sheets match side by side."""
    if not facades:
        return facades
    low, high = min(f.v_min_m for f in facades), max(f.v_max_m for f in facades)
    return [
        replace(f, v_min_m=low, v_max_m=high) if f.v_max_m - f.v_min_m > _FULL_HEIGHT_SHARE * (high - low) else f
        for f in facades
    ]


def _name_facades(facades: list[Facade]) -> list[Facade]:
    """Name each facade by its compass direction, with a number where several face one direction."""
    directions = [_name_direction(f.azimuth_deg) for f in facades]
    named = []
    for i, facade in enumerate(facades):
        direction = directions[i]
        number = directions[: i + 1].count(direction)
        name = direction if directions.count(direction) == 1 else f"{direction} {number}"
        named.append(replace(facade, name=name))
    return named


def _name_direction(azimuth_deg: float) -> str:
    """The nearest of the eight compass directions."""
    return _COMPASS[round(azimuth_deg / 45.0) % 8]
