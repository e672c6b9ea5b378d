"""Probable causes of a placement that is wrong as a whole, by the size of the shift that would correct it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from facadelake.core.arrays import Float64x3

_METRES_PER_FOOT = 0.3048
_RELATIVE_TOLERANCE = 0.02
# Geoid heights are -106 to 85 m on Earth; a shift of some metres has likelier causes.
GEOID_HEIGHT_MAX_M = 106.0
_GEOID_HEIGHT_M = (8.0, GEOID_HEIGHT_MAX_M)
# Shifts between national datums and WGS 84, horizontally.
_DATUM_SHIFT_M = (30.0, 900.0)


def suggest_causes(shifts_site_m: Sequence[Float64x3], height_ellipsoidal_m: float) -> str:
    """Probable causes in words.

    Args:
        shifts_site_m: shifts (3,) by which statements would agree with the placement.
        height_ellipsoidal_m: height of the placed cameras.
    """
    causes: list[str] = []
    for shift in shifts_site_m:
        up, horizontal = float(shift[2]), float(np.hypot(shift[0], shift[1]))
        corrected = height_ellipsoidal_m + up
        for factor, unit in ((_METRES_PER_FOOT, "feet read as metres"), (1 / _METRES_PER_FOOT, "metres read as feet")):
            if abs(up) > 1.0 and abs(corrected - factor * height_ellipsoidal_m) < _RELATIVE_TOLERANCE * abs(up):
                causes.append(f"heights in {unit} (the cameras lie {height_ellipsoidal_m:.1f} m high)")
        if _GEOID_HEIGHT_M[0] <= abs(up) <= _GEOID_HEIGHT_M[1]:
            causes.append(
                f"heights above the geoid taken as ellipsoidal, or the reverse (a shift of {up:+.1f} m in height has "
                "the size of a geoid height)"
            )
        if _DATUM_SHIFT_M[0] <= horizontal <= _DATUM_SHIFT_M[1]:
            causes.append(
                f"another datum or CRS (a horizontal shift of {horizontal:.0f} m has the size of a datum shift)"
            )
        elif horizontal > _DATUM_SHIFT_M[1]:
            causes.append("east and north exchanged, or another zone of the CRS")
    unique = list(dict.fromkeys(causes))
    return "Probable causes: " + "; ".join(
        unique or ["control points, poses, GPS or model of another place, or a wrong CRS or vertical datum"]
    )
