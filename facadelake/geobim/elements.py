"""What the IFC says of an element: name, storey, materials, whether it is external."""

from __future__ import annotations

from dataclasses import dataclass

import ifcopenshell
import ifcopenshell.util.element
import ifcopenshell.util.placement
import ifcopenshell.util.unit

_RISE_M = 0.1  # an element may begin this far below its storey's level


@dataclass(frozen=True, kw_only=True)
class Attributes:
    """An element's attributes; an empty text or None where the IFC is silent."""

    guid: str
    ifc_class: str
    name: str
    storey: str
    material: str
    is_external: bool | None


@dataclass(frozen=True, kw_only=True)
class Storey:
    """A storey and the level of its floor in the model's axes, metres."""

    name: str
    level_m: float


def storeys_of(model: ifcopenshell.file) -> list[Storey]:
    """The model's storeys from the lowest up."""
    unit_m = float(ifcopenshell.util.unit.calculate_unit_scale(model))
    storeys = []
    for storey in model.by_type("IfcBuildingStorey"):
        if storey.ObjectPlacement is not None:
            level = float(ifcopenshell.util.placement.get_local_placement(storey.ObjectPlacement)[2, 3])
        else:
            level = float(storey.Elevation or 0.0)
        storeys.append(Storey(name=storey.Name or storey.LongName or storey.GlobalId, level_m=level * unit_m))
    return sorted(storeys, key=lambda storey: (storey.level_m, storey.name))


def attributes_of(element: ifcopenshell.entity_instance, storeys: list[Storey], bottom_ifc_m: float) -> Attributes:
    """The element's attributes; its storey by containment, else by ``bottom_ifc_m``, its lowest point's level."""
    return Attributes(
        guid=element.GlobalId,
        ifc_class=element.is_a(),
        name=element.Name or "",
        storey=_container(element) or _storey_at(storeys, bottom_ifc_m),
        material="; ".join(dict.fromkeys(_materials(ifcopenshell.util.element.get_material(element)))),
        is_external=_is_external(element),
    )


def _container(element: ifcopenshell.entity_instance) -> str:
    """Name of the storey that holds the element, its whole, or the wall its opening is in; empty where none does."""
    seen: set[int] = set()
    holder = element
    while holder is not None and holder.id() not in seen:
        seen.add(holder.id())
        if holder.is_a("IfcBuildingStorey"):
            return str(holder.Name or holder.LongName or holder.GlobalId)
        holder = ifcopenshell.util.element.get_parent(holder)
    return ""


def _storey_at(storeys: list[Storey], bottom_m: float) -> str:
    below = [storey for storey in storeys if storey.level_m <= bottom_m + _RISE_M]
    if below:
        return below[-1].name
    return storeys[0].name if storeys else ""


def _materials(material: ifcopenshell.entity_instance | None) -> list[str]:
    """Names in the order the IFC lists them, which for layers is across the element."""
    if material is None:
        return []
    if material.is_a("IfcMaterial"):
        return [material.Name] if material.Name else []
    if material.is_a("IfcMaterialLayerSetUsage"):
        names = _materials(material.ForLayerSet)
        return names[::-1] if material.DirectionSense == "NEGATIVE" else names
    if material.is_a("IfcMaterialProfileSetUsage"):
        return _materials(material.ForProfileSet)
    parts: list[ifcopenshell.entity_instance] = []
    for attribute in ("MaterialLayers", "MaterialConstituents", "MaterialProfiles", "Materials"):
        parts.extend(getattr(material, attribute, None) or ())
    return [name for part in parts for name in _materials(part if part.is_a("IfcMaterial") else part.Material)]


def _is_external(element: ifcopenshell.entity_instance) -> bool | None:
    """IsExternal of the element's common property set, its own before its type's; None where it is not said."""
    for name, values in ifcopenshell.util.element.get_psets(element, psets_only=True).items():
        if name.startswith("Pset_") and name.endswith("Common") and isinstance(values.get("IsExternal"), bool):
            return bool(values["IsExternal"])
    return None
