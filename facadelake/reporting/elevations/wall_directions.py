"""Outward directions of a building's elements, from the model and from the photographs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from facadelake.building import BuildingModel
from facadelake.building.facades import COMPASS, azimuth_from_direction, measure_turn_deg
from facadelake.building.surface import Surface
from facadelake.core.arrays import Float64N, Float64Nx3, RowIndices
from facadelake.core.camera import PosedCamera
from facadelake.reporting.elevations.visibility import check_visibility

COMPASS_DEG = {name: 45.0 * index for index, name in enumerate(COMPASS)}
_MIN_NET_AREA_SHARE = 0.3  # length of the area-weighted mean normal below which the sides cancel
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


def read_element_azimuths(building: BuildingModel) -> list[float | None]:
    """Outward azimuth of each element in degrees from table ``elements``: measured, else from the facade's name."""
    names = building.elements.column("facade").to_pylist()
    measured = building.elements.column("facade_azimuth_deg").to_pylist()
    return [
        COMPASS_DEG.get(name) if azimuth is None else float(azimuth)
        for name, azimuth in zip(names, measured, strict=True)
    ]


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


def estimate_element_azimuths(
    building: BuildingModel,
    walls: ModelTriangles,
    surface: Surface,
    posed: Mapping[str, PosedCamera],
    tolerance_m: float,
) -> tuple[Float64N, Float64N]:
    """Outward azimuth of each element, and the area of its triangles that face this direction.

    The azimuth of table ``elements`` is kept unless the photographs show another side of the element: a wall has two
    sides, and around a courtyard the model alone does not determine the outer one.

    Args:
        building: building model.
        walls: its triangles.
        surface: its surface, for ray casting.
        posed: cameras with poses, by photo_id.
        tolerance_m: a surface up to this distance in front of a point does not hide it, metres.

    Returns:
        Azimuths (elements,) in degrees clockwise from north, NaN where there is none, and areas (elements,) in square
        metres.
    """
    visible_area = _measure_visible_area(walls, surface, posed, tolerance_m)
    count = len(building.elements)
    azimuth, area = np.full(count, np.nan), np.zeros(count)
    directions = read_element_azimuths(building)
    external = building.elements.column("is_external").to_pylist()
    order = np.argsort(walls.element, kind="stable")
    starts = np.searchsorted(walls.element[order], np.arange(count + 1))
    side = np.degrees(np.arctan2(walls.normal[:, 0], walls.normal[:, 1])) % 360.0
    for row in range(count):
        own = order[starts[row] : starts[row + 1]]
        own = own[walls.area[own] > 0]
        if len(own) == 0 or (external[row] is False and not visible_area[own].any()):
            continue
        stated_deg = directions[row]
        visible = visible_area[own]
        if visible.any() and (
            stated_deg is None or visible[measure_turn_deg(side[own], stated_deg) <= 60].sum() < 0.25 * visible.sum()
        ):
            outward_deg = _average_azimuth(walls.normal[own], visible)
        elif stated_deg is None:
            continue
        else:
            outward_deg = stated_deg
        facing = own[measure_turn_deg(side[own], outward_deg) <= 60]
        if len(facing):
            azimuth[row] = azimuth_from_direction((walls.normal[facing] * walls.area[facing, None]).sum(axis=0))
            area[row] = walls.area[facing].sum()
    return azimuth, area
