"""LoGeoRef 50: IfcMapConversion, IfcMapConversionScaled, IfcRigidOperation and the property sets of IFC2x3.

Source: ISO 16739-1 (IFC 4 and 4.3), buildingSMART "User guide for geo-referencing in IFC" (the property sets).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import ifcopenshell
import ifcopenshell.util.element
import ifcopenshell.util.unit
import numpy as np

from facadelake.building.model_georeference.map_placement import MapPlacement
from facadelake.core.errors import GeoreferenceError
from facadelake.core.geodesy import promote_to_3d

_MAX_SCALE_ERROR = 0.1  # a grid scale factor outside 1 +- this is a wrong unit, not a projection
_UNITS_2X3 = {"METRE": 1.0, "METER": 1.0, "METRES": 1.0, "METERS": 1.0, "M": 1.0, "MILLIMETRE": 0.001, "MM": 0.001,
              "FOOT": 0.3048, "FEET": 0.3048, "US SURVEY FOOT": 1200 / 3937}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class CoordinateOperation:
    """The IFC's operation from its axes to the map, in the IFC's units.

    ``kind`` is the IFC class or property set. ``scale`` is None where the kind has none (IfcRigidOperation), so that
    lengths are kept. ``factors`` are those of IfcMapConversionScaled.
    """

    kind: str
    east: float
    north: float
    height: float
    x_axis: tuple[float, float] = (1.0, 0.0)
    scale: float | None = 1.0
    factors: tuple[float, float, float] = (1.0, 1.0, 1.0)


def read_coordinate_operation(model: ifcopenshell.file) -> CoordinateOperation | None:
    """Read the operation from the model's axes to the map; None if the IFC has none, or one in degrees."""
    entity = find_operation_entity(model)
    if entity is None:
        values = read_property_set(model, "ePSet_MapConversion")
        return _operation_from_properties(values) if values else None
    if entity.is_a("IfcRigidOperation"):
        if has_angular_coordinates(entity):
            return None
        east, north = entity.FirstCoordinate.wrappedValue, entity.SecondCoordinate.wrappedValue
        return CoordinateOperation(
            kind=entity.is_a(), east=float(east), north=float(north), height=float(entity.Height or 0), scale=None
        )
    scale = float(entity.Scale or 1.0)
    # IFC4.3 before its second addendum has ScaleY and ScaleZ in IfcMapConversion itself.
    factors = [1.0, float(getattr(entity, "ScaleY", None) or scale) / scale, 1.0]
    factors[2] = float(getattr(entity, "ScaleZ", None) or scale) / scale
    if entity.is_a("IfcMapConversionScaled"):
        factors = [float(value) for value in (entity.FactorX, entity.FactorY, entity.FactorZ)]
    return CoordinateOperation(
        kind=entity.is_a(),
        east=float(entity.Eastings),
        north=float(entity.Northings),
        height=float(entity.OrthogonalHeight or 0.0),
        x_axis=_read_x_axis(entity.XAxisAbscissa, entity.XAxisOrdinate),
        scale=scale,
        factors=(factors[0], factors[1], factors[2]),
    )


def find_operation_entity(model: ifcopenshell.file) -> ifcopenshell.entity_instance | None:
    """Find the IfcCoordinateOperation of the 3D context, else of another context; None if there is none."""
    operations = _list_entities(model, "IfcCoordinateOperation")
    of_contexts = [
        operation
        for operation in operations
        if operation.SourceCRS is not None and operation.SourceCRS.is_a("IfcGeometricRepresentationContext")
    ]
    of_contexts.sort(key=lambda operation: operation.SourceCRS.ContextType != "Model")
    preferred = of_contexts or operations
    return preferred[0] if preferred else None


def find_crs_entity(model: ifcopenshell.file) -> ifcopenshell.entity_instance | None:
    """IfcProjectedCRS of the coordinate operation, or the first of the file; None without any."""
    operation = find_operation_entity(model)
    if operation is not None:
        return operation.TargetCRS
    found = _list_entities(model, "IfcCoordinateReferenceSystem")
    return found[0] if found else None


def has_angular_coordinates(rigid: ifcopenshell.entity_instance) -> bool:
    """Whether an IfcRigidOperation has coordinates in degrees, so that its target is a geographic CRS."""
    return bool(rigid.FirstCoordinate.is_a() in ("IfcPlaneAngleMeasure", "IfcPositivePlaneAngleMeasure"))


def list_placements(
    model: ifcopenshell.file, operation: CoordinateOperation, map_crs: str
) -> Iterator[tuple[MapPlacement, str]]:
    """Yield the placements that the operation may mean, the standard's first, each with a remark on its assumptions.

    Exporters differ in the meaning of ``Scale`` and of an omitted ``MapUnit``; only interpretations with a metre scale
    within 10 % of 1 are kept. Raises GeoreferenceError if there is none.
    """
    project_m = float(ifcopenshell.util.unit.calculate_unit_scale(model))
    map_unit_m = _read_map_unit_m(model)
    crs_m = float(promote_to_3d(map_crs).axis_info[0].unit_conversion_factor)
    units = [(map_unit_m, "")] if map_unit_m else [(project_m, "")]
    if not map_unit_m and abs(crs_m - project_m) > 1e-9:
        units.append((crs_m, f"MapUnit is not given; the unit of {map_crs} is assumed"))
    none_fits = True
    for unit_m, unit_remark in units:
        for metre_scale, scale_remark in _list_metre_scales(operation, unit_m / project_m):
            if abs(metre_scale - 1) <= _MAX_SCALE_ERROR:
                none_fits = False
                remarks = (unit_remark, scale_remark, _describe_scale(operation, metre_scale))
                yield _placement_from_operation(operation, unit_m, metre_scale), "; ".join(filter(None, remarks))
                break
    if none_fits or any(abs(factor - 1) > _MAX_SCALE_ERROR for factor in operation.factors):
        raise GeoreferenceError(
            f"{operation.kind} has Scale {operation.scale} and factors {operation.factors}, the model's unit is "
            f"{project_m:g} m and the map's {map_unit_m or crs_m:g} m: no interpretation gives a map scale within "
            f"{_MAX_SCALE_ERROR:.0%} of 1, so a unit is wrong; correct Scale or MapUnit, or set crs.placement in the "
            "portfolio"
        )


