"""Read the IFC's spatial structure: hosts, containers, buildings, storeys, and the storey of an element."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import ifcopenshell
import ifcopenshell.util.element
import ifcopenshell.util.placement
import ifcopenshell.util.unit

from facadelake.core.errors import ModelError

CONTAINMENT, HOST, ELEVATION = "containment", "host", "elevation"
_FLOOR_TOLERANCE_M = 0.1  # an element may begin this far below the level of its storey


@dataclass(frozen=True, kw_only=True)
class IfcStorey:
    """A storey, the level of its floor in the model's axes in metres, and the GlobalId of its IfcBuilding, if any."""

    name: str
    level_m: float
    building: str = ""


@dataclass(frozen=True, kw_only=True)
class StoreyAssignment:
    """An element's storey and its source: "containment", "host" or "elevation"; both empty if there is none."""

    name: str
    source: str


def find_host(element: ifcopenshell.entity_instance) -> ifcopenshell.entity_instance | None:
    """Find the element whose opening this one fills, or of which it is a part, as a plate of a curtain wall."""
    for filling in getattr(element, "FillsVoids", None) or ():
        for voiding in filling.RelatingOpeningElement.VoidsElements or ():
            return voiding.RelatingBuildingElement
    whole = ifcopenshell.util.element.get_aggregate(element) or ifcopenshell.util.element.get_nest(element)
    return whole if whole is not None and whole.is_a("IfcElement") else None


def find_container(element: ifcopenshell.entity_instance) -> ifcopenshell.entity_instance | None:
    """Find the spatial element that contains ``element`` directly; None if there is none."""
    for containing in getattr(element, "ContainedInStructure", None) or ():
        return containing.RelatingStructure
    return None


def find_building(element: ifcopenshell.entity_instance) -> ifcopenshell.entity_instance | None:
    """Find the IfcBuilding of an element, its host or a storey; None if there is none."""
    visited: set[int] = set()
    parent = element
    while parent is not None and parent.id() not in visited:
        visited.add(parent.id())
        if parent.is_a("IfcBuilding"):
            return parent
        parent = find_container(parent) or find_host(parent) or ifcopenshell.util.element.get_aggregate(parent)
    return None


def get_building(model: ifcopenshell.file, name: str) -> ifcopenshell.entity_instance:
    """Get the IfcBuilding by GlobalId, Name or LongName. Raises ModelError if none or several match."""
    buildings = model.by_type("IfcBuilding")
    found = [building for building in buildings if name in (building.GlobalId, building.Name, building.LongName)]
    if len(found) != 1:
        known = ", ".join(f"'{label_building(building)}' ({building.GlobalId})" for building in buildings) or "none"
        raise ModelError(
            f"model_building '{name}' in the portfolio matches {len(found)} of the IFC's buildings ({known}); use one "
            "of these names or GlobalIds"
        )
    return found[0]


def label_building(building: ifcopenshell.entity_instance) -> str:
    """Name, LongName or GlobalId of the building, the first that is set."""
    return str(building.Name or building.LongName or building.GlobalId)


def read_storeys(model: ifcopenshell.file, building_guid: str = "") -> list[IfcStorey]:
    """Read the model's storeys, or those of the IfcBuilding ``building_guid``, sorted by level.

    The level is that of the storey's placement. Elevation is used where placements are missing or all equal, as in
    files whose exporter left them at zero.
    """
    unit_m = float(ifcopenshell.util.unit.calculate_unit_scale(model))
    entities = model.by_type("IfcBuildingStorey")
    placement_levels = [_read_placement_level(entity) for entity in entities]
    elevations = {float(entity.Elevation or 0.0) for entity in entities}
    placements_equal = len(set(placement_levels)) == 1 and len(elevations) > 1
    storeys = []
    for entity, placement_level in zip(entities, placement_levels, strict=True):
        building = find_building(entity)
        guid = building.GlobalId if building is not None else ""
        if building_guid and guid and guid != building_guid:
            continue
        level = float(entity.Elevation or 0.0) if placement_level is None or placements_equal else placement_level
        storeys.append(IfcStorey(name=_name_storey(entity), level_m=level * unit_m, building=guid))
    return sorted(storeys, key=lambda storey: (storey.level_m, storey.name))


def assign_storey(
    element: ifcopenshell.entity_instance, storeys: Sequence[IfcStorey], bottom_ifc_m: float
) -> StoreyAssignment:
    """Assign a storey by the element's containment, else its host's, else by ``bottom_ifc_m``, the lowest level."""
    contained = _find_container_storey(element)
    if contained:
        return StoreyAssignment(name=contained, source=CONTAINMENT)
    host, visited = find_host(element), {element.id()}
    while host is not None and host.id() not in visited:
        visited.add(host.id())
        contained = _find_container_storey(host)
        if contained:
            return StoreyAssignment(name=contained, source=HOST)
        host = find_host(host)
    building = find_building(element)
    same_building = [storey for storey in storeys if building is None or storey.building in ("", building.GlobalId)]
    candidates = same_building or storeys
    if not candidates:
        return StoreyAssignment(name="", source="")
    below = [storey for storey in candidates if storey.level_m <= bottom_ifc_m + _FLOOR_TOLERANCE_M]
    return StoreyAssignment(name=(below[-1] if below else candidates[0]).name, source=ELEVATION)


def _read_placement_level(storey: ifcopenshell.entity_instance) -> float | None:
    """Level of the storey's placement in the model's unit; None if it has no placement."""
    if storey.ObjectPlacement is None:
        return None
    return float(ifcopenshell.util.placement.get_local_placement(storey.ObjectPlacement)[2, 3])


def _find_container_storey(element: ifcopenshell.entity_instance) -> str:
    """Name of the storey that contains the element; "" if there is none."""
    container = find_container(element)
    while container is not None:
        if container.is_a("IfcBuildingStorey"):
            return _name_storey(container)
        container = ifcopenshell.util.element.get_aggregate(container)
    return ""


def _name_storey(storey: ifcopenshell.entity_instance) -> str:
    return str(storey.Name or storey.LongName or storey.GlobalId)
