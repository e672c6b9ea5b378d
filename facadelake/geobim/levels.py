"""Storeys as the IFC has them, and which of them an element belongs to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import ifcopenshell
import ifcopenshell.util.element
import ifcopenshell.util.placement
import ifcopenshell.util.unit

from facadelake.geobim.hosts import building_of, container_of, host_of

CONTAINMENT, HOST, ELEVATION = "containment", "host", "elevation"
_RISE_M = 0.1  # an element may begin this far below its storey's level


@dataclass(frozen=True, kw_only=True)
class Storey:
    """A storey, the level of its floor in the model's axes in metres, and the GlobalId of its IfcBuilding, if any."""

    name: str
    level_m: float
    building: str = ""


@dataclass(frozen=True, kw_only=True)
class StoreyOf:
    """An element's storey and where that was read from; both empty where there is none."""

    name: str
    source: str


def storeys_of(model: ifcopenshell.file, building_guid: str = "") -> list[Storey]:
    """The model's storeys from the lowest up; those of one IfcBuilding where it is named by its GlobalId.

    A storey stands where its placement is; its Elevation counts where placements are missing or all the same, as in
    files whose writer left them at zero.
    """
    unit_m = float(ifcopenshell.util.unit.calculate_unit_scale(model))
    found = model.by_type("IfcBuildingStorey")
    placed = [_placed_level(storey) for storey in found]
    elevations = {float(storey.Elevation or 0.0) for storey in found}
    same_place = len(set(placed)) == 1 and len(elevations) > 1
    storeys = []
    for storey, level in zip(found, placed, strict=True):
        building = building_of(storey)
        own = building.GlobalId if building is not None else ""
        if building_guid and own and own != building_guid:
            continue
        said = float(storey.Elevation or 0.0) if level is None or same_place else level
        storeys.append(Storey(name=_name(storey), level_m=said * unit_m, building=own))
    return sorted(storeys, key=lambda storey: (storey.level_m, storey.name))


def storey_of(element: ifcopenshell.entity_instance, storeys: Sequence[Storey], bottom_ifc_m: float) -> StoreyOf:
    """The element's storey by containment, else its host's, else by ``bottom_ifc_m``, its lowest point's level."""
    contained = _container_storey(element)
    if contained:
        return StoreyOf(name=contained, source=CONTAINMENT)
    host, seen = host_of(element), {element.id()}
    while host is not None and host.id() not in seen:
        seen.add(host.id())
        contained = _container_storey(host)
        if contained:
            return StoreyOf(name=contained, source=HOST)
        host = host_of(host)
    building = building_of(element)
    near = [storey for storey in storeys if building is None or storey.building in ("", building.GlobalId)] or storeys
    if not near:
        return StoreyOf(name="", source="")
    below = [storey for storey in near if storey.level_m <= bottom_ifc_m + _RISE_M]
    return StoreyOf(name=(below[-1] if below else near[0]).name, source=ELEVATION)


def _placed_level(storey: ifcopenshell.entity_instance) -> float | None:
    """Level of the storey's placement in the model's unit; None where it has none."""
    if storey.ObjectPlacement is None:
        return None
    return float(ifcopenshell.util.placement.get_local_placement(storey.ObjectPlacement)[2, 3])


def _container_storey(element: ifcopenshell.entity_instance) -> str:
    holder = container_of(element)
    while holder is not None:
        if holder.is_a("IfcBuildingStorey"):
            return _name(holder)
        holder = ifcopenshell.util.element.get_aggregate(holder)
    return ""


def _name(storey: ifcopenshell.entity_instance) -> str:
    return str(storey.Name or storey.LongName or storey.GlobalId)
