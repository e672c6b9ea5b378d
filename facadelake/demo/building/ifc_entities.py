"""IFC entities of the demo building: profiles, extrusions, products and reproducible GlobalIds."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from typing import Any

import ifcopenshell
import ifcopenshell.api.root
import ifcopenshell.api.spatial
import ifcopenshell.guid
import numpy as np

from facadelake.demo.building.charts import Chart

# ifcopenshell's entities have no static types.
Entity = Any
NAMESPACE = uuid.UUID("6f6b2f0e-3f0c-5c0b-9f6d-0d6f6c616b65")

Point = tuple[float, float]


def _convert_to_floats(values: Sequence[float]) -> list[float]:
    """The values as Python floats, which IfcOpenShell requires."""
    return [float(v) for v in values]


def make_profile(
    model: ifcopenshell.file, points: Sequence[Point], segments: Sequence[Sequence[int]] | None = None
) -> Entity:
    """A closed area profile (IfcArbitraryClosedProfileDef); segments of three indices (from 1) are arcs."""
    segments = segments or [(*range(1, len(points) + 1), 1)]
    kinds = [
        model.create_entity("IfcArcIndex", list(s)) if len(s) == 3 else model.create_entity("IfcLineIndex", list(s))
        for s in segments
    ]
    coordinates = model.create_entity("IfcCartesianPointList2D", CoordList=[_convert_to_floats(p) for p in points])
    curve = model.create_entity("IfcIndexedPolyCurve", Points=coordinates, Segments=kinds)
    return model.create_entity("IfcArbitraryClosedProfileDef", ProfileType="AREA", OuterCurve=curve)


def extrude(model: ifcopenshell.file, profile: Entity, base_m: float, height_m: float) -> Entity:
    """Extrude a profile upwards (IfcExtrudedAreaSolid).

    Args:
        model: the file that gets the entity.
        profile: the profile, in the xy plane of the model.
        base_m: height of the lower end.
        height_m: height of the solid.
    """
    placement = model.create_entity(
        "IfcAxis2Placement3D", Location=model.create_entity("IfcCartesianPoint", Coordinates=(0.0, 0.0, float(base_m)))
    )
    up = model.create_entity("IfcDirection", DirectionRatios=(0.0, 0.0, 1.0))
    return model.create_entity(
        "IfcExtrudedAreaSolid", SweptArea=profile, Position=placement, ExtrudedDirection=up, Depth=float(height_m)
    )


def make_rectangle(x0: float, y0: float, x1: float, y1: float) -> list[Point]:
    """Corners of an axis-parallel rectangle in plan, anticlockwise.

    Args:
        x0: smallest x, metres.
        y0: smallest y, metres.
        x1: largest x, metres.
        y1: largest y, metres.
    """
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def make_tangent_rectangle(chart: Chart, u_m: float, width_m: float, out_from_m: float, out_to_m: float) -> list[Point]:
    """Plan corners of a rectangle tangent to a facade.

    Args:
        chart: the facade.
        u_m: centre of the rectangle along the facade.
        width_m: width along the tangent at ``u_m``.
        out_from_m: distance of its rear edge in front of the facade (negative: behind).
        out_to_m: distance of its front edge.
    """
    foot, along = chart.compute_points(np.array([u_m]), np.zeros(1))[0], chart.compute_tangent(u_m)
    out = chart.compute_normals(np.array([u_m]))[0]
    corners = [(-0.5, out_from_m), (-0.5, out_to_m), (0.5, out_to_m), (0.5, out_from_m)]
    plan = [foot + a * width_m * along + o * out for a, o in corners]
    return [(float(p[0]), float(p[1])) for p in plan]


def make_ring_sector(
    centre: Point, radius_in: float, radius_out: float, start_rad: float, end_rad: float
) -> tuple[list[Point], list[list[int]]]:
    """Points and segments of a sector of a ring in plan, with true arcs.

    Args:
        centre: centre of the ring.
        radius_in: inner radius.
        radius_out: outer radius.
        start_rad: start angle, anticlockwise from x.
        end_rad: end angle.
    """
    angles = np.linspace(start_rad, end_rad, 3)
    ring = [(radius_out, a) for a in angles] + [(radius_in, a) for a in angles[::-1]]
    points = [(float(centre[0] + r * np.cos(a)), float(centre[1] + r * np.sin(a))) for r, a in ring]
    return points, [[1, 2, 3], [3, 4], [4, 5, 6], [6, 1]]


def add_product(
    model: ifcopenshell.file, kind: str, name: str, storey: Entity, solids: Sequence[Entity], **attributes: Any
) -> Entity:
    """Add a product with a body at the model's origin, contained in a storey.

    Args:
        model: the file that gets the product.
        kind: its IFC class.
        name: its name.
        storey: the storey that contains it.
        solids: its body.
        attributes: further attributes of the product.
    """
    element = ifcopenshell.api.root.create_entity(model, ifc_class=kind, name=name, **attributes)
    set_body(model, element, solids)
    ifcopenshell.api.spatial.assign_container(model, products=[element], relating_structure=storey)
    return element


def set_body(model: ifcopenshell.file, element: Entity, solids: Sequence[Entity]) -> None:
    """Set the solids of an element as its 'Body', with a placement at the model's origin."""
    context = next(c for c in model.by_type("IfcGeometricRepresentationSubContext") if c.ContextIdentifier == "Body")
    shape = model.create_entity(
        "IfcShapeRepresentation",
        ContextOfItems=context,
        RepresentationIdentifier="Body",
        RepresentationType="SweptSolid",
        Items=list(solids),
    )
    element.Representation = model.create_entity("IfcProductDefinitionShape", Representations=[shape])
    origin = model.create_entity("IfcCartesianPoint", Coordinates=(0.0, 0.0, 0.0))
    element.ObjectPlacement = model.create_entity(
        "IfcLocalPlacement", RelativePlacement=model.create_entity("IfcAxis2Placement3D", Location=origin)
    )


def assign_stable_guids(model: ifcopenshell.file) -> None:
    """Replace random GlobalIds by hashes of class and name, so that a regenerated model has the same ones."""
    count_of: dict[str, int] = {}
    for entity in model.by_type("IfcRoot"):
        label = f"{entity.is_a()}|{entity.Name or ''}"
        count_of[label] = count_of.get(label, -1) + 1
        entity.GlobalId = ifcopenshell.guid.compress(uuid.uuid5(NAMESPACE, f"{label}|{count_of[label]}").hex)
