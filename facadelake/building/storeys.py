"""Find the storey of a point on the building."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from facadelake.core.arrays import Float64N, Float64Nx2, RowIndices

_FLOOR_TOLERANCE_M = 0.1  # a point may be this far below the floor of its storey
_OVERLAP_LIMIT_M = 1.0  # an element that extends farther beyond its storey belongs to several


@dataclass(frozen=True, kw_only=True)
class StoreyElevation:
    """A storey of the portfolio and the height of its floor in the building's vertical datum, metres."""

    name: str
    floor_m: float


@dataclass(frozen=True, kw_only=True)
class StoreyLevel:
    """A storey and the z of its floor in site, metres; ``building`` is the label of its IfcBuilding, if any."""

    name: str
    floor_site_m: float
    building: str = ""


def find_storey(levels: Sequence[StoreyLevel], z_site_m: float) -> str:
    """Find the highest storey whose floor is at or below ``z_site_m``; the lowest storey for points below all floors.

    ``levels`` are sorted by level. Returns "" if there are none.
    """
    below = [level.name for level in levels if level.floor_site_m <= z_site_m + _FLOOR_TOLERANCE_M]
    if below:
        return below[-1]
    return levels[0].name if levels else ""


def find_storeys(
    levels: Sequence[StoreyLevel],
    element_storeys: Sequence[str | None],
    extents_site_m: Float64Nx2,
    element: RowIndices,
    z_site_m: Float64N,
) -> list[str | None]:
    """Find the storeys of n points on elements.

    A point has the storey of its element. If the element extends into other storeys of its building, as a curtain wall
    does, the point's level decides.

    Args:
        levels: levels of the storeys, sorted.
        element_storeys: storey of each element (elements); None: no storey.
        extents_site_m: lowest and highest z of each element in site (elements, 2).
        element: row of each point's element (n,).
        z_site_m: z of each point in site (n,).

    Returns:
        Storey of each point (n).
    """
    levels_of_storey = {level.name: [one for one in levels if one.building == level.building] for level in levels}
    levels_of_element = [levels_of_storey.get(storey or "", []) for storey in element_storeys]
    is_multi_storey = [
        _is_multi_storey(own, storey, extent)
        for own, storey, extent in zip(levels_of_element, element_storeys, extents_site_m, strict=True)
    ]
    return [
        find_storey(levels_of_element[i], z) if is_multi_storey[i] else element_storeys[i]
        for i, z in zip(element.tolist(), z_site_m.tolist(), strict=True)
    ]


def _is_multi_storey(levels: Sequence[StoreyLevel], name: str | None, extent: Float64N) -> bool:
    """Whether an element of storey ``name`` with lowest and highest z ``extent`` (2,) extends into other storeys."""
    indices = [i for i, level in enumerate(levels) if level.name == name]
    if not indices:
        return False
    floor = levels[indices[0]].floor_site_m
    above = [level.floor_site_m for level in levels if level.floor_site_m > floor + _FLOOR_TOLERANCE_M]
    low_in_another = indices[0] > 0 and extent[0] < floor - _OVERLAP_LIMIT_M
    return bool(low_in_another or (above and extent[1] > above[0] + _OVERLAP_LIMIT_M))
