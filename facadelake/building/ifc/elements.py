"""Table ``elements`` of an IFC: attributes, property sets and level of detail of each element, and its facade."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import ifcopenshell
import ifcopenshell.util.element
import ifcopenshell.util.unit
import numpy as np
import pyarrow as pa
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from facadelake.building.facades.directions import cluster_directions, measure_turn_deg, name_facades
from facadelake.building.facades.openness import LEVEL, find_open_sides
from facadelake.building.ifc.materials import json_from_layers, read_layers, read_material_names
from facadelake.building.ifc.meshes import ElementMesh
from facadelake.building.ifc.structure import IfcStorey, assign_storey, find_building, find_host, label_building
from facadelake.building.surface.footprint import compute_outline, lon_lat_from_site
from facadelake.building.surface.raycasting import Surface
from facadelake.core.arrays import Float64Array, Int64Array
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.progress import track
from facadelake.core.tables import table_from_rows


@dataclass(frozen=True, kw_only=True)
class FacadeAssignment:
    """An element's facade, and its outward azimuth in degrees; None for "level", "inside" and "around"."""

    name: str
    azimuth_deg: float | None


def build_elements_table(
    model: ifcopenshell.file,
    meshes: Sequence[ElementMesh],
    surface: Surface,
    *,
    site_from_ifc: Float64Array,
    origin: SiteOrigin,
    storeys: Sequence[IfcStorey],
) -> pa.Table:
    """One row a mesh, whose triangles follow one another in ``surface``; ``site_from_ifc`` (3, 3) turns directions."""
    ends = np.cumsum([len(mesh.triangles) for mesh in meshes])
    owner = np.repeat(np.arange(len(meshes)), [len(mesh.triangles) for mesh in meshes])
    facades = find_facades(surface, owner, len(meshes))
    areas = np.bincount(owner, weights=surface.areas_m2, minlength=len(meshes))
    unit_m = float(ifcopenshell.util.unit.calculate_unit_scale(model))
    rows: list[dict[str, Any]] = []
    for index, mesh in enumerate(track(meshes, label="Describing elements")):
        corners = surface.vertices_site_m[surface.triangles[ends[index] - len(mesh.triangles) : ends[index]]]
        outline = lon_lat_from_site(compute_outline(corners), float(corners[:, :, 2].min()), origin)
        facade = facades[index]
        said = _read_attributes(
            model.by_guid(mesh.guid), mesh, storeys, _outward_from_facade(facade, site_from_ifc), unit_m
        )
        seen = {
            "facade": facade.name,
            "facade_azimuth_deg": facade.azimuth_deg,
            "surface_area_m2": float(areas[index]),
            "geometry": shapely.to_wkb(outline),
        }
        rows.append(said | seen)
    return table_from_rows("elements", rows)


def find_facades(surface: Surface, element_of_triangle: Int64Array, elements: int) -> list[FacadeAssignment]:
    """Facade of each element: walls clustered by the way they look, however the compass divides them."""
    sides = find_open_sides(surface, element_of_triangle, elements)
    faced = np.isfinite(sides.azimuth_deg)
    directions = cluster_directions(sides.azimuth_deg[faced], sides.area_m2[faced])
    names = name_facades(directions)
    found = []
    for word, azimuth in zip(sides.labels, sides.azimuth_deg, strict=True):
        if word:
            found.append(FacadeAssignment(name=word, azimuth_deg=None))
        else:
            nearest = int(np.argmin(measure_turn_deg(directions, float(azimuth))))
            found.append(
                FacadeAssignment(name=names[nearest], azimuth_deg=round(float(directions[nearest]), 2) % 360.0)
            )
    return found


