"""Facades of a building: clusters of the outward directions of its walls, named by compass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from facadelake.building.facades.openness import INSIDE, LEVEL, compass_from_direction, find_open_sides
from facadelake.building.surface.raycasting import Surface
from facadelake.core.arrays import Float64Array, Float64N, Float64x3, RowIndices
from facadelake.core.frames import COMPASS

_BIN_DEG = 0.5
_MEAN_HALF_WIDTH_DEG = 10.0  # a facade's direction is the mean of walls within this
_FACADE_HALF_WIDTH_DEG = 20.0  # walls within this of a facade's direction belong to it
_MIN_FACADE_SHARE = 0.02  # less of the wall area, near a larger facade, is a return of that facade
_SECTOR_DEG = 45.0
_REAR_DEG = 112.5


@dataclass(frozen=True, kw_only=True)
class Facades:
    """The facades of one building: names, and outward azimuths in degrees clockwise from north."""

    names: tuple[str, ...]
    azimuths_deg: tuple[float, ...]

    def get_azimuth_deg(self, name: str) -> float | None:
        """Outward azimuth of a facade in degrees; of a compass point where no element has it; None for "level"."""
        if name in self.names:
            return self.azimuths_deg[self.names.index(name)]
        return _SECTOR_DEG * COMPASS.index(name) if name in COMPASS else None

    def find_facade(self, normal_site: Float64x3) -> str:
        """Find the facade that faces along ``normal_site`` (3,); "level" if that is closer to the vertical.

        It is the nearest facade of the same compass name, else the nearest within half a sector, else the compass name.
        """
        compass = compass_from_direction(normal_site)
        if compass == LEVEL or not self.names:
            return compass
        turn_deg = measure_turn_deg(np.array(self.azimuths_deg), azimuth_from_direction(normal_site))
        same = [number for number, name in enumerate(self.names) if _compass_from_name(name) == compass]
        if same:
            return self.names[min(same, key=lambda number: float(turn_deg[number]))]
        nearest = int(np.argmin(turn_deg))
        return self.names[nearest] if turn_deg[nearest] <= _SECTOR_DEG / 2 else compass

    def assign_facade(self, element_facade: str, normal_site: Float64x3) -> str:
        """Facade of a point on an element of ``element_facade`` where the surface has ``normal_site`` (3,).

        It is the element's facade, so that a reveal belongs to its wall. If the point is on the element's rear side, or
        the element has no direction, it is the facade that the normal faces.
        """
        if element_facade not in self.names:
            return self.find_facade(normal_site)
        upright = float(np.hypot(normal_site[0], normal_site[1]))
        own = self.azimuths_deg[self.names.index(element_facade)]
        is_rear = upright > 0.5 and float(measure_turn_deg(own, azimuth_from_direction(normal_site))) > _REAR_DEG
        return self.find_facade(normal_site) if is_rear else element_facade


@dataclass(frozen=True, kw_only=True)
class FacadeAssignment:
    """An element's facade and its outward azimuth in degrees; None for "level", "inside" and "around"."""

    name: str
    azimuth_deg: float | None


def collect_facades(elements: pa.Table) -> Facades:
    """Collect the facades named in a table ``elements``; a facade without an azimuth has its compass direction."""
    found: dict[str, float] = {}
    rows = zip(elements.column("facade").to_pylist(), elements.column("facade_azimuth_deg").to_pylist(), strict=True)
    for name, azimuth in rows:
        if azimuth is not None:
            found[name] = azimuth
        elif name in COMPASS:
            found.setdefault(name, _SECTOR_DEG * COMPASS.index(name))
    return Facades(names=tuple(found), azimuths_deg=tuple(found.values()))


