"""What an element is made of: names of its materials, and its layers from the outside in."""

from __future__ import annotations

import json
from dataclasses import dataclass

import ifcopenshell
import ifcopenshell.util.element
import ifcopenshell.util.placement
import numpy as np

from facadelake.core.arrays import Float64Array

_AXES = {"AXIS1": 0, "AXIS2": 1, "AXIS3": 2}
_ACROSS_COSINE = 0.5  # cosine: layers that lie more along the facade than across it have no outermost


@dataclass(frozen=True, kw_only=True)
class MaterialLayer:
    """One layer; the material is empty where the IFC names none, as of an air gap."""

    material: str
    thickness_m: float


def read_material_names(element: ifcopenshell.entity_instance) -> str:
    """Names of the element's materials, each once, outermost first where a usage says so; empty without."""
    material = ifcopenshell.util.element.get_material(element)
    return "; ".join(dict.fromkeys(_collect_names(material)))


def read_layers(
    element: ifcopenshell.entity_instance, outward_ifc: Float64Array | None, unit_m: float
) -> list[MaterialLayer]:
    """The element's layers; empty without any.

    Outermost first where ``outward_ifc`` (3,), in the model's axes, is known and the IFC says how the layers lie in the
    element; else as the IFC lists them, which most writers do from the outside. ``unit_m``: metres of its length unit.
    """
    material = ifcopenshell.util.element.get_material(element)
    if material is None:
        return []
    usage = material if material.is_a("IfcMaterialLayerSetUsage") else None
    layer_set = usage.ForLayerSet if usage else material
    if not layer_set.is_a("IfcMaterialLayerSet"):
        return []
    layers = [
        MaterialLayer(
            material=(layer.Material.Name or "") if layer.Material else "",
            thickness_m=round(float(layer.LayerThickness) * unit_m, 6),
        )
        for layer in layer_set.MaterialLayers
    ]
    if usage is None or outward_ifc is None or element.ObjectPlacement is None:
        return layers
    placed = ifcopenshell.util.placement.get_local_placement(element.ObjectPlacement)
    sense = -1.0 if usage.DirectionSense == "NEGATIVE" else 1.0
    along = sense * float(np.dot(placed[:3, _AXES[usage.LayerSetDirection]], outward_ifc))
    return layers[::-1] if along > _ACROSS_COSINE else layers  # the set begins at the inner face


def json_from_layers(layers: list[MaterialLayer]) -> str:
    """Layers as JSON, empty without any."""
    rows = [{"material": layer.material or None, "thickness_m": layer.thickness_m} for layer in layers]
    return json.dumps(rows, ensure_ascii=False) if rows else ""


def _collect_names(material: ifcopenshell.entity_instance | None) -> list[str]:
    if material is None:
        return []
    if material.is_a("IfcMaterial"):
        return [material.Name] if material.Name else []
    if material.is_a("IfcMaterialLayerSetUsage"):
        names = _collect_names(material.ForLayerSet)
        return names[::-1] if material.DirectionSense == "NEGATIVE" else names
    if material.is_a("IfcMaterialProfileSetUsage"):
        return _collect_names(material.ForProfileSet)
    parts: list[ifcopenshell.entity_instance] = []
    for attribute in ("MaterialLayers", "MaterialConstituents", "MaterialProfiles", "Materials"):
        parts.extend(getattr(material, attribute, None) or ())
    return [name for part in parts for name in _collect_names(part if part.is_a("IfcMaterial") else part.Material)]
