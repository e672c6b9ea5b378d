"""Build table ``elements`` of an IFC: attributes, property sets, level of detail and facade of each element."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import ifcopenshell
import ifcopenshell.util.element
import numpy as np
import pyarrow as pa
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from facadelake.building.facades.directions import FacadeAssignment, find_facades
from facadelake.building.facades.openness import LEVEL
from facadelake.building.ifc.identity import name_elements
from facadelake.building.ifc.materials import json_from_layers, read_layers, read_material_names
from facadelake.building.ifc.meshes import ElementMesh
from facadelake.building.ifc.structure import IfcStorey, assign_storey, find_building, find_host, label_buildings
from facadelake.building.model_georeference.length_units import read_project_unit
from facadelake.building.surface.footprint import compute_outline, lon_lat_from_site
from facadelake.building.surface.raycasting import Surface
from facadelake.core.arrays import Float64x3, Float64x3x3
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.progress import track
from facadelake.core.tables import table_from_rows

_MAX_CHARACTERS = 8192  # some exporters attach whole specifications to every window
_OMITTED = "_left_out"  # key of the list of omitted sets
_MAX_BOX_PLANES = 6
_MAX_BODY_PLANES = 100
_MIN_DETAILED_BODIES = 3  # a frame, its panes, its handle
_SAME_PLANE_M = 0.002


@dataclass(frozen=True, kw_only=True)
class _Structure:
    """The IFC with its storeys, labels of its buildings and identifiers of its elements, both by STEP id."""

    model: ifcopenshell.file
    storeys: Sequence[IfcStorey]
    buildings: Mapping[int, str]
    identifiers: Mapping[int, str]


def build_elements_table(
    model: ifcopenshell.file,
    meshes: Sequence[ElementMesh],
    surface: Surface,
    *,
    site_from_ifc: Float64x3x3,
    origin: SiteOrigin,
    storeys: Sequence[IfcStorey],
) -> pa.Table:
    """Build table ``elements`` with one row per mesh.

    Args:
        model: the IFC.
        meshes: one mesh per element, in the model's axes.
        surface: the surface in site, with the meshes' triangles in the same order.
        site_from_ifc: rotation (3, 3) of directions.
        origin: origin of the site frame.
        storeys: the model's storeys, sorted by level.

    Returns:
        A table of kind ``elements``.
    """
    ends = np.cumsum([len(mesh.triangles) for mesh in meshes])
    element_of_triangle = np.repeat(np.arange(len(meshes)), [len(mesh.triangles) for mesh in meshes])
    facades = find_facades(surface, element_of_triangle, len(meshes))
    areas = np.bincount(element_of_triangle, weights=surface.areas_m2, minlength=len(meshes))
    unit_m = read_project_unit(model).metres
    structure = _Structure(
        model=model, storeys=storeys, buildings=label_buildings(model), identifiers=name_elements(model)
    )
    rows: list[dict[str, Any]] = []
    for index, mesh in enumerate(track(meshes, label="Reading elements")):
        corners = surface.vertices_site_m[surface.triangles[ends[index] - len(mesh.triangles) : ends[index]]]
        outline = lon_lat_from_site(compute_outline(corners), float(corners[:, :, 2].min()), origin)
        facade = facades[index]
        attributes = _read_attributes(structure, mesh, _outward_from_facade(facade, site_from_ifc), unit_m)
        computed = {
            "facade": facade.name,
            "facade_azimuth_deg": facade.azimuth_deg,
            "surface_area_m2": float(areas[index]),
            "geometry": shapely.to_wkb(outline),
        }
        rows.append(attributes | computed)
    return table_from_rows("elements", rows)


def _read_attributes(
    structure: _Structure,
    mesh: ElementMesh,
    outward_ifc: Float64x3 | None,
    unit_m: float,
) -> dict[str, Any]:
    """The columns that the IFC states; None where it states nothing.

    Args:
        structure: the IFC and what its elements refer to.
        mesh: the element's mesh.
        outward_ifc: outward direction (3,) in the model's axes, if any.
        unit_m: metres per length unit of the IFC.
    """
    element = structure.model.by_id(mesh.step_id)
    lowest_m = float(mesh.vertices_ifc_m[:, 2].min())
    storey = assign_storey(element, structure.storeys, lowest_m, structure.buildings)
    host, building = find_host(element), find_building(element)
    sets = read_property_sets(element)
    return {
        "element_guid": mesh.guid,
        "ifc_class": element.is_a(),
        "predefined_type": _read_predefined_type(element),
        "element_name": element.Name or None,
        "host_guid": structure.identifiers[host.id()] if host is not None else None,
        "ifc_building": structure.buildings[building.id()] if building is not None else None,
        "storey": storey.name or None,
        "storey_source": storey.source or None,
        "material": read_material_names(element) or None,
        "material_layers": json_from_layers(read_layers(element, outward_ifc, unit_m)) or None,
        "is_external": is_external(sets),
        "properties": json_from_property_sets(sets) or None,
        "detail_level": classify_detail(mesh),
        "triangles": len(mesh.triangles),
    }


def _read_predefined_type(element: ifcopenshell.entity_instance) -> str | None:
    """PredefinedType of the element, else of its type; a user-defined one by its name; None if there is none."""
    for entity, attribute in ((element, "ObjectType"), (ifcopenshell.util.element.get_type(element), "ElementType")):
        predefined = getattr(entity, "PredefinedType", None)
        if predefined == "USERDEFINED":
            predefined = getattr(entity, attribute, None)
        if predefined and predefined != "NOTDEFINED":
            return str(predefined)
    return None


def _outward_from_facade(facade: FacadeAssignment, site_from_ifc: Float64x3x3) -> Float64x3 | None:
    """The facade's outward direction in the model's axes; upward for "level", None for "inside" and "around"."""
    if facade.name == LEVEL:
        return np.array([0.0, 0.0, 1.0])
    if facade.azimuth_deg is None:
        return None
    angle = np.radians(facade.azimuth_deg)
    outward: Float64x3 = site_from_ifc.T @ np.array([np.sin(angle), np.cos(angle), 0.0])
    return outward


def read_property_sets(element: ifcopenshell.entity_instance) -> dict[str, dict[str, Any]]:
    """Read the element's property sets by set and property name; its own values override its type's."""
    sets = ifcopenshell.util.element.get_psets(element, psets_only=True)
    return {
        name: {key: _convert_to_json(value) for key, value in values.items() if key != "id"}
        for name, values in sets.items()
    }


def json_from_property_sets(sets: dict[str, dict[str, Any]]) -> str:
    """The sets as JSON of at most 8192 characters; beyond that the largest are omitted and listed by name."""
    kept = {name: json.dumps(values, ensure_ascii=False, sort_keys=True) for name, values in sets.items() if values}
    omitted: list[str] = []
    # The standard's Pset_ are omitted last: queries use them.
    for name in sorted(kept, key=lambda name: (name.startswith("Pset_"), -len(kept[name]))):
        if sum(len(text) + len(key) + 6 for key, text in kept.items()) <= _MAX_CHARACTERS:
            break
        omitted.append(name)
        del kept[name]
    parts = [f"{json.dumps(name, ensure_ascii=False)}: {kept[name]}" for name in sorted(kept)]
    if omitted:
        parts.append(f"{json.dumps(_OMITTED)}: {json.dumps(sorted(omitted)[:20], ensure_ascii=False)}")
    return "{" + ", ".join(parts) + "}" if parts else ""


def is_external(sets: dict[str, dict[str, Any]]) -> bool | None:
    """IsExternal of the element's common property set; None if it is not set."""
    for name, values in sets.items():
        if name.startswith("Pset_") and name.endswith("Common") and isinstance(values.get("IsExternal"), bool):
            return bool(values["IsExternal"])
    return None


