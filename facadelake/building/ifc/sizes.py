"""Check the size of doors and storeys against what can be built: a wrong length unit makes them impossible."""

from __future__ import annotations

from collections.abc import Sequence

import ifcopenshell
import numpy as np

from facadelake.building.ifc.meshes import ElementMesh
from facadelake.core.errors import ModelError

# Medians: gates of hangars are 25 m high, access doors of shafts 1 m; the storeys of a tower may be 100 m apart.
_DOOR_HEIGHTS_M = (1.0, 25.0)
_STOREY_RISES_M = (1.0, 250.0)
_MIN_RISE_M = 1.0  # storeys nearer than this are levels of one storey: raw and finished floor
_USUAL_DOOR_M, _USUAL_RISE_M = 2.1, 3.0
_UNITS_M = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254, "feet": 0.3048}
_MATCH = 1.35  # a unit fits if it brings the median within this factor of the usual


def check_sizes(model: ifcopenshell.file, meshes: Sequence[ElementMesh], storey_levels_m: Sequence[float]) -> str:
    """Check the heights of doors and the rises of storeys, in metres by the model's length unit.

    Returns a remark where both fit another unit better, else an empty text. Raises ModelError where one is impossible.
    """
    doors = [float(np.ptp(mesh.vertices_ifc_m[:, 2])) for mesh in meshes if model.by_id(mesh.step_id).is_a("IfcDoor")]
    rises = np.diff(sorted(storey_levels_m))
    measured = {
        "doors are": (doors, _DOOR_HEIGHTS_M, _USUAL_DOOR_M, "m high"),
        "storeys are": (
            [float(rise) for rise in rises if rise >= _MIN_RISE_M],
            _STOREY_RISES_M,
            _USUAL_RISE_M,
            "m apart",
        ),
    }
    fitting: list[str] = []
    for what, (sizes, (smallest, largest), usual, unit) in measured.items():
        if not sizes:
            continue
        median = float(np.median(sizes))
        suspect = _suspect_unit(median, usual)
        if not smallest <= median <= largest:
            guess = f"; it may be {suspect}" if suspect else ""
            raise ModelError(
                f"the model's {what} {median:,.4g} {unit} (median of {len(sizes)}; limits {smallest:g} to {largest:g} "
                f"m), so its length unit (IfcUnitAssignment) is wrong{guess}: correct it, or export the model again"
            )
        if suspect:
            fitting.append(f"{what} {median:.2f} {unit}, as if the unit were {suspect}")
    return f"the model's {' and '.join(fitting)}; check its length unit" if len(fitting) == len(measured) else ""


def _suspect_unit(median_m: float, usual_m: float) -> str:
    """The unit whose numbers, read as metres or the reverse, explain ``median_m``; empty if none does."""
    for name, unit_m in _UNITS_M.items():
        if 1 / _MATCH <= median_m * unit_m / usual_m <= _MATCH:
            return name
        if 1 / _MATCH <= median_m / unit_m / usual_m <= _MATCH:
            return f"metres, not {name}"
    return ""