def read_property_set(model: ifcopenshell.file, name: str) -> dict[str, Any]:
    """Read a property set of the project or, as in the user guide, of the site; empty if there is none."""
    for holder in [*model.by_type("IfcProject"), *model.by_type("IfcSite")]:
        for found, values in ifcopenshell.util.element.get_psets(holder, psets_only=True).items():
            if found.lower() == name.lower():  # exporters write ePset and ePSet
                return dict(values)
    return {}


def _list_metre_scales(operation: CoordinateOperation, unit_ratio: float) -> list[tuple[float, str]]:
    if operation.scale is None:
        return [(1.0, "")]
    remark = "Scale is taken as a factor between metres because it does not contain the ratio of the units"
    return [(operation.scale * unit_ratio, ""), (operation.scale, remark)]


def _describe_scale(operation: CoordinateOperation, metre_scale: float) -> str:
    if operation.kind == "IfcMapConversionScaled" and operation.factors != (1.0, 1.0, 1.0):
        return f"the map's scale factors along x, y, z are {', '.join(f'{f:.6f}' for f in operation.factors)}"
    if abs(metre_scale - 1) > 1e-9:
        return f"Scale is taken as the grid scale factor {metre_scale:.6f} of east and north only"
    return ""


def _placement_from_operation(operation: CoordinateOperation, unit_m: float, metre_scale: float) -> MapPlacement:
    x, y, z = operation.factors
    return MapPlacement(
        east_m=operation.east * unit_m,
        north_m=operation.north * unit_m,
        height_m=operation.height * unit_m,
        rotation_deg=float(np.degrees(np.arctan2(operation.x_axis[1], operation.x_axis[0]))),
        # Scale without the ratio of the units is the projection's grid scale factor, which does not apply to heights.
        scale=(metre_scale * x, metre_scale * y, z),
    )


def _operation_from_properties(values: dict[str, Any]) -> CoordinateOperation:
    """The operation of ePSet_MapConversion. Raises GeoreferenceError if a value is not a number or is missing."""
    numbers = {}
    for name in ("Eastings", "Northings", "OrthogonalHeight", "XAxisAbscissa", "XAxisOrdinate", "Scale"):
        value = values.get(name)
        try:
            numbers[name] = None if value is None or value == "" else float(value)
        except (TypeError, ValueError) as error:
            raise GeoreferenceError(
                f"ePSet_MapConversion.{name} is {value!r}, not a number; write it with a decimal point and without a "
                "unit, or set crs.placement in the portfolio"
            ) from error
    if numbers["Eastings"] is None or numbers["Northings"] is None:
        raise GeoreferenceError(
            "ePSet_MapConversion has no Eastings or no Northings; add them, or set crs.placement in the portfolio"
        )
    return CoordinateOperation(
        kind="ePSet_MapConversion",
        east=numbers["Eastings"],
        north=numbers["Northings"],
        height=numbers["OrthogonalHeight"] or 0.0,
        x_axis=_read_x_axis(numbers["XAxisAbscissa"], numbers["XAxisOrdinate"]),
        scale=numbers["Scale"] or 1.0,
    )


def _read_x_axis(abscissa: float | None, ordinate: float | None) -> tuple[float, float]:
    if not abscissa and not ordinate:
        return 1.0, 0.0
    return float(abscissa or 0.0), float(ordinate or 0.0)


def _read_map_unit_m(model: ifcopenshell.file) -> float | None:
    """Read IfcProjectedCRS.MapUnit in metres; None if it is not given."""
    crs = find_crs_entity(model)
    if crs is None:
        name = str(read_property_set(model, "ePSet_ProjectedCRS").get("MapUnit") or "").strip().upper()
        if name and name not in _UNITS_2X3:
            raise GeoreferenceError(
                f"ePSet_ProjectedCRS.MapUnit is {name!r}; known units are {', '.join(_UNITS_2X3)}; correct it, or set "
                "crs.placement in the portfolio"
            )
        return _UNITS_2X3.get(name)
    unit = getattr(crs, "MapUnit", None)
    if unit is None:
        return None
    metre = model.create_entity("IfcSIUnit", None, "LENGTHUNIT", None, "METRE")
    return float(ifcopenshell.util.unit.convert_unit(1.0, unit, metre))


def _list_entities(model: ifcopenshell.file, kind: str) -> list[ifcopenshell.entity_instance]:
    try:
        return list(model.by_type(kind))
    except RuntimeError:  # the schema has no such class
        return []
