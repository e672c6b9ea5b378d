"""Which way the outer sides of a building's elements look."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from facadelake.building import BuildingModel
from facadelake.building.surface import Surface
from facadelake.core.arrays import Float64Array, Int64Array
from facadelake.core.camera import PosedCamera
from facadelake.reporting.elevations.visibility import check_visibility

COMPASS_DEG = {"N": 0.0, "NE": 45.0, "E": 90.0, "SE": 135.0, "S": 180.0, "SW": 225.0, "W": 270.0, "NW": 315.0}
_MIN_NET_AREA_SHARE = 0.3  # net over total area below which sides cancel one another
_MAX_TESTED_TRIANGLES = 20_000
_MAX_TESTING_CAMERAS = 150


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelTriangles:
    """Triangles of the model (n,): normal and centre in site, upright area (0 for what lies flat), element row."""

    normal: Float64Array
    area: Float64Array
    centre: Float64Array
    element: Int64Array


def collect_triangles(building: BuildingModel, surface: Surface) -> ModelTriangles:
    """The triangles of a building."""
    return ModelTriangles(
        normal=surface.normals_site,
        area=np.where(np.abs(surface.normals_site[:, 2]) < 0.35, surface.areas_m2, 0.0),
        centre=surface.vertices_site_m[surface.triangles].mean(axis=1),
        element=np.asarray(building.element_of_triangle, dtype=np.int64),
    )


def azimuth_of(vector: Float64Array) -> float:
    """Degrees clockwise from north of a direction (2,) or (3,) in site."""
    return float(np.degrees(np.arctan2(vector[0], vector[1])) % 360.0)


def turn_deg(a_deg: Float64Array | float, b_deg: Float64Array | float) -> Float64Array:
    """Smallest angle between azimuths, degrees."""
    return np.abs((np.asarray(a_deg) - b_deg + 180.0) % 360.0 - 180.0)


def read_element_azimuths(building: BuildingModel) -> list[float | None]:
    """The outward direction of each element as the model's tables say it, degrees: measured, else by its word."""
    words = building.elements.column("facade").to_pylist()
    measured = building.elements.column("facade_azimuth_deg").to_pylist()
    return [
        COMPASS_DEG.get(word) if azimuth is None else float(azimuth)
        for word, azimuth in zip(words, measured, strict=True)
    ]


def _measure_visible_area(
    walls: ModelTriangles, surface: Surface, posed: Mapping[str, PosedCamera], tolerance_m: float
) -> Float64Array:
    """Area of each triangle (n,) if any camera sees its centre from in front, else 0."""
    largest = np.argsort(-walls.area)[:_MAX_TESTED_TRIANGLES]
    largest = largest[walls.area[largest] > 0]
    seen = np.zeros(len(walls.area), dtype=bool)
    cameras = list(posed.values())
    for camera in cameras[:: max(1, len(cameras) // _MAX_TESTING_CAMERAS)]:
        ask = largest[~seen[largest]]
        if len(ask) == 0:
            break
        view = check_visibility(
            camera, surface, walls.centre[ask], walls.normal[ask], tolerance_m=tolerance_m, max_incidence_deg=80
        )
        seen[ask[view.visible]] = True
    return np.where(seen, walls.area, 0.0)


def _average_azimuth(normal: Float64Array, area: Float64Array) -> float:
    """Azimuth that triangles (n, 3), (n,) look in the mean, as on a curved wall; the largest's where they cancel."""
    mean = (normal * area[:, None]).sum(axis=0)
    if np.linalg.norm(mean) < _MIN_NET_AREA_SHARE * area.sum():
        mean = normal[np.argmax(area)]
    return azimuth_of(mean)


def estimate_element_azimuths(
    building: BuildingModel,
    walls: ModelTriangles,
    surface: Surface,
    posed: Mapping[str, PosedCamera],
    tolerance_m: float,
) -> tuple[Float64Array, Float64Array]:
    """Outward azimuth (elements,) in degrees, NaN where an element has none, and the area (elements,) that looks so.

    The model's own word (column facade) is kept unless the photographs see another side of the element: a wall has
    two sides, and round a courtyard only the cameras know which of them is outside.
    """
    seen_area = _measure_visible_area(walls, surface, posed, tolerance_m)
    count = len(building.elements)
    azimuth, area = np.full(count, np.nan), np.zeros(count)
    directions = read_element_azimuths(building)
    external = building.elements.column("is_external").to_pylist()
    order = np.argsort(walls.element, kind="stable")
    starts = np.searchsorted(walls.element[order], np.arange(count + 1))
    side = np.degrees(np.arctan2(walls.normal[:, 0], walls.normal[:, 1])) % 360.0
    for row in range(count):
        mine = order[starts[row] : starts[row + 1]]
        mine = mine[walls.area[mine] > 0]
        if len(mine) == 0 or (external[row] is False and not seen_area[mine].any()):
            continue
        told = directions[row]
        seen = seen_area[mine]
        if seen.any() and (told is None or seen[turn_deg(side[mine], told) <= 60].sum() < 0.25 * seen.sum()):
            told_deg = _average_azimuth(walls.normal[mine], seen)
        elif told is None:
            continue
        else:
            told_deg = told
        facing = mine[turn_deg(side[mine], told_deg) <= 60]
        if len(facing):
            azimuth[row] = azimuth_of((walls.normal[facing] * walls.area[facing, None]).sum(axis=0))
            area[row] = walls.area[facing].sum()
    return azimuth, area
