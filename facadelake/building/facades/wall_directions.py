"""The walls of each facade: outward triangles of the model, by the rule of the tables and by the photographs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from facadelake.building.facades.directions import azimuth_from_direction, collect_facades, measure_turn_deg
from facadelake.building.model import BuildingModel
from facadelake.building.surface.raycasting import Surface
from facadelake.building.surface.visibility import check_visibility
from facadelake.core.arrays import Float64N, Float64Nx3, RowIndices
from facadelake.core.camera import PosedCamera
from facadelake.core.frames import compute_facade_axes

_MIN_NET_AREA_SHARE = 0.3  # length of the area-weighted mean normal below which the sides cancel
_SIDE_DEG = 60.0  # triangles within this angle of a wall's outward direction are its outer side
_MAX_TESTED_TRIANGLES = 20_000
_MAX_TESTING_CAMERAS = 150


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelTriangles:
    """Triangles of the model: outward normal and centroid in site, area, row of the element.

    ``area`` in square metres is 0 for triangles more than about 20 degrees from vertical.
    """

    normal: Float64Nx3
    area: Float64N
    centre: Float64Nx3
    element: RowIndices


def collect_triangles(building: BuildingModel, surface: Surface) -> ModelTriangles:
    """The triangles of a building model."""
    return ModelTriangles(
        normal=surface.normals_site,
        area=np.where(np.abs(surface.normals_site[:, 2]) < 0.35, surface.areas_m2, 0.0),
        centre=surface.vertices_site_m[surface.triangles].mean(axis=1),
        element=np.asarray(building.element_of_triangle, dtype=np.int64),
    )


def _measure_visible_area(
    walls: ModelTriangles, surface: Surface, posed: Mapping[str, PosedCamera], tolerance_m: float
) -> Float64N:
    """Area (n,) of each triangle whose centroid is visible from the front in a photograph; 0 for the others."""
    largest = np.argsort(-walls.area)[:_MAX_TESTED_TRIANGLES]
    largest = largest[walls.area[largest] > 0]
    visible = np.zeros(len(walls.area), dtype=bool)
    cameras = list(posed.values())
    for camera in cameras[:: max(1, len(cameras) // _MAX_TESTING_CAMERAS)]:
        rows = largest[~visible[largest]]
        if len(rows) == 0:
            break
        view = check_visibility(
            camera, surface, walls.centre[rows], walls.normal[rows], tolerance_m=tolerance_m, max_incidence_deg=80
        )
        visible[rows[view.visible]] = True
    return np.where(visible, walls.area, 0.0)


def _average_azimuth(normal: Float64Nx3, area: Float64N) -> float:
    """Azimuth of the area-weighted mean normal, in degrees; of the largest triangle where the normals cancel."""
    mean = (normal * area[:, None]).sum(axis=0)
    if np.linalg.norm(mean) < _MIN_NET_AREA_SHARE * area.sum():
        mean = normal[np.argmax(area)]
    return azimuth_from_direction(mean)


def find_facade_triangles(
    building: BuildingModel,
    walls: ModelTriangles,
    surface: Surface,
    posed: Mapping[str, PosedCamera],
    tolerance_m: float,
) -> dict[str, RowIndices]:
    """The outward triangles of each facade, by the rule that fills column ``facade`` of the tables.

    A facade of table ``elements`` is kept for an element unless the photographs show another side of it: a wall has two
    sides, and around a courtyard the model alone does not determine the outer one. Of an element that faces several
    facades, such as a round corner, each triangle that photographs show belongs to the facade that it faces.

    Args:
        building: building model.
        walls: its triangles.
        surface: its surface, for ray casting.
        posed: cameras with poses, by photo_id.
        tolerance_m: a surface up to this distance in front of a point does not hide it, metres.

    Returns:
        Rows of ``walls`` by the facade's name in column ``facade``.
    """
    visible_area = _measure_visible_area(walls, surface, posed, tolerance_m)
    facades = collect_facades(building.elements)
    names = building.elements.column("facade").to_pylist()
    external = building.elements.column("is_external").to_pylist()
    order = np.argsort(walls.element, kind="stable")
    starts = np.searchsorted(walls.element[order], np.arange(len(names) + 1))
    side = np.degrees(np.arctan2(walls.normal[:, 0], walls.normal[:, 1])) % 360.0
    found: dict[str, list[RowIndices]] = {}
    for row, name in enumerate(names):
        own = order[starts[row] : starts[row + 1]]
        own = own[walls.area[own] > 0]
        if len(own) == 0 or (external[row] is False and not visible_area[own].any()):
            continue
        visible = visible_area[own]
        stated_deg = facades.get_azimuth_deg(name)
        if stated_deg is None:
            for triangle in own[visible > 0].tolist():
                facade = facades.assign_facade(name, walls.normal[triangle])
                found.setdefault(facade, []).append(np.array([triangle]))
            continue
        outward_deg = stated_deg
        is_stated_side = measure_turn_deg(side[own], stated_deg) <= _SIDE_DEG
        if visible.any() and visible[is_stated_side].sum() < 0.25 * visible.sum():
            outward_deg = _average_azimuth(walls.normal[own], visible)
        outward = compute_facade_axes(outward_deg)[2]
        facade = facades.assign_facade(name, outward)
        found.setdefault(facade, []).append(own[measure_turn_deg(side[own], outward_deg) <= _SIDE_DEG])
    return {name: np.concatenate(parts) for name, parts in found.items() if sum(map(len, parts))}