def _read_attributes(
    element: ifcopenshell.entity_instance,
    mesh: ElementMesh,
    storeys: Sequence[IfcStorey],
    outward_ifc: Float64Array | None,
    unit_m: float,
) -> dict[str, Any]:
    """The columns that the IFC tells; None where it is silent."""
    storey = assign_storey(element, storeys, float(mesh.vertices_ifc_m[:, 2].min()))
    host, building = find_host(element), find_building(element)
    sets = read_property_sets(element)
    return {
        "element_guid": element.GlobalId,
        "ifc_class": element.is_a(),
        "predefined_type": _read_predefined_type(element),
        "element_name": element.Name or None,
        "host_guid": host.GlobalId if host is not None else None,
        "ifc_building": label_building(building) if building is not None else None,
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
    """PredefinedType of the element, else of its type, or their own word for it; None where there is none."""
    for holder, own_word in ((element, "ObjectType"), (ifcopenshell.util.element.get_type(element), "ElementType")):
        found = getattr(holder, "PredefinedType", None)
        if found == "USERDEFINED":
            found = getattr(holder, own_word, None)
        if found and found != "NOTDEFINED":
            return str(found)
    return None


def _outward_from_facade(facade: FacadeAssignment, site_from_ifc: Float64Array) -> Float64Array | None:
    """The facade's outward direction in the model's axes; up for what is level."""
    if facade.name == LEVEL:
        return np.array([0.0, 0.0, 1.0])
    if facade.azimuth_deg is None:
        return None
    angle = np.radians(facade.azimuth_deg)
    outward: Float64Array = site_from_ifc.T @ np.array([np.sin(angle), np.cos(angle), 0.0])
    return outward


_MAX_CHARACTERS = 8192  # some exporters hang whole specifications on every window
_LEFT_OUT = "_left_out"


def read_property_sets(element: ifcopenshell.entity_instance) -> dict[str, dict[str, Any]]:
    """Values of the element's property sets, its own before its type's, by set and name."""
    found = ifcopenshell.util.element.get_psets(element, psets_only=True)
    return {
        name: {key: _convert_to_json(value) for key, value in values.items() if key != "id"}
        for name, values in found.items()
    }


def json_from_property_sets(sets: dict[str, dict[str, Any]]) -> str:
    """The sets as JSON of at most 8192 characters; where they are more, the largest are left out and named."""
    kept = {name: json.dumps(values, ensure_ascii=False, sort_keys=True) for name, values in sets.items() if values}
    left: list[str] = []
    # IFC's own Pset_ stay longest: they are what queries ask for.
    for name in sorted(kept, key=lambda name: (name.startswith("Pset_"), -len(kept[name]))):
        if sum(len(text) + len(key) + 6 for key, text in kept.items()) <= _MAX_CHARACTERS:
            break
        left.append(name)
        del kept[name]
    parts = [f"{json.dumps(name, ensure_ascii=False)}: {kept[name]}" for name in sorted(kept)]
    if left:
        parts.append(f"{json.dumps(_LEFT_OUT)}: {json.dumps(sorted(left)[:20], ensure_ascii=False)}")
    return "{" + ", ".join(parts) + "}" if parts else ""


def is_external(sets: dict[str, dict[str, Any]]) -> bool | None:
    """IsExternal of the element's common property set; None where it is not said."""
    for name, values in sets.items():
        if name.startswith("Pset_") and name.endswith("Common") and isinstance(values.get("IsExternal"), bool):
            return bool(values["IsExternal"])
    return None


def _convert_to_json(value: Any) -> Any:
    """A value that JSON can hold: entities by their text, no NaN."""
    if isinstance(value, dict):
        return {str(key): _convert_to_json(inner) for key, inner in value.items() if key != "id"}
    if isinstance(value, (list, tuple)):
        return [_convert_to_json(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value if value is None or isinstance(value, (bool, int, float, str)) else str(value)


_MAX_BOX_PLANES = 6
_MAX_BODY_PLANES = 100
_MIN_DETAILED_BODIES = 3  # a frame, its panes, its handle
_SAME_PLANE_M = 0.002


def classify_detail(mesh: ElementMesh) -> str:
    """``box``: at most six planes; ``detailed``: three separate bodies or more, or over 100 planes; else ``body``."""
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
