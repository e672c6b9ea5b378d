"""Read an element's materials, and its material layers from the outside in."""

from __future__ import annotations

import json
from dataclasses import dataclass

import ifcopenshell
import ifcopenshell.util.element
import ifcopenshell.util.placement
import numpy as np

from facadelake.core.arrays import Float64x3

_AXES = {"AXIS1": 0, "AXIS2": 1, "AXIS3": 2}
_ACROSS_COSINE = 0.5  # below this cosine to the outward direction, layers have no outermost one


@dataclass(frozen=True, kw_only=True)
class MaterialLayer:
    """One layer; ``material`` is empty where the IFC names none, as for an air gap."""

    material: str
    thickness_m: float


def read_material_names(element: ifcopenshell.entity_instance) -> str:
    """Read the names of the element's materials, each once, outermost first if a usage defines it; "" if none."""
    material = ifcopenshell.util.element.get_material(element)
    return "; ".join(dict.fromkeys(_collect_names(material)))


def read_layers(
    element: ifcopenshell.entity_instance, outward_ifc: Float64x3 | None, unit_m: float
) -> list[MaterialLayer]:
    """Read the element's layers.

    They are sorted from the outside in if ``outward_ifc`` (3,), in the model's axes, is given and the IFC defines the
    position of the layers in the element; else they are in the IFC's order, which most exporters write from the
    outside. ``unit_m``: metres per length unit of the IFC.
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
    placement = ifcopenshell.util.placement.get_local_placement(element.ObjectPlacement)
    sense = -1.0 if usage.DirectionSense == "NEGATIVE" else 1.0
    cosine = sense * float(np.dot(placement[:3, _AXES[usage.LayerSetDirection]], outward_ifc))
    return layers[::-1] if cosine > _ACROSS_COSINE else layers  # reversed: the set starts at the inner face


def json_from_layers(layers: list[MaterialLayer]) -> str:
    """Layers as JSON; "" if there are none."""
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
