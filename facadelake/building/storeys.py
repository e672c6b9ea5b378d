"""Which storey a place on the building belongs to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from facadelake.core.arrays import Float64Array, Int64Array

_FLOOR_TOLERANCE_M = 0.1  # a place may lie this far below its storey's floor
_OVERLAP_LIMIT_M = 1.0  # an element that reaches further than this beyond its storey spans several


@dataclass(frozen=True, kw_only=True)
class StoreyElevation:
    """A storey and the height of its floor in the building's vertical datum, as the registry tells it."""

    name: str
    floor_m: float


@dataclass(frozen=True, kw_only=True)
class StoreyLevel:
    """A storey and the level of its floor in site, metres."""

    name: str
    floor_site_m: float


def find_storey(levels: Sequence[StoreyLevel], z_site_m: float) -> str:
    """Name of the highest storey whose floor lies at or below ``z_site_m``; the lowest for places under all of them.

    ``levels`` come from the lowest up; empty where the model has no storeys.
    """
    below = [level.name for level in levels if level.floor_site_m <= z_site_m + _FLOOR_TOLERANCE_M]
    if below:
        return below[-1]
    return levels[0].name if levels else ""


def find_storeys(
    levels: Sequence[StoreyLevel],
    named: Sequence[str | None],
    extents_site_m: Float64Array,
    element: Int64Array,
    z_site_m: Float64Array,
) -> list[str | None]:
    """Storey (n) of places at ``z_site_m`` (n,) on ``element`` (n,).

    It is the element's own (``named``, one an element), save where the element, from ``extents_site_m`` (elements, 2:
    lowest and highest level), reaches into other storeys, as a curtain wall does: there the place's level decides.
    """
    spans = [_is_multi_storey(levels, name, extent) for name, extent in zip(named, extents_site_m, strict=True)]
    return [
        find_storey(levels, z) if spans[i] else named[i]
        for i, z in zip(element.tolist(), z_site_m.tolist(), strict=True)
    ]


def _is_multi_storey(levels: Sequence[StoreyLevel], name: str | None, extent: Float64Array) -> bool:
    places = [i for i, level in enumerate(levels) if level.name == name]
    if not places:
        return False
    floor = levels[places[0]].floor_site_m
    above = [level.floor_site_m for level in levels if level.floor_site_m > floor + _FLOOR_TOLERANCE_M]
    low_in_another = places[0] > 0 and extent[0] < floor - _OVERLAP_LIMIT_M
    return bool(low_in_another or (above and extent[1] > above[0] + _OVERLAP_LIMIT_M))
