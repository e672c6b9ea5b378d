"""The IFC project of the demo building before its elements: spatial structure, georeference and materials."""

from __future__ import annotations

import ifcopenshell
import ifcopenshell.api.aggregate
import ifcopenshell.api.context
import ifcopenshell.api.georeference
import ifcopenshell.api.material
import ifcopenshell.api.root
import ifcopenshell.api.unit
import numpy as np

from facadelake.demo.building.ifc_entities import Entity
from facadelake.demo.building.placement import DemoPlacement
from facadelake.demo.recipe import DemoBuilding


def add_spatial_structure(model: ifcopenshell.file, building: DemoBuilding, placement: DemoPlacement) -> list[Entity]:
    """Add project, site, building, storeys and georeference; returns the storeys."""
    project = ifcopenshell.api.root.create_entity(model, ifc_class="IfcProject", name="Facadelake demo building")
    ifcopenshell.api.unit.assign_unit(model, length={"is_metric": True, "raw": "METERS"})
    model_context = ifcopenshell.api.context.add_context(model, context_type="Model")
    ifcopenshell.api.context.add_context(
        model, context_type="Model", context_identifier="Body", target_view="MODEL_VIEW", parent=model_context
    )
    site = ifcopenshell.api.root.create_entity(model, ifc_class="IfcSite", name="Demo site")
    house = ifcopenshell.api.root.create_entity(model, ifc_class="IfcBuilding", name="Demo building")
    ifcopenshell.api.aggregate.assign_object(model, products=[site], relating_object=project)
    ifcopenshell.api.aggregate.assign_object(model, products=[house], relating_object=site)
    storeys = []
    for storey in building.storeys:
        entity = ifcopenshell.api.root.create_entity(model, ifc_class="IfcBuildingStorey", name=storey.name)
        entity.Elevation = storey.floor_m
        storeys.append(entity)
    ifcopenshell.api.aggregate.assign_object(model, products=storeys, relating_object=house)
    ifcopenshell.api.georeference.add_georeferencing(model)
    ifcopenshell.api.georeference.edit_georeferencing(
        model,
        projected_crs={
            "Name": placement.crs,
            "Description": "ETRS89 / UTM zone 32N; heights are ellipsoidal (GRS80)",
            "GeodeticDatum": "ETRS89",
            "MapProjection": "UTM",
            "MapZone": "32N",
        },
        coordinate_operation={
            "Eastings": placement.east_m,
            "Northings": placement.north_m,
            "OrthogonalHeight": placement.height_m,
            "XAxisAbscissa": float(np.cos(placement.rotation_rad)),
            "XAxisOrdinate": float(np.sin(placement.rotation_rad)),
            "Scale": placement.scale,
        },
    )
    return storeys


def add_materials(model: ifcopenshell.file, wall_m: float) -> tuple[dict[str, Entity], Entity]:
    """Add the materials, by name, and the layers of an external wall of thickness ``wall_m``."""
    names = (
        "Lime render",
        "Clay brick",
        "Gypsum plaster",
        "Reinforced concrete",
        "Glass",
        "Galvanised steel",
        "Sandstone",
    )
    materials = {n: ifcopenshell.api.material.add_material(model, name=n) for n in names}
    layers = ifcopenshell.api.material.add_material_set(model, name="External wall", set_type="IfcMaterialLayerSet")
    for name, thick in (("Lime render", 0.02), ("Clay brick", wall_m - 0.035), ("Gypsum plaster", 0.015)):
        layer = ifcopenshell.api.material.add_layer(model, layer_set=layers, material=materials[name])
        ifcopenshell.api.material.edit_layer(model, layer=layer, attributes={"LayerThickness": thick})
    return materials, layers
