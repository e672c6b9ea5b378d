"""A building's facades: the clustered outward directions of its walls, each with a name by compass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from facadelake.building.facades.openness import COMPASS, INSIDE, LEVEL, compass_from_direction
from facadelake.core.arrays import Float64Array

_BIN_DEG = 0.5
_MEAN_HALF_WIDTH_DEG = 10.0  # walls within this of a direction make its mean
_FACADE_HALF_WIDTH_DEG = 20.0  # walls that turn by more than this from one another are two facades
_MIN_FACADE_SHARE = 0.02  # of all walls: less beside a larger facade is a return of it
_SECTOR_DEG = 45.0
_REAR_DEG = 112.5


@dataclass(frozen=True, kw_only=True)
class Facades:
    """The facades of one building: names, and outward azimuths in degrees clockwise from north."""

    names: tuple[str, ...]
    azimuths_deg: tuple[float, ...]

    def find_facade(self, normal_site: Float64Array) -> str:
        """The facade of a place whose surface looks along ``normal_site`` (3,); "level" where it is more up or down.

        It is the nearest facade of the same compass name, else the nearest within half a sector, else the compass.
        """
        compass = compass_from_direction(normal_site)
        if compass == LEVEL or not self.names:
            return compass
        apart = measure_turn_deg(np.array(self.azimuths_deg), azimuth_from_direction(normal_site))
        same = [number for number, name in enumerate(self.names) if _compass_from_name(name) == compass]
        if same:
            return self.names[min(same, key=lambda number: float(apart[number]))]
        nearest = int(np.argmin(apart))
        return self.names[nearest] if apart[nearest] <= _SECTOR_DEG / 2 else compass

    def assign_facade(self, element_facade: str, normal_site: Float64Array) -> str:
        """Facade of a place on an element, seen where its surface has ``normal_site`` (3,).

        It is the element's, so that a reveal counts with its wall, unless the place is on the element's other side or
        the element has no direction of its own: then it is the direction the place itself faces.
        """
        if element_facade not in self.names:
            return self.find_facade(normal_site)
        upright = float(np.hypot(normal_site[0], normal_site[1]))
        own = self.azimuths_deg[self.names.index(element_facade)]
        behind = upright > 0.5 and float(measure_turn_deg(own, azimuth_from_direction(normal_site))) > _REAR_DEG
        return self.find_facade(normal_site) if behind else element_facade


def collect_facades(elements: pa.Table) -> Facades:
    """The facades that a table ``elements`` names; one without an azimuth has its compass direction."""
    found: dict[str, float] = {}
    rows = zip(elements.column("facade").to_pylist(), elements.column("facade_azimuth_deg").to_pylist(), strict=True)
    for name, azimuth in rows:
        if azimuth is not None:
            found[name] = azimuth
        elif name in COMPASS:
            found.setdefault(name, _SECTOR_DEG * COMPASS.index(name))
    return Facades(names=tuple(found), azimuths_deg=tuple(found.values()))


def cluster_directions(azimuth_deg: Float64Array, area_m2: Float64Array) -> Float64Array:
    """Main outward directions (d,) in degrees of walls (n,) by their area, the largest first.

    Walls up to 20 degrees from a direction belong to it, so noise and small turns do not split a facade, wherever the
    compass's own sectors end. Directions that few walls have fall to a larger one within 45 degrees.
    """
    azimuth_deg, rest = _bin_azimuths(azimuth_deg, area_m2)
    total = rest.sum()
    found: list[float] = []
    while rest.sum() > 1e-9 * total:
        apart = measure_turn_deg(azimuth_deg[:, None], azimuth_deg[rest > 0][None])
        best = int(np.argmax(rest @ (apart <= _MEAN_HALF_WIDTH_DEG)))
        core = apart[:, best] <= _MEAN_HALF_WIDTH_DEG
        middle = np.radians(azimuth_deg[core])
        mean = float(np.degrees(np.arctan2(rest[core] @ np.sin(middle), rest[core] @ np.cos(middle))) % 360.0)
        claimed = measure_turn_deg(azimuth_deg, mean) <= _FACADE_HALF_WIDTH_DEG
        share = rest[claimed].sum() / total
        if share >= _MIN_FACADE_SHARE or not found or measure_turn_deg(np.array(found), mean).min() > _SECTOR_DEG:
            found.append(mean)
        rest[claimed | core] = 0.0
    return np.array(found)


def name_facades(azimuths_deg: Sequence[float] | Float64Array) -> tuple[str, ...]:
    """A name for each direction: its compass point, with its degrees ("N-350", "N-010") where two have the same."""
    points = [compass_from_direction(_direction_from_azimuth(float(azimuth))) for azimuth in azimuths_deg]
    return tuple(
        point if points.count(point) == 1 else f"{point}-{round(float(azimuth)) % 360:03d}"
        for point, azimuth in zip(points, azimuths_deg, strict=True)
    )


def azimuth_from_direction(direction_site: Float64Array) -> float:
    """Degrees clockwise from north of a direction (2,) or (3,) in site."""
    return float(np.degrees(np.arctan2(direction_site[0], direction_site[1])) % 360.0)


def measure_turn_deg(a_deg: Float64Array | float, b_deg: Float64Array | float) -> Float64Array:
    """Smallest angle between azimuths, degrees."""
    turned: Float64Array = np.abs((np.asarray(a_deg, dtype=np.float64) - b_deg + 180.0) % 360.0 - 180.0)
    return turned


def _bin_azimuths(azimuth_deg: Float64Array, area_m2: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Mean azimuth and area of the walls in each half degree that has any, so that many walls cost no more than few."""
    turned = np.asarray(azimuth_deg, dtype=np.float64) % 360.0
    count = int(360.0 / _BIN_DEG)
    step = np.floor(turned / _BIN_DEG).astype(np.int64) % count
    area: Float64Array = np.bincount(step, weights=area_m2, minlength=count).astype(np.float64)
    mean: Float64Array = np.bincount(step, weights=area_m2 * turned, minlength=count).astype(np.float64)
    used = area > 0
    return mean[used] / area[used], area[used]


def _direction_from_azimuth(azimuth_deg: float) -> Float64Array:
    angle = np.radians(azimuth_deg)
    return np.array([np.sin(angle), np.cos(angle), 0.0])


def _compass_from_name(name: str) -> str:
    return name if name in (LEVEL, INSIDE) else name.split("-")[0]