def cluster_directions(azimuth_deg: Float64N, area_m2: Float64N) -> Float64N:
    """Cluster the outward directions of walls (n,), weighted by area; main directions (d,) in degrees, largest first.

    Walls within 20 degrees of a direction belong to it, so that neither noise nor the limits of compass sectors split a
    facade. A direction with little area is dropped if a larger one is within 45 degrees.
    """
    azimuth_deg, rest = _bin_azimuths(azimuth_deg, area_m2)
    total = rest.sum()
    found: list[float] = []
    while rest.sum() > 1e-9 * total:
        turn_deg = measure_turn_deg(azimuth_deg[:, None], azimuth_deg[rest > 0][None])
        best = int(np.argmax(rest @ (turn_deg <= _MEAN_HALF_WIDTH_DEG)))
        core = turn_deg[:, best] <= _MEAN_HALF_WIDTH_DEG
        angle = np.radians(azimuth_deg[core])
        mean = float(np.degrees(np.arctan2(rest[core] @ np.sin(angle), rest[core] @ np.cos(angle))) % 360.0)
        members = measure_turn_deg(azimuth_deg, mean) <= _FACADE_HALF_WIDTH_DEG
        share = rest[members].sum() / total
        if share >= _MIN_FACADE_SHARE or not found or measure_turn_deg(np.array(found), mean).min() > _SECTOR_DEG:
            found.append(mean)
        rest[members | core] = 0.0
    return np.array(found)


def name_facades(azimuths_deg: Sequence[float] | Float64Array) -> tuple[str, ...]:
    """Name each direction by its compass point, with degrees ("N-350", "N-010") where two have the same."""
    points = [compass_from_direction(_direction_from_azimuth(float(azimuth))) for azimuth in azimuths_deg]
    return tuple(
        point if points.count(point) == 1 else f"{point}-{round(float(azimuth)) % 360:03d}"
        for point, azimuth in zip(points, azimuths_deg, strict=True)
    )


def find_facades(surface: Surface, element_of_triangle: RowIndices, elements: int) -> list[FacadeAssignment]:
    """Find the facade of each element by clustering the outward directions of its open sides."""
    sides = find_open_sides(surface, element_of_triangle, elements)
    has_direction = np.isfinite(sides.azimuth_deg)
    directions = cluster_directions(sides.azimuth_deg[has_direction], sides.area_m2[has_direction])
    names = name_facades(directions)
    assignments = []
    for label, azimuth in zip(sides.labels, sides.azimuth_deg, strict=True):
        if label:
            assignments.append(FacadeAssignment(name=label, azimuth_deg=None))
        else:
            nearest = int(np.argmin(measure_turn_deg(directions, float(azimuth))))
            assignments.append(
                FacadeAssignment(name=names[nearest], azimuth_deg=round(float(directions[nearest]), 2) % 360.0)
            )
    return assignments


def azimuth_from_direction(direction_site: Float64Array) -> float:
    """Azimuth, degrees clockwise from north, of a direction (2,) or (3,) in site."""
    return float(np.degrees(np.arctan2(direction_site[0], direction_site[1])) % 360.0)


def measure_turn_deg(a_deg: Float64Array | float, b_deg: Float64Array | float) -> Float64Array:
    """Smallest angle between azimuths, degrees."""
    turn_deg: Float64Array = np.abs((np.asarray(a_deg, dtype=np.float64) - b_deg + 180.0) % 360.0 - 180.0)
    return turn_deg


def _bin_azimuths(azimuth_deg: Float64N, area_m2: Float64N) -> tuple[Float64N, Float64N]:
    """Mean azimuth and area of the walls in each bin of half a degree, which limits the cost of many walls."""
    azimuth = np.asarray(azimuth_deg, dtype=np.float64) % 360.0
    count = int(360.0 / _BIN_DEG)
    index = np.floor(azimuth / _BIN_DEG).astype(np.int64) % count
    area: Float64N = np.bincount(index, weights=area_m2, minlength=count).astype(np.float64)
    mean: Float64N = np.bincount(index, weights=area_m2 * azimuth, minlength=count).astype(np.float64)
    used = area > 0
    return mean[used] / area[used], area[used]


def _direction_from_azimuth(azimuth_deg: float) -> Float64x3:
    angle = np.radians(azimuth_deg)
    return np.array([np.sin(angle), np.cos(angle), 0.0])


def _compass_from_name(name: str) -> str:
    return name if name in (LEVEL, INSIDE) else name.split("-")[0]
