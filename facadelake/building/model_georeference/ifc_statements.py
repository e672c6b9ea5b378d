"""Find what an IFC states of its georeference: coordinate operation, CRS, property sets; differing ones are refused."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import ifcopenshell
import ifcopenshell.util.element

from facadelake.building.model_georeference.length_units import measure_unit
from facadelake.core.errors import GeoreferenceError


def find_operation_entity(model: ifcopenshell.file) -> ifcopenshell.entity_instance | None:
    """Find the IfcCoordinateOperation of the 3D context, else of another context; None if there is none.

    Raises GeoreferenceError if several of them place the model differently.
    """
    operations = list_entities(model, "IfcCoordinateOperation")
    of_contexts = [
        operation
        for operation in operations
        if operation.SourceCRS is not None and operation.SourceCRS.is_a("IfcGeometricRepresentationContext")
    ]
    of_model = [operation for operation in of_contexts if operation.SourceCRS.ContextType == "Model"]
    preferred = of_model or of_contexts or operations
    _require_one_statement("coordinate operations", [_describe_operation(entity) for entity in preferred])
    return preferred[0] if preferred else None


def find_crs_entity(model: ifcopenshell.file) -> ifcopenshell.entity_instance | None:
    """IfcProjectedCRS of the coordinate operation, or the file's only one; None without any.

    Raises GeoreferenceError if the file has different ones and no coordinate operation.
    """
    operation = find_operation_entity(model)
    if operation is not None:
        return operation.TargetCRS
    found = list_entities(model, "IfcCoordinateReferenceSystem")
    _require_one_statement("coordinate reference systems", [_describe_crs(entity) for entity in found])
    return found[0] if found else None


def read_property_set(model: ifcopenshell.file, name: str) -> dict[str, Any]:
    """Read a property set of the project or, as in the user guide, of the site; empty if there is none.

    Raises GeoreferenceError if several of that name differ.
    """
    found = []
    for holder in [*model.by_type("IfcProject"), *model.by_type("IfcSite")]:
        for key, values in ifcopenshell.util.element.get_psets(holder, psets_only=True).items():
            if key.lower() == name.lower():  # exporters write ePset and ePSet
                found.append({key: value for key, value in values.items() if key != "id"})
    texts = [", ".join(f"{key} {value}" for key, value in sorted(values.items())) for values in found]
    _require_one_statement(f"property sets {name}", texts)
    return found[0] if found else {}


def has_angular_coordinates(rigid: ifcopenshell.entity_instance) -> bool:
    """Whether an IfcRigidOperation has coordinates in degrees, so that its target is a geographic CRS."""
    return bool(rigid.FirstCoordinate.is_a() in ("IfcPlaneAngleMeasure", "IfcPositivePlaneAngleMeasure"))


def require_number(entity: ifcopenshell.entity_instance, name: str) -> float:
    """Read an attribute. Raises GeoreferenceError if it is missing or not a finite number."""
    value = read_number(entity, name)
    if value is None:
        raise GeoreferenceError(f"{entity.is_a()} has no {name}; add it, or set crs.placement in the portfolio")
    return value


def read_number(entity: ifcopenshell.entity_instance, name: str) -> float | None:
    """Read an attribute; None if it is not given. Raises GeoreferenceError if it is not a finite number."""
    value = getattr(entity, name, None)
    value = getattr(value, "wrappedValue", value)
    if value is None:
        return None
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise GeoreferenceError(
            f"{entity.is_a()}.{name} is {value!r}, not a finite number; correct it, or set crs.placement in the "
            "portfolio"
        )
    return number


def list_entities(model: ifcopenshell.file, kind: str) -> list[ifcopenshell.entity_instance]:
    """All entities of a class; none where the schema has no such class."""
    try:
        return list(model.by_type(kind))
    except RuntimeError:
        return []


def _describe_operation(entity: ifcopenshell.entity_instance) -> str:
    values = [
        f"{name} {getattr(value, 'wrappedValue', value)}"
        for name, value in entity.get_info(recursive=False, include_identifier=False).items()
        if name not in ("type", "SourceCRS", "TargetCRS") and value is not None
    ]
    target = _describe_crs(entity.TargetCRS) if entity.TargetCRS is not None else "no CRS"
    return f"{entity.is_a()} to {target} ({', '.join(values)})"


def _describe_crs(entity: ifcopenshell.entity_instance) -> str:
    """Name, and what else decides a position."""
    parts = [str(entity.Name or "without a name")]
    for name in ("VerticalDatum", "MapUnit"):
        value = getattr(entity, name, None)
        if value is not None:
            parts.append(f"{name} {measure_unit(value) if name == 'MapUnit' else value}")
    return ", ".join(parts)


def _require_one_statement(kind: str, statements: Sequence[str]) -> None:
    """Raise if the statements differ: the first one is not better than the others."""
    distinct = sorted(set(statements))
    if len(distinct) > 1:
        raise GeoreferenceError(
            f"the IFC states {len(distinct)} different {kind}: {'; '.join(distinct[:4])}; remove all but one, or set "
            "crs.map, crs.vertical and crs.placement (or crs.control) in the portfolio, which replace them"
        )
