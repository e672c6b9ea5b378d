"""Mesh an IFC's elements in the model's axes, in metres, with ifcopenshell's geometry iterator, and check the size."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import ifcopenshell
import ifcopenshell.geom
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from facadelake.building.ifc.identity import name_elements
from facadelake.building.ifc.structure import find_building
from facadelake.core.arrays import Float64Array, Float64Nx3, Int64Nx3
from facadelake.core.errors import ModelError
from facadelake.core.progress import report_progress

_log = logging.getLogger(__name__)
_BATCH = 500  # elements per iterator, which keeps all its shapes in memory
_MAX_DISTANCE_M = 5_000.0  # from the median element; within it rays in float32 keep 0.3 mm
_MAX_HEIGHT_M = 1_200.0  # no building is higher
_MIN_SIZE_M = 0.5
_HEADER_BYTES = 65_536
_STRING = re.compile(rb"'(?:[^']|'')*'")
_HEAD, _TAIL = b"ISO-10303-21;", b"END-ISO-10303-21;"
# Openings, virtual boundaries, terrain and trees are elements in IFC but not part of the building's surface.
_LEFT_OUT = ("IfcFeatureElement", "IfcVirtualElement", "IfcGeographicElement", "IfcOpeningElement")


@dataclass(frozen=True, kw_only=True, eq=False)
class ElementMesh:
    """Surface of one element: ``vertices_ifc_m`` (n, 3), ``triangles`` (m, 3), those of closed bodies wound outward.

    ``guid`` is the element's GlobalId, with its STEP id (``step_id``) where others have the same.
    """

    guid: str
    step_id: int
    vertices_ifc_m: Float64Nx3
    triangles: Int64Nx3


def open_ifc(path: Path) -> ifcopenshell.file:
    """Open the IFC at ``path``. Raises ModelError if it is missing, truncated, not STEP text or not an IFC."""
    try:
        size = path.stat().st_size
        with path.open("rb") as stream:
            head = stream.read(_HEADER_BYTES)
            stream.seek(max(0, size - 4096))
            tail = stream.read()
    except OSError as error:
        raise ModelError(
            f"building model {path} cannot be read ({error.strerror}); check the path of model in the portfolio"
        ) from error
    # Checked before parsing: a truncated file parses without an error and lacks elements.
    if not head.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(_HEAD):
        start = f"it starts with {head[:16]!r}" if head else "the file is empty"
        raise ModelError(
            f"building model {path} is not an IFC in STEP text: {start}, not ISO-10303-21; "
            "export it as .ifc (IFC2x3, IFC4 or IFC4.3), not zipped or as XML"
        )
    if _TAIL not in tail:
        raise ModelError(
            f"building model {path} is truncated: {size} bytes without the closing END-ISO-10303-21; "
            "copy or export it again"
        )
    # A reference in the header ends the process in the parser.
    header = _STRING.sub(b"''", head.split(b"ENDSEC", 1)[0])
    if b"#" in header:
        raise ModelError(f"the header of building model {path} refers to an entity; export it again")
    try:
        model = ifcopenshell.open(path)
        projects = model.by_type("IfcProject")
    except (RuntimeError, OSError, ifcopenshell.Error, AttributeError, ValueError, TypeError) as error:
        raise ModelError(
            f"building model {path} is damaged or of an unknown schema ({error}); "
            "export it again as IFC2x3, IFC4 or IFC4.3"
        ) from error
    if not projects:
        raise ModelError(f"building model {path} has no IfcProject; export the whole model, not a library or a part")
    return model


def mesh_elements(
    model: ifcopenshell.file,
    *,
    deflection_m: float,
    workers: int,
    building: ifcopenshell.entity_instance | None = None,
) -> list[ElementMesh]:
    """Mesh every element with its openings cut out; spaces, sites, openings and annotations are omitted.

    An element whose geometry fails is omitted; see ``describe_missing``.

    Args:
        model: the IFC.
        deflection_m: largest distance of a triangle from the curved surface it approximates.
        workers: number of threads.
        building: an IfcBuilding; elements of the file's other buildings are omitted. None takes all.

    Returns:
        One mesh per element in the model's axes, sorted by GlobalId.

    Raises:
        ModelError: no element could be meshed.
    """
    elements = _list_elements(model, building)
    guids = name_elements(model)
    settings = ifcopenshell.geom.settings()
    # Shapes are meshed relative to their placement, where coordinates are small, and transformed in float64 afterwards:
    # at map coordinates of 5e6 m the kernel's tolerances are coarse.
    settings.set("use-world-coords", False)
    settings.set("weld-vertices", True)
    settings.set("no-normals", True)
    settings.set("mesher-linear-deflection", deflection_m)
    settings.set("mesher-angular-deflection", 0.35)
    meshes: list[ElementMesh] = []
    with report_progress("Meshing elements", len(elements)) as step:
        for start in range(0, len(elements), _BATCH):
            for mesh in _iterate_shapes(model, settings, workers, elements[start : start + _BATCH], guids):
                if len(mesh.triangles):
                    meshes.append(mesh)
                step.advance()
    if not meshes:
        raise ModelError(
            f"the building model has {len(elements)} elements with a body, and none of them could be meshed; "
            "export it with body geometry (design transfer or reference view)"
        )
    meshes = _merge_by_element(meshes)
    return meshes


def describe_missing(
    model: ifcopenshell.file, meshes: Sequence[ElementMesh], building: ifcopenshell.entity_instance | None
) -> str:
    """Remark on the elements, of ``building`` or of all, that could not be meshed; empty if there are none."""
    guids, meshed = name_elements(model), {mesh.step_id for mesh in meshes}
    elements = _list_elements(model, building)
    missing = sorted(guids[element.id()] for element in elements if element.id() not in meshed)
    if not missing:
        return ""
    listed = ", ".join(missing[:5]) + (" ..." if len(missing) > 5 else "")
    remark = f"{len(missing)} of {len(elements)} elements have no surface ({listed})"
    _log.warning("%s", remark)
    return remark


def _list_elements(
    model: ifcopenshell.file, building: ifcopenshell.entity_instance | None
) -> list[ifcopenshell.entity_instance]:
    """Elements with a body that are part of the surface of ``building``, or of all buildings."""
    return [
        element
        for kind in ("IfcElement", "IfcProxy")
        for element in _list_entities(model, kind)
        if element.Representation is not None
        and not any(_is_a(element, name) for name in _LEFT_OUT)
        and not (building is not None and _is_in_other_building(element, building))
    ]


def _iterate_shapes(
    model: ifcopenshell.file,
    settings: ifcopenshell.geom.settings,
    workers: int,
    elements: list[ifcopenshell.entity_instance],
    guids: Mapping[int, str],
) -> Iterator[ElementMesh]:
    """Yield meshes of the elements in the model's axes; elements whose geometry fails are missing.

    Args:
        model: the IFC.
        settings: the iterator's settings.
        workers: number of threads.
        elements: the elements.
        guids: their identifiers by STEP id.
    """
    iterator = ifcopenshell.geom.iterator(settings, model, workers, include=elements)
    more = iterator.initialize()
    while more:
        shape = iterator.get()
        vertices = np.frombuffer(shape.geometry.verts_buffer, dtype=np.float64).reshape(-1, 3)
        triangles = np.frombuffer(shape.geometry.faces_buffer, dtype=np.int32).reshape(-1, 3).astype(np.int64)
        mesh = _clean_mesh(guids[shape.id], shape.id, vertices, triangles)
        ifc_from_element = np.frombuffer(shape.transformation_buffer, dtype=np.float64).reshape(4, 4).T
        yield replace(mesh, vertices_ifc_m=_transform_points(mesh.vertices_ifc_m, ifc_from_element))
        more = iterator.next()


def _transform_points(points: Float64Nx3, matrix: Float64Array) -> Float64Nx3:
    """Apply a matrix (4, 4) to points (n, 3)."""
    transformed: Float64Nx3 = points @ matrix[:3, :3].T + matrix[:3, 3]
    return transformed


def _is_in_other_building(element: ifcopenshell.entity_instance, building: ifcopenshell.entity_instance) -> bool:
    own = find_building(element)
    return own is not None and own.id() != building.id()


def _clean_mesh(guid: str, step_id: int, vertices: Float64Nx3, triangles: Int64Nx3) -> ElementMesh:
    """Build an element's mesh from vertices (n, 3) and triangles (m, 3).

    Triangles without area are removed, and connected bodies with a negative volume get the other winding.
    The kernel's own reorientation of shells takes three times as long as the whole meshing.

    Args:
        guid: identifier of the element.
        step_id: its number in the IFC.
        vertices: in the element's axes, metres.
        triangles: rows of the vertices.
    """
    corners = vertices[triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    triangles = triangles[np.linalg.norm(cross, axis=1) > 1e-10]
    if len(triangles):
        edges = np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]]]).T
        graph = coo_array((np.ones(edges.shape[1], dtype=bool), (edges[0], edges[1])), shape=(len(vertices),) * 2)
        body = connected_components(graph, directed=False)[1][triangles[:, 0]]
        a, b, c = (vertices[triangles[:, i]] - vertices.mean(axis=0) for i in range(3))
        volume = np.bincount(body, weights=np.einsum("ij,ij->i", a, np.cross(b, c)) / 6)
        inside_out = volume[body] < 0
        triangles[inside_out] = triangles[inside_out][:, ::-1]
    return ElementMesh(guid=guid, step_id=step_id, vertices_ifc_m=vertices, triangles=triangles)


def _merge_by_element(meshes: list[ElementMesh]) -> list[ElementMesh]:
    """Merge meshes to one per element: the iterator gives one shape for each context of an element."""
    by_guid: dict[str, list[ElementMesh]] = {}
    for mesh in meshes:
        by_guid.setdefault(mesh.guid, []).append(mesh)
    merged = []
    for guid in sorted(by_guid):
        parts = by_guid[guid]
        starts = np.cumsum([0, *(len(part.vertices_ifc_m) for part in parts[:-1])])
        merged.append(
            ElementMesh(
                guid=guid,
                step_id=parts[0].step_id,
                vertices_ifc_m=np.vstack([part.vertices_ifc_m for part in parts]),
                triangles=np.vstack([part.triangles + start for part, start in zip(parts, starts, strict=True)]),
            )
        )
    return merged


def _list_entities(model: ifcopenshell.file, kind: str) -> list[ifcopenshell.entity_instance]:
    try:
        return list(model.by_type(kind))
    except RuntimeError:  # the schema has no such class (IFC4.3 has no IfcProxy)
        return []


def _is_a(element: ifcopenshell.entity_instance, kind: str) -> bool:
    try:
        return bool(element.is_a(kind))
    except RuntimeError:  # the schema has no such class
        return False


def drop_distant_elements(meshes: Sequence[ElementMesh]) -> tuple[list[ElementMesh], str]:
    """Drop elements more than 5 km from the median one; returns the others, and a remark on those dropped.

    Such elements were left at the file's origin, or at map coordinates, by mistake. Raises ModelError if the others are
    too large or too small for a building, which means a wrong unit.
    """
    centres = np.array([(mesh.vertices_ifc_m.min(axis=0) + mesh.vertices_ifc_m.max(axis=0)) / 2 for mesh in meshes])
    distance = np.linalg.norm(centres - np.median(centres, axis=0), axis=1)
    kept = [mesh for mesh, is_far in zip(meshes, distance > _MAX_DISTANCE_M, strict=True) if not is_far]
    dropped = [mesh.guid for mesh, is_far in zip(meshes, distance > _MAX_DISTANCE_M, strict=True) if is_far]
    if len(dropped) > len(meshes) / 2:
        raise ModelError(
            f"the elements of the building model are up to {distance.max() / 1000:.0f} km apart; its length unit is "
            "wrong, or some elements are at map coordinates and others near zero: export it again"
        )
    size = np.ptp(np.vstack([mesh.vertices_ifc_m for mesh in kept]), axis=0)
    if size[2] > _MAX_HEIGHT_M or size.max() < _MIN_SIZE_M:
        raise ModelError(
            f"the building model is {size[0]:.3g} x {size[1]:.3g} m in plan and {size[2]:.3g} m high (limits: largest "
            f"dimension {_MIN_SIZE_M:g} m or more, height {_MAX_HEIGHT_M:,.0f} m or less); its length unit "
            "(IfcUnitAssignment) is wrong: export it again"
        )
    if not dropped:
        return kept, ""
    guids = ", ".join(dropped[:5]) + (" ..." if len(dropped) > 5 else "")
    remark = f"{len(dropped)} elements more than {_MAX_DISTANCE_M / 1000:g} km from the others were omitted ({guids})"
    _log.warning("%s", remark)
    return kept, remark
