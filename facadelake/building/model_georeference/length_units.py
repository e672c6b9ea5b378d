"""Units of length of an IFC in metres, by ConversionFactor: of the project, and of map coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import ifcopenshell
import ifcopenshell.util.unit

from facadelake.core.errors import GeoreferenceError, ModelError

US_SURVEY_FOOT_M = 1200 / 3937
# What a unit's name says. Exporters write one name for both feet, so it is only compared with ConversionFactor.
_METRES_BY_NAME = {
    "METRE": (1.0,), "METER": (1.0,), "METRES": (1.0,), "METERS": (1.0,), "M": (1.0,),
    "CENTIMETRE": (0.01,), "CENTIMETER": (0.01,), "CM": (0.01,),
    "MILLIMETRE": (0.001,), "MILLIMETER": (0.001,), "MM": (0.001,),
    "KILOMETRE": (1000.0,), "KILOMETER": (1000.0,), "KM": (1000.0,),
    "INCH": (0.0254,), "YARD": (0.9144,), "MILE": (1609.344,),
    "FOOT": (0.3048, US_SURVEY_FOOT_M), "FEET": (0.3048, US_SURVEY_FOOT_M), "FT": (0.3048, US_SURVEY_FOOT_M),
    "INTERNATIONAL FOOT": (0.3048,), "SURVEY FOOT": (US_SURVEY_FOOT_M,), "FTUS": (US_SURVEY_FOOT_M,),
    "US SURVEY FOOT": (US_SURVEY_FOOT_M,), "US SURVEY FEET": (US_SURVEY_FOOT_M,), "US FOOT": (US_SURVEY_FOOT_M,),
}  # fmt: skip
_SAME_UNIT = 1e-7  # relative; the two feet differ by 2e-6


@dataclass(frozen=True, kw_only=True)
class LengthUnit:
    """A unit of length: its name and size; ``remark`` says what was assumed or contradicts it, empty if nothing."""

    name: str
    metres: float
    remark: str = ""

    def __str__(self) -> str:
        return f"{self.name} ({self.metres:.10g} m)"


def is_same_unit(first_m: float, second_m: float) -> bool:
    """Whether two units are one; the international and the US survey foot are not."""
    return abs(first_m / second_m - 1) < _SAME_UNIT


def read_project_unit(model: ifcopenshell.file) -> LengthUnit:
    """Read the unit of the model's lengths.

    Raises ModelError if the IFC states several, or one that is no length in metres.
    """
    found: dict[int, ifcopenshell.entity_instance] = {}
    for project in model.by_type("IfcProject"):
        for unit in project.UnitsInContext.Units if getattr(project, "UnitsInContext", None) else ():
            if getattr(unit, "UnitType", None) == "LENGTHUNIT":
                found[unit.id()] = unit
    try:
        units = [measure_unit(unit) for unit in found.values()]
    except GeoreferenceError as error:
        raise ModelError(f"the model's length unit (IfcUnitAssignment): {error}") from error
    if not units:
        return LengthUnit(name="METRE", metres=1.0, remark="the IFC states no length unit; metres are assumed")
    different = [unit for unit in units if not is_same_unit(unit.metres, units[0].metres)]
    if different:
        raise ModelError(
            f"the IFC states several length units ({', '.join(str(unit) for unit in units)}), so the size of the "
            "building is unknown; export it again with one unit in IfcUnitAssignment"
        )
    return units[0]


def measure_unit(unit: ifcopenshell.entity_instance) -> LengthUnit:
    """Measure an IfcNamedUnit of length, by its ConversionFactor, not by its name.

    Raises GeoreferenceError if it is not a length, or has no usable factor.
    """
    name = f"{getattr(unit, 'Prefix', None) or ''}{getattr(unit, 'Name', None) or unit.is_a()}"
    if getattr(unit, "UnitType", None) != "LENGTHUNIT":
        raise GeoreferenceError(f"the unit {name} is not a unit of length; correct it in the IFC")
    if unit.is_a("IfcContextDependentUnit"):
        raise GeoreferenceError(f"the unit {name} has no size (IfcContextDependentUnit); use one with ConversionFactor")
    try:
        metres = float(ifcopenshell.util.unit.get_named_unit_scale(unit))
    except (AttributeError, TypeError, ValueError, KeyError, RuntimeError) as error:
        raise GeoreferenceError(
            f"the ConversionFactor of the unit {name} cannot be read ({error}); correct it in the IFC"
        ) from error
    if not 0 < metres < float("inf"):
        raise GeoreferenceError(f"the ConversionFactor of the unit {name} is {metres:g} m; it must be more than 0")
    return LengthUnit(name=name, metres=metres, remark=_describe_contradiction(name, metres))


def parse_unit_name(name: str) -> LengthUnit | None:
    """The unit of a name alone, as property sets have it; None if the name is unknown."""
    metres = _METRES_BY_NAME.get(_normalise_name(name))
    return LengthUnit(name=name, metres=metres[0]) if metres else None


def list_unit_names() -> str:
    """The known names, for messages."""
    return ", ".join(_METRES_BY_NAME)


def _normalise_name(name: str) -> str:
    return " ".join(name.upper().replace(".", "").replace("_", " ").replace("-", " ").split())


def _describe_contradiction(name: str, metres: float) -> str:
    """Remark that the size is not that of the name. Raises GeoreferenceError if it is another unit altogether."""
    known = _METRES_BY_NAME.get(_normalise_name(name), (metres,))
    if any(is_same_unit(metres, value) for value in known):
        return ""
    nearest = min(known, key=lambda value: round(abs(value / metres - 1), 4))  # of equally wrong ones the first
    text = f"the unit {name} has the ConversionFactor {metres:.10g} m, but that name means {nearest:.10g} m"
    if abs(nearest / metres - 1) > 1e-3:
        raise GeoreferenceError(f"{text}; correct one of them in the IFC")
    return f"{text}; ConversionFactor was used"