def _convert_to_json(value: Any) -> Any:
    """Convert to a value that JSON can represent: entities and NaN become text."""
    if isinstance(value, dict):
        return {str(key): _convert_to_json(inner) for key, inner in value.items() if key != "id"}
    if isinstance(value, (list, tuple)):
        return [_convert_to_json(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value if value is None or isinstance(value, (bool, int, float, str)) else str(value)


def classify_detail(mesh: ElementMesh) -> str:
    """Classify the level of detail.

    ``box``: at most six planes; ``detailed``: three separate bodies or more, or over 100 planes; else ``body``.
    """
    corners = mesh.vertices_ifc_m[mesh.triangles] - mesh.vertices_ifc_m.mean(axis=0)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    offset = np.einsum("ij,ij->i", normal, corners[:, 0])
    planes = len(np.unique(np.column_stack([np.round(normal * 50), np.round(offset / _SAME_PLANE_M)]), axis=0))
    count = len(mesh.vertices_ifc_m)
    edges = np.vstack([mesh.triangles[:, [0, 1]], mesh.triangles[:, [1, 2]]]).T
    graph = coo_array((np.ones(edges.shape[1], dtype=bool), (edges[0], edges[1])), shape=(count, count))
    labels = connected_components(graph, directed=False)[1][mesh.triangles[:, 0]]
    if planes > _MAX_BODY_PLANES or len(np.unique(labels)) >= _MIN_DETAILED_BODIES:
        return "detailed"
    return "box" if planes <= _MAX_BOX_PLANES else "body"
