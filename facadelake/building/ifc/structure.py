"""The IFC's spatial structure: hosts, containers, buildings, and the storey an element belongs to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import ifcopenshell
import ifcopenshell.util.element
import ifcopenshell.util.placement
import ifcopenshell.util.unit

from facadelake.core.errors import ModelError


def find_host(element: ifcopenshell.entity_instance) -> ifcopenshell.entity_instance | None:
    """The element whose opening this one fills, or that it is a part of (a plate's curtain wall); None without."""
    for filling in getattr(element, "FillsVoids", None) or ():
        for voiding in filling.RelatingOpeningElement.VoidsElements or ():
            return voiding.RelatingBuildingElement
    whole = ifcopenshell.util.element.get_aggregate(element) or ifcopenshell.util.element.get_nest(element)
    return whole if whole is not None and whole.is_a("IfcElement") else None


def find_container(element: ifcopenshell.entity_instance) -> ifcopenshell.entity_instance | None:
    """The spatial element that holds ``element`` itself; None where it is held by nothing or by another element."""
    for containing in getattr(element, "ContainedInStructure", None) or ():
        return containing.RelatingStructure
    return None


def find_building(element: ifcopenshell.entity_instance) -> ifcopenshell.entity_instance | None:
    """The IfcBuilding that an element, its host or a storey lies in; None where there is none."""
    seen: set[int] = set()
    holder = element
    while holder is not None and holder.id() not in seen:
        seen.add(holder.id())
        if holder.is_a("IfcBuilding"):
            return holder
        holder = find_container(holder) or find_host(holder) or ifcopenshell.util.element.get_aggregate(holder)
    return None


def get_building(model: ifcopenshell.file, name: str) -> ifcopenshell.entity_instance:
    """The IfcBuilding of that GlobalId, Name or LongName. Raises ModelError, with those there are, for none or many."""
    buildings = model.by_type("IfcBuilding")
    found = [building for building in buildings if name in (building.GlobalId, building.Name, building.LongName)]
    if len(found) != 1:
        known = ", ".join(f"'{label_building(building)}' ({building.GlobalId})" for building in buildings) or "none"
        raise ModelError(
            f"the registry's model_building '{name}' names {len(found)} of the IFC's buildings; it has {known}; "
            "give one of these names or GlobalIds"
        )
    return found[0]


def label_building(building: ifcopenshell.entity_instance) -> str:
    """What people call the building."""
    return str(building.Name or building.LongName or building.GlobalId)


CONTAINMENT, HOST, ELEVATION = "containment", "host", "elevation"
_FLOOR_TOLERANCE_M = 0.1  # an element may begin this far below its storey's level


@dataclass(frozen=True, kw_only=True)
class IfcStorey:
    """A storey, the level of its floor in the model's axes in metres, and the GlobalId of its IfcBuilding, if any."""

    name: str
    level_m: float
    building: str = ""


@dataclass(frozen=True, kw_only=True)
class StoreyAssignment:
    """An element's storey and where that was read from; both empty where there is none."""

    name: str
    source: str


def read_storeys(model: ifcopenshell.file, building_guid: str = "") -> list[IfcStorey]:
    """The model's storeys from the lowest up; those of one IfcBuilding where it is named by its GlobalId.

    A storey stands where its placement is; its Elevation counts where placements are missing or all the same, as in
    files whose writer left them at zero.
    """
    unit_m = float(ifcopenshell.util.unit.calculate_unit_scale(model))
    found = model.by_type("IfcBuildingStorey")
    placed = [_read_placement_level(storey) for storey in found]
    elevations = {float(storey.Elevation or 0.0) for storey in found}
    same_place = len(set(placed)) == 1 and len(elevations) > 1
    storeys = []
    for storey, level in zip(found, placed, strict=True):
        building = find_building(storey)
        own = building.GlobalId if building is not None else ""
        if building_guid and own and own != building_guid:
            continue
        said = float(storey.Elevation or 0.0) if level is None or same_place else level
        storeys.append(IfcStorey(name=_name_storey(storey), level_m=said * unit_m, building=own))
    return sorted(storeys, key=lambda storey: (storey.level_m, storey.name))


def assign_storey(
    element: ifcopenshell.entity_instance, storeys: Sequence[IfcStorey], bottom_ifc_m: float
) -> StoreyAssignment:
    """The element's storey by containment, else its host's, else by ``bottom_ifc_m``, its lowest point's level."""
    contained = _find_container_storey(element)
    if contained:
        return StoreyAssignment(name=contained, source=CONTAINMENT)
    host, seen = find_host(element), {element.id()}
    while host is not None and host.id() not in seen:
        seen.add(host.id())
        contained = _find_container_storey(host)
        if contained:
            return StoreyAssignment(name=contained, source=HOST)
        host = find_host(host)
    building = find_building(element)
    near = [storey for storey in storeys if building is None or storey.building in ("", building.GlobalId)] or storeys
    if not near:
        return StoreyAssignment(name="", source="")
    below = [storey for storey in near if storey.level_m <= bottom_ifc_m + _FLOOR_TOLERANCE_M]
    return StoreyAssignment(name=(below[-1] if below else near[0]).name, source=ELEVATION)


def _read_placement_level(storey: ifcopenshell.entity_instance) -> float | None:
    """Level of the storey's placement in the model's unit; None where it has none."""
    if storey.ObjectPlacement is None:
        return None
    return float(ifcopenshell.util.placement.get_local_placement(storey.ObjectPlacement)[2, 3])


def _find_container_storey(element: ifcopenshell.entity_instance) -> str:
    holder = find_container(element)
    while holder is not None:
        if holder.is_a("IfcBuildingStorey"):
            return _name_storey(holder)
        holder = ifcopenshell.util.element.get_aggregate(holder)
    return ""


def _name_storey(storey: ifcopenshell.entity_instance) -> str:
    return str(storey.Name or storey.LongName or storey.GlobalId)
