"""Read the IFC's spatial structure: hosts, containers, buildings, storeys, and the storey of an element."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import ifcopenshell
import ifcopenshell.util.element
import ifcopenshell.util.placement

from facadelake.building.model_georeference.length_units import read_project_unit
from facadelake.core.errors import ModelError

CONTAINMENT, HOST, ELEVATION = "containment", "host", "elevation"
_FLOOR_TOLERANCE_M = 0.1  # an element may begin this far below the level of its storey


@dataclass(frozen=True, kw_only=True)
class IfcStorey:
    """A storey and the level of its floor in the model's axes, metres.

    ``step_id`` is its number in the IFC, 0 for storeys of the portfolio; ``building`` the label of its IfcBuilding, if
    any.
    """

    name: str
    level_m: float
    step_id: int = 0
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


def get_building(model: ifcopenshell.file, name: str, labels: Mapping[int, str]) -> ifcopenshell.entity_instance:
    """Get the IfcBuilding by GlobalId, Name, LongName or label. Raises ModelError if none or several match."""
    buildings = model.by_type("IfcBuilding")
    found = [
        building
        for building in buildings
        if name in (building.GlobalId, building.Name, building.LongName, labels[building.id()])
    ]
    if len(found) != 1:
        known = ", ".join(f"'{labels[building.id()]}' ({building.GlobalId})" for building in buildings) or "none"
        raise ModelError(
            f"model_building '{name}' in the portfolio matches {len(found)} of the IFC's buildings ({known}); use one "
            "of these names or GlobalIds"
        )
    return found[0]


def label_buildings(model: ifcopenshell.file) -> dict[int, str]:
    """Label the buildings by STEP id: Name, LongName or GlobalId; those of one name are numbered by GlobalId."""
    buildings = sorted(model.by_type("IfcBuilding"), key=lambda one: (str(one.GlobalId), one.id()))
    return _number_same_names([(building.id(), _name_entity(building)) for building in buildings])


def read_storeys(
    model: ifcopenshell.file,
    buildings: Mapping[int, str],
    selected: ifcopenshell.entity_instance | None = None,
) -> list[IfcStorey]:
    """Read the model's storeys, or those of the IfcBuilding ``selected``, sorted by level.

    The level is that of the storey's placement. Elevation is used where placements are missing or all equal, as in
    files whose exporter left them at zero. Storeys of one name get the label of their building, of ``buildings`` by
    STEP id, and those of one building are numbered from the lowest up.
    """
    unit_m = read_project_unit(model).metres
    entities = model.by_type("IfcBuildingStorey")
    placement_levels = [_read_placement_level(entity) for entity in entities]
    elevations = {float(entity.Elevation or 0.0) for entity in entities}
    placements_equal = len(set(placement_levels)) == 1 and len(elevations) > 1
    storeys = []
    for entity, placement_level in zip(entities, placement_levels, strict=True):
        building = find_building(entity)
        if selected is not None and building is not None and building.id() != selected.id():
            continue
        level = float(entity.Elevation or 0.0) if placement_level is None or placements_equal else placement_level
        storeys.append(
            IfcStorey(
                name=_name_entity(entity),
                level_m=level * unit_m,
                step_id=entity.id(),
                building=buildings[building.id()] if building is not None else "",
            )
        )
    storeys.sort(key=lambda storey: (storey.level_m, storey.name, str(model.by_id(storey.step_id).GlobalId)))
    return _tell_storeys_apart(storeys)


def _tell_storeys_apart(storeys: Sequence[IfcStorey]) -> list[IfcStorey]:
    buildings_of: dict[str, set[str]] = {}
    for storey in storeys:
        buildings_of.setdefault(storey.name, set()).add(storey.building)
    named = [
        f"{storey.name}, {storey.building}" if len(buildings_of[storey.name]) > 1 and storey.building else storey.name
        for storey in storeys
    ]
    labels = _number_same_names(list(enumerate(named)))
    return [replace(storey, name=labels[index]) for index, storey in enumerate(storeys)]


def _number_same_names(names: Sequence[tuple[int, str]]) -> dict[int, str]:
    """Names by key; those that occur several times get a number in the order given."""
    count = Counter(name for _, name in names)
    seen: Counter[str] = Counter()
    labels = {}
    for key, name in names:
        seen[name] += 1
        label = f"{name} ({seen[name]})" if count[name] > 1 else name
        while label != name and label in count:  # a name that has such a number itself
            seen[name] += 1
            label = f"{name} ({seen[name]})"
        labels[key] = label
    return labels


def assign_storey(
    element: ifcopenshell.entity_instance,
    storeys: Sequence[IfcStorey],
    bottom_ifc_m: float,
    buildings: Mapping[int, str],
) -> StoreyAssignment:
    """Assign a storey by the element's containment, else its host's, else by its lowest level.

    Args:
        element: the element.
        storeys: the model's storeys, sorted by level.
        bottom_ifc_m: the element's lowest level.
        buildings: labels of the buildings by STEP id.

    Returns:
        The storey and how it was found.
    """
    names = {storey.step_id: storey.name for storey in storeys}
    contained = _find_container_storey(element, names)
    if contained:
        return StoreyAssignment(name=contained, source=CONTAINMENT)
    host, visited = find_host(element), {element.id()}
    while host is not None and host.id() not in visited:
        visited.add(host.id())
        contained = _find_container_storey(host, names)
        if contained:
            return StoreyAssignment(name=contained, source=HOST)
        host = find_host(host)
    building = find_building(element)
    own = "" if building is None else buildings[building.id()]
    candidates = [storey for storey in storeys if not own or storey.building in ("", own)] or storeys
    if not candidates:
        return StoreyAssignment(name="", source="")
    below = [storey for storey in candidates if storey.level_m <= bottom_ifc_m + _FLOOR_TOLERANCE_M]
    return StoreyAssignment(name=(below[-1] if below else candidates[0]).name, source=ELEVATION)


def _read_placement_level(storey: ifcopenshell.entity_instance) -> float | None:
    """Level of the storey's placement in the model's unit; None if it has no placement."""
    if storey.ObjectPlacement is None:
        return None
    return float(ifcopenshell.util.placement.get_local_placement(storey.ObjectPlacement)[2, 3])


def _find_container_storey(element: ifcopenshell.entity_instance, names: Mapping[int, str]) -> str:
    """Name of the storey that contains the element; "" if there is none."""
    container, visited = find_container(element), set[int]()
    while container is not None and container.id() not in visited:
        visited.add(container.id())
        if container.is_a("IfcBuildingStorey"):
            return names.get(container.id(), _name_entity(container))
        container = ifcopenshell.util.element.get_aggregate(container)
    return ""


def _name_entity(entity: ifcopenshell.entity_instance) -> str:
    """Name, LongName or GlobalId, the first that is set."""
    texts = (str(value).strip() for value in (entity.Name, entity.LongName, entity.GlobalId) if value)
    return next((text for text in texts if text), f"#{entity.id()}")
