"""Small IFC files written for a test: boxes in a storey, with the georeference a test asks for."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import ifcopenshell
import ifcopenshell.api
import ifcopenshell.api.owner.settings
import ifcopenshell.api.project
import numpy as np
import pytest


@dataclass(frozen=True, kw_only=True)
class Box:
    """A wall as a box: its size along x, y, z and its lowest corner, metres in the model's axes."""

    size_m: tuple[float, float, float] = (4.0, 0.3, 3.0)
    corner_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ifc_class: str = "IfcWall"
    name: str = "Wall"
    contained: bool = True


@dataclass(frozen=True, kw_only=True)
class Ifc:
    """What to write; ``conversion`` and ``crs`` are attributes of IfcMapConversion and IfcProjectedCRS."""

    boxes: Sequence[Box] = (Box(),)
    schema: str = "IFC4"
    milli: bool = False
    conversion: dict[str, float] = field(default_factory=dict)
    crs: dict[str, str] = field(default_factory=dict)
    map_unit_metre: bool = False


@pytest.fixture
def write_ifc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[Ifc], Path]:
    """Writes an Ifc to a file and returns its path."""

    def write(wanted: Ifc) -> Path:
        run = ifcopenshell.api.run
        model = ifcopenshell.api.project.create_file(version=wanted.schema)
        if wanted.schema == "IFC2X3":  # there every entity has an owner
            person = model.create_entity("IfcPerson", Id="nobody")
            firm = model.create_entity("IfcOrganization", Name="nobody")
            user = model.create_entity("IfcPersonAndOrganization", ThePerson=person, TheOrganization=firm)
            tool = model.create_entity("IfcApplication", firm, "1", "test", "test")
            monkeypatch.setattr(ifcopenshell.api.owner.settings, "get_user", lambda file: user)
            monkeypatch.setattr(ifcopenshell.api.owner.settings, "get_application", lambda file: tool)
        unit_m = 0.001 if wanted.milli else 1.0
        project = run("root.create_entity", model, ifc_class="IfcProject", name="test")
        length = run("unit.add_si_unit", model, unit_type="LENGTHUNIT", prefix="MILLI" if wanted.milli else None)
        run("unit.assign_unit", model, units=[length])
        context = run("context.add_context", model, context_type="Model")
        body = run(
            "context.add_context", model, context_type="Model", context_identifier="Body", target_view="MODEL_VIEW",
            parent=context,
        )  # fmt: skip
        site = run("root.create_entity", model, ifc_class="IfcSite", name="site")
        building = run("root.create_entity", model, ifc_class="IfcBuilding", name="building")
        run("aggregate.assign_object", model, products=[site], relating_object=project)
        run("aggregate.assign_object", model, products=[building], relating_object=site)
        storeys = []
        for level, name in ((0.0, "Ground floor"), (3.0, "First floor")):
            storey = run("root.create_entity", model, ifc_class="IfcBuildingStorey", name=name)
            run("aggregate.assign_object", model, products=[storey], relating_object=building)
            matrix = np.eye(4)
            matrix[2, 3] = level
            run("geometry.edit_object_placement", model, product=storey, matrix=matrix)
            storeys.append(storey)
        for box in wanted.boxes:
            element = run("root.create_entity", model, ifc_class=box.ifc_class, name=box.name)
            x, y, z = (value / unit_m for value in box.size_m)
            profile = model.create_entity(
                "IfcArbitraryClosedProfileDef", ProfileType="AREA",
                OuterCurve=model.create_entity(
                    "IfcPolyline",
                    [
                        model.create_entity("IfcCartesianPoint", corner)
                        for corner in ((0.0, 0.0), (x, 0.0), (x, y), (0.0, y), (0.0, 0.0))
                    ],
                ),
            )  # fmt: skip
            origin = model.create_entity(
                "IfcAxis2Placement3D", model.create_entity("IfcCartesianPoint", (0.0, 0.0, 0.0))
            )
            solid = model.create_entity(
                "IfcExtrudedAreaSolid", profile, origin, model.create_entity("IfcDirection", (0.0, 0.0, 1.0)), z
            )
            shape = model.create_entity("IfcShapeRepresentation", body, "Body", "SweptSolid", [solid])
            run("geometry.assign_representation", model, product=element, representation=shape)
            matrix = np.eye(4)
            matrix[:3, 3] = box.corner_m
            run("geometry.edit_object_placement", model, product=element, matrix=matrix)
            if box.contained:
                run("spatial.assign_container", model, products=[element], relating_structure=storeys[0])
        if wanted.crs:
            crs = model.create_entity("IfcProjectedCRS", **wanted.crs)
            if wanted.map_unit_metre:
                crs.MapUnit = model.create_entity("IfcSIUnit", None, "LENGTHUNIT", None, "METRE")
            if wanted.conversion:
                model.create_entity("IfcMapConversion", SourceCRS=context, TargetCRS=crs, **wanted.conversion)
        path = tmp_path / "model.ifc"
        model.write(str(path))
        return path

    return write
