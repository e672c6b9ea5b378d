"""LoGeoRef 50: IfcMapConversion, IfcMapConversionScaled, IfcRigidOperation and the property sets of IFC2x3.

Source: ISO 16739-1 (IFC 4 and 4.3), buildingSMART "User guide for geo-referencing in IFC" (the property sets).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import ifcopenshell
import numpy as np

from facadelake.building.model_georeference.ifc_statements import (
    find_crs_entity,
    find_operation_entity,
    has_angular_coordinates,
    read_number,
    read_property_set,
    require_number,
)
from facadelake.building.model_georeference.length_units import (
    LengthUnit,
    is_same_unit,
    list_unit_names,
    measure_unit,
    parse_unit_name,
    read_project_unit,
)
from facadelake.building.model_georeference.map_placement import MapPlacement, compute_grid_factors, geo_from_map
from facadelake.core.errors import GeoreferenceError
from facadelake.core.proj.crs import ELLIPSOIDAL, promote_to_3d

_MAX_SCALE_ERROR = 0.1  # a grid scale factor outside 1 +- this is a wrong unit, not a projection
_SAME_SHIFT = 0.001  # in the unit of the map
_NEARLY_SAME_UNIT = 1e-3  # the two feet, which differ by 2e-6, are both in the area of use


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
    values = read_property_set(model, "ePSet_MapConversion")
    by_properties = _operation_from_properties(values) if values else None
    if entity is None:
        return by_properties
    operation = _read_operation(entity)
    if operation is not None and by_properties is not None:
        _require_same_shift(operation, by_properties)
    return operation


def _read_operation(entity: ifcopenshell.entity_instance) -> CoordinateOperation | None:
    """The operation of an entity; None if its coordinates are in degrees."""
    if entity.is_a("IfcRigidOperation"):
        if has_angular_coordinates(entity):
            return None
        return CoordinateOperation(
            kind=entity.is_a(),
            east=require_number(entity, "FirstCoordinate"),
            north=require_number(entity, "SecondCoordinate"),
            height=read_number(entity, "Height") or 0.0,
            scale=None,
        )
    scale = read_number(entity, "Scale")
    scale = 1.0 if scale is None else scale
    if not scale > 0:
        raise GeoreferenceError(f"{entity.is_a()} has Scale {scale:g}; it must be more than 0")
    if entity.is_a("IfcMapConversionScaled"):
        factors = [require_number(entity, name) for name in ("FactorX", "FactorY", "FactorZ")]
    else:  # IFC4.3 before its second addendum has ScaleY and ScaleZ in IfcMapConversion itself
        stated = [read_number(entity, name) for name in ("ScaleY", "ScaleZ")]
        factors = [1.0, *(1.0 if value is None else value / scale for value in stated)]
    return CoordinateOperation(
        kind=entity.is_a(),
        east=require_number(entity, "Eastings"),
        north=require_number(entity, "Northings"),
        height=read_number(entity, "OrthogonalHeight") or 0.0,
        x_axis=_read_x_axis(entity.is_a(), read_number(entity, "XAxisAbscissa"), read_number(entity, "XAxisOrdinate")),
        scale=scale,
        factors=(factors[0], factors[1], factors[2]),
    )


@dataclass(frozen=True, kw_only=True)
class StatedPlacement:
    """A placement that the operation may mean, and the assumptions.

    ``reading`` names the unit in which map coordinates are read, and ``unit_m`` is its size. ``contradicts`` is the
    statement that this reading contradicts, empty if none. ``sigma_m``: shift between two units that are nearly the
    same, as the two feet are.
    """

    placement: MapPlacement
    remarks: str
    reading: str
    unit_m: float
    contradicts: str = ""
    sigma_m: float = 0.0


@dataclass(frozen=True, kw_only=True)
class _MapUnit:
    """A unit that the map coordinates may have; see ``StatedPlacement``."""

    unit: LengthUnit
    reading: str
    remark: str = ""
    contradicts: str = ""
    sigma_m: float = 0.0


def list_placements(
    model: ifcopenshell.file, operation: CoordinateOperation, map_crs: str, map_unit: LengthUnit | None
) -> Iterator[StatedPlacement]:
    """Yield the placements that the operation may mean, the standard's first.

    Exporters differ in the meaning of ``Scale`` and of an omitted ``MapUnit``, and write a MapUnit that is not that of
    the CRS; only interpretations with a metre scale within 10 % of 1, or of the scale of the map there, are kept.

    Args:
        model: the IFC.
        operation: its coordinate operation.
        map_crs: the projected CRS.
        map_unit: the portfolio's unit of map coordinates, which replaces MapUnit; None: there is none.

    Raises:
        GeoreferenceError: there is none, or MapUnit is not a unit of length.
    """
    project = read_project_unit(model)
    units = list(_list_map_units(model, operation, map_crs, map_unit, project))
    none_fits = True
    for one in units:
        grid_factor = _compute_grid_factor(operation, one.unit.metres, map_crs)
        for metre_scale, scale_remark in _list_metre_scales(operation, one.unit.metres / project.metres):
            if min(abs(metre_scale - 1), abs(metre_scale / grid_factor - 1)) <= _MAX_SCALE_ERROR:
                none_fits = False
                remarks = (one.unit.remark, one.remark, scale_remark, _describe_scale(operation, metre_scale))
                yield StatedPlacement(
                    placement=_placement_from_operation(operation, one.unit.metres, metre_scale),
                    remarks="; ".join(filter(None, remarks)),
                    reading=one.reading,
                    unit_m=one.unit.metres,
                    contradicts=one.contradicts,
                    sigma_m=one.sigma_m,
                )
                break
    if none_fits or any(abs(factor - 1) > _MAX_SCALE_ERROR for factor in operation.factors):
        raise GeoreferenceError(
            f"{operation.kind} has Scale {operation.scale} and factors {operation.factors}, the model's unit is "
            f"{project} and the map's {units[0].unit}: no interpretation gives a map scale within "
            f"{_MAX_SCALE_ERROR:.0%} of 1, so a unit is wrong; correct Scale or MapUnit, or set crs.placement in the "
            "portfolio"
        )


def _list_map_units(
    model: ifcopenshell.file,
    operation: CoordinateOperation,
    map_crs: str,
    map_unit: LengthUnit | None,
    project: LengthUnit,
) -> Iterator[_MapUnit]:
    """Yield the units that the map coordinates may have: the portfolio's, MapUnit, the project's or that of the CRS."""
    axis = promote_to_3d(map_crs).axis_info[0]
    of_crs = LengthUnit(name=axis.unit_name, metres=float(axis.unit_conversion_factor))
    by_crs = f"the unit of {map_crs}, {of_crs}"
    if map_unit is not None:
        remark = f"map coordinates are in {map_unit} by crs.map_unit of the portfolio"
        yield _MapUnit(unit=map_unit, reading="crs.map_unit", remark=remark)
        return
    stated = _read_map_unit(model)
    if stated is None:
        yield _MapUnit(unit=project, reading=f"the unit of the project, {project}")
        if not is_same_unit(of_crs.metres, project.metres):
            yield _MapUnit(unit=of_crs, reading=by_crs, remark=f"MapUnit is not given; {by_crs}, is assumed")
        return
    by_map_unit = f"MapUnit {stated}"
    if is_same_unit(stated.metres, of_crs.metres):
        yield _MapUnit(unit=stated, reading=by_map_unit)
        return
    conflict = f"{by_map_unit} is not {by_crs}"
    if abs(stated.metres / of_crs.metres - 1) > _NEARLY_SAME_UNIT:
        yield _MapUnit(unit=stated, reading=by_map_unit, remark=f"{conflict}; MapUnit was used")
        yield _MapUnit(unit=of_crs, reading=by_crs, contradicts=by_map_unit)
        return
    shift_m = max(abs(operation.east), abs(operation.north)) * abs(stated.metres - of_crs.metres)
    remark = (
        f"{conflict}, and the two are {shift_m:.2f} m apart here; correct MapUnit, or set crs.map_unit in the "
        "portfolio (foot or us_survey_foot)"
    )
    yield _MapUnit(unit=stated, reading=by_map_unit, remark=remark, sigma_m=shift_m)


def _require_same_shift(operation: CoordinateOperation, by_properties: CoordinateOperation) -> None:
    """Raise if an IfcMapConversion and ePSet_MapConversion of one IFC place the model differently."""
    shifts = [(one.east, one.north, one.height) for one in (operation, by_properties)]
    if not np.allclose(shifts[0], shifts[1], rtol=0, atol=_SAME_SHIFT):
        raise GeoreferenceError(
            f"{operation.kind} gives east, north, height {shifts[0]}, ePSet_MapConversion {shifts[1]}; remove the "
            "wrong one, or set crs.placement in the portfolio"
        )


def _compute_grid_factor(operation: CoordinateOperation, unit_m: float, map_crs: str) -> float:
    """Map metres per metre on the ground at the model's origin; 1 where that is not on the map.

    In EPSG:3857 it is 1.5 at 49 degrees.
    """
    map_m = np.array([[operation.east, operation.north, 0.0]]) * unit_m
    try:
        geo = geo_from_map(map_m, map_crs, ELLIPSOIDAL)[0]
        return compute_grid_factors(geo, map_crs, ELLIPSOIDAL).combined_factor
    except GeoreferenceError:
        return 1.0


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
    numbers: dict[str, float | None] = {}
    for name in ("Eastings", "Northings", "OrthogonalHeight", "XAxisAbscissa", "XAxisOrdinate", "Scale"):
        value = values.get(name)
        try:
            number = None if value is None or value == "" else float(value)
            is_finite = number is None or math.isfinite(number)
        except (TypeError, ValueError):
            number, is_finite = None, False
        if not is_finite:
            raise GeoreferenceError(
                f"ePSet_MapConversion.{name} is {value!r}, not a number; write it with a decimal point and without a "
                "unit, or set crs.placement in the portfolio"
            )
        numbers[name] = number
    if numbers["Eastings"] is None or numbers["Northings"] is None:
        raise GeoreferenceError(
            "ePSet_MapConversion has no Eastings or no Northings; add them, or set crs.placement in the portfolio"
        )
    return CoordinateOperation(
        kind="ePSet_MapConversion",
        east=numbers["Eastings"],
        north=numbers["Northings"],
        height=numbers["OrthogonalHeight"] or 0.0,
        x_axis=_read_x_axis("ePSet_MapConversion", numbers["XAxisAbscissa"], numbers["XAxisOrdinate"]),
        scale=1.0 if numbers["Scale"] is None else numbers["Scale"],
    )


def _read_x_axis(kind: str, abscissa: float | None, ordinate: float | None) -> tuple[float, float]:
    if abscissa is None and ordinate is None:
        return 1.0, 0.0  # the standard's default
    if abscissa is None or ordinate is None or abscissa == ordinate == 0.0:
        raise GeoreferenceError(
            f"{kind} has XAxisAbscissa {abscissa} and XAxisOrdinate {ordinate}, which is no direction; give both, or "
            "neither where the model's x axis is the map's east, or set crs.placement in the portfolio"
        )
    return abscissa, ordinate


def _read_map_unit(model: ifcopenshell.file) -> LengthUnit | None:
    """Read IfcProjectedCRS.MapUnit; None if it is not given."""
    crs = find_crs_entity(model)
    if crs is not None:
        unit = getattr(crs, "MapUnit", None)
        return None if unit is None else measure_unit(unit)
    name = str(read_property_set(model, "ePSet_ProjectedCRS").get("MapUnit") or "").strip()
    unit = parse_unit_name(name)
    if name and unit is None:
        raise GeoreferenceError(
            f"ePSet_ProjectedCRS.MapUnit is {name!r}; known units are {list_unit_names()}; correct it, or set "
            "crs.placement in the portfolio"
        )
    return unit
