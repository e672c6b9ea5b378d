"""Facades to be drawn as elevations: those of column ``facade`` of the tables, split by depth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from facadelake.building import BuildingModel
from facadelake.building.facades import ModelTriangles, collect_facades, collect_triangles, find_facade_triangles
from facadelake.building.surface import Surface
from facadelake.core.arrays import Float64Nx3, Float64x3, Float64x3x3, RowIndices
from facadelake.core.camera import PosedCamera
from facadelake.core.frames import COMPASS, compute_facade_axes, facade_from_site
from facadelake.reporting.inspection import PictureSettings

_WORDS = ("North", "North-east", "East", "South-east", "South", "South-west", "West", "North-west")
DIRECTIONS = dict(zip(COMPASS, _WORDS, strict=True))
_FULL_HEIGHT_SHARE = 0.6  # facades of at least this share of the total height get a common vertical extent
_DEPTH_TOLERANCE_M = 1.5  # a defect farther behind the rearmost wall of a view is not in it
_MIN_VISIBLE_SHARE = 0.3  # of an element's area, for the element to belong to the front layer


@dataclass(frozen=True, kw_only=True, eq=False)
class Facade:
    """The picture plane of an elevation in frame ``facade``: ``u`` to the viewer's right, ``v`` up, ``w`` outward.

    ``code``: name in column ``facade`` of the tables, such as "SE" or "E-075". ``part``: number of the view where the
    facade has several, one behind another; else 0. Coordinates are in metres from the site's origin. ``near_w_m`` is
    the plane where the view begins, ``far_w_m`` the rearmost point of its walls.
    """

    code: str
    part: int
    azimuth_deg: float
    area_m2: float
    u_min_m: float
    u_max_m: float
    v_min_m: float
    v_max_m: float
    near_w_m: float
    far_w_m: float

    @property
    def name(self) -> str:
        """The code, with the number of the view where there are several: "SE" or "SE_2"."""
        return f"{self.code}_{self.part}" if self.part else self.code

    @property
    def title(self) -> str:
        """The name in titles: "South-east facade (SE)", or "North facade (N), view 2"."""
        title = f"{DIRECTIONS[self.code.partition('-')[0]]} facade ({self.code})"
        return f"{title}, view {self.part}" if self.part else title

    @property
    def axes_site(self) -> Float64x3x3:
        """Unit vectors u, v, w in site as rows; right-handed, so that the elevation is not mirrored."""
        return compute_facade_axes(self.azimuth_deg)

    def uvw_from_site(self, xyz_site_m: Float64Nx3) -> Float64Nx3:
        """Coordinates u, v, w of points of site, metres."""
        return facade_from_site(xyz_site_m, self.azimuth_deg)


def _split_by_depth(
    outward: Float64x3, members: RowIndices, walls: ModelTriangles, surface: Surface, settings: PictureSettings
) -> list[RowIndices]:
    """Split triangles that face one direction into layers where some hide others, as in a courtyard; front first."""
    depth = walls.centre @ outward
    layers: list[RowIndices] = []
    remaining = members
    while len(remaining):
        start = depth[remaining].max() + settings.clip_m
        origins = walls.centre[remaining] + (start - depth[remaining])[:, None] * outward
        hits = surface.cast(origins, np.broadcast_to(-outward, origins.shape).copy())
        is_visible = np.abs(hits.distance_m - (start - depth[remaining])) <= settings.visibility_tolerance_m
        owner, area = walls.element[remaining], walls.area[remaining]
        total, shown = np.bincount(owner, area), np.bincount(owner, area * is_visible)
        is_front = (shown >= _MIN_VISIBLE_SHARE * np.maximum(total, 1e-9))[owner]
        if not is_front.any():
            is_front[:] = True
        layers.append(remaining[is_front])
        remaining = remaining[~is_front]
    return layers


def find_facades(
    building: BuildingModel,
    surface: Surface,
    posed: Mapping[str, PosedCamera],
    positions_site_m: Mapping[str, Float64Nx3],
    settings: PictureSettings,
) -> list[Facade]:
    """Facades to be drawn, clockwise from north: the main ones, and smaller ones that carry a defect.

    Args:
        building: building model.
        surface: its surface, for ray casting.
        posed: cameras with poses, by photo_id; they show which side of a wall is outside.
        positions_site_m: positions of defects by column ``facade`` of table ``defects``.
        settings: smallest share of a facade, distance of the view plane, tolerance of visibility.

    Returns:
        The facades, named as in column ``facade``.
    """
    walls = collect_triangles(building, surface)
    directions = collect_facades(building.elements)
    triangles = find_facade_triangles(building, walls, surface, posed, settings.visibility_tolerance_m)
    total_m2 = sum(walls.area[rows].sum() for rows in triangles.values())
    facades: list[Facade] = []
    for code, members in triangles.items():
        azimuth_deg = directions.get_azimuth_deg(code)
        if azimuth_deg is None:
            continue
        layers = _split_by_depth(compute_facade_axes(azimuth_deg)[2], members, walls, surface, settings)
        views = [_create_view(code, azimuth_deg, rows, walls, surface, settings) for rows in layers]
        defects = positions_site_m.get(code, np.zeros((0, 3)))
        with_defects = {choose_view(views, xyz) for xyz in defects}
        kept = [
            view
            for index, view in enumerate(views)
            if view.area_m2 >= settings.min_facade_share * total_m2 or index in with_defects
        ]
        facades += [replace(view, part=part) for part, view in enumerate(kept, start=1)] if len(kept) > 1 else kept
    facades.sort(key=lambda f: (f.azimuth_deg, f.part))
    return _align_heights(facades)


def choose_view(views: Sequence[Facade], xyz_site_m: Float64x3) -> int | None:
    """Index of the view of one facade in which a point of site is; None where it is in none.

    Of views one behind another, it is the foremost one whose rearmost wall is not before the point.
    """
    found: list[tuple[float, int]] = []
    for index, view in enumerate(views):
        u, v, w = view.uvw_from_site(xyz_site_m[None])[0]
        inside = view.u_min_m <= u <= view.u_max_m and view.v_min_m <= v <= view.v_max_m
        if inside and view.far_w_m - _DEPTH_TOLERANCE_M <= w <= view.near_w_m:
            found.append((max(view.far_w_m - float(w), 0.0), index))
    return min(found)[1] if found else None


def _create_view(
    code: str,
    azimuth_deg: float,
    triangles: RowIndices,
    walls: ModelTriangles,
    surface: Surface,
    settings: PictureSettings,
) -> Facade:
    """A view of a facade, whose extents contain its triangles with a margin.

    Args:
        code: name of the facade in column ``facade``.
        azimuth_deg: outward direction.
        triangles: rows of ``walls``.
        walls: triangles of the model.
        surface: its surface.
        settings: distance of the view plane.
    """
    corners = surface.vertices_site_m[np.unique(surface.triangles[triangles])]
    uvw = facade_from_site(corners, azimuth_deg)
    low, high = uvw.min(axis=0), uvw.max(axis=0)
    return Facade(
        code=code, part=0, azimuth_deg=azimuth_deg, area_m2=float(walls.area[triangles].sum()),
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
