"""What holds an element: the wall its window fills, the whole it is a part of, its container, its building."""

from __future__ import annotations

import ifcopenshell
import ifcopenshell.util.element

from facadelake.core.errors import ModelError


def host_of(element: ifcopenshell.entity_instance) -> ifcopenshell.entity_instance | None:
    """The element whose opening this one fills, or that it is a part of (a plate's curtain wall); None without."""
    for filling in getattr(element, "FillsVoids", None) or ():
        for voiding in filling.RelatingOpeningElement.VoidsElements or ():
            return voiding.RelatingBuildingElement
    whole = ifcopenshell.util.element.get_aggregate(element) or ifcopenshell.util.element.get_nest(element)
    return whole if whole is not None and whole.is_a("IfcElement") else None


def container_of(element: ifcopenshell.entity_instance) -> ifcopenshell.entity_instance | None:
    """The spatial element that holds ``element`` itself; None where it is held by nothing or by another element."""
    for containing in getattr(element, "ContainedInStructure", None) or ():
        return containing.RelatingStructure
    return None


def building_of(element: ifcopenshell.entity_instance) -> ifcopenshell.entity_instance | None:
    """The IfcBuilding that an element, its host or a storey lies in; None where there is none."""
    seen: set[int] = set()
    holder = element
    while holder is not None and holder.id() not in seen:
        seen.add(holder.id())
        if holder.is_a("IfcBuilding"):
            return holder
        holder = container_of(holder) or host_of(holder) or ifcopenshell.util.element.get_aggregate(holder)
    return None


def building_named(model: ifcopenshell.file, name: str) -> ifcopenshell.entity_instance:
    """The IfcBuilding of that GlobalId, Name or LongName. Raises ModelError, with those there are, for none or many."""
    buildings = model.by_type("IfcBuilding")
    found = [building for building in buildings if name in (building.GlobalId, building.Name, building.LongName)]
    if len(found) != 1:
        known = ", ".join(f"'{label_of(building)}' ({building.GlobalId})" for building in buildings) or "none"
        raise ModelError(
            f"the registry's model_building '{name}' names {len(found)} of the IFC's buildings; it has {known}; "
            "give one of these names or GlobalIds"
        )
    return found[0]


def label_of(building: ifcopenshell.entity_instance) -> str:
    """What people call the building."""
    return str(building.Name or building.LongName or building.GlobalId)
