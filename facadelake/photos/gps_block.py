"""The position of an EXIF GPS block: latitude, longitude and altitude, with their references.

EXIF wants three unsigned rationals (degrees, minutes, seconds) and a reference letter. Converters write one rational
(decimal degrees) or two (degrees, decimal minutes), 0/0 for parts that are not used, signed numbers, and words as
references. What has one meaning is read, what could have two is not: a missing reference is never taken as north, east
or above.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from facadelake.photos.exif_values import parse_number, parse_text

_UNITS = (1, 60, 3600)  # parts of a degree
_PART_NAMES = ("degrees", "minutes", "seconds")
_SIGNS = {
    "latitude": {"N": 1, "NORTH": 1, "S": -1, "SOUTH": -1},
    "longitude": {"E": 1, "EAST": 1, "W": -1, "WEST": -1},
}
_LETTERS = {"latitude": "NS", "longitude": "EW"}
_DIRECTIONS = {"latitude": "north or south", "longitude": "east or west"}
# Values of GPSAltitudeRef: 0 and 1 above and below sea level, 2 and 3 above and below the ellipsoid (EXIF 3.0).
_ALTITUDE_REFS = {"0": 0, "1": 1, "2": 2, "3": 3, "ABOVE SEA LEVEL": 0, "BELOW SEA LEVEL": 1}
_BELOW = (1, 3)


@dataclass(frozen=True, kw_only=True)
class GpsAngle:
    """Latitude or longitude of a GPS block.

    ``angle_deg`` is NaN where it is missing or not readable. Where only the hemisphere is unknown, ``magnitude_deg`` is
    a number and ``problem`` says why. ``step_deg`` is the resolution as written.
    """

    angle_deg: float = math.nan
    magnitude_deg: float = math.nan
    step_deg: float = math.nan
    problem: str = ""
    warning: str = ""


@dataclass(frozen=True, kw_only=True)
class GpsAltitude:
    """Altitude of a GPS block (NaN where it is missing or ambiguous), its resolution as written, and its reference.

    ``ref`` is None where it is not stated.
    """

    altitude_m: float = math.nan
    step_m: float = math.nan
    ref: int | None = None
    warning: str = ""


def _format_value(value: Any) -> str:
    parts = value if isinstance(value, tuple | list) else [value]
    return ", ".join(parse_text(part)[:40] or "''" for part in parts[:4])


def _find_step(parts: list[Any]) -> float:
    """The resolution in degrees, by the denominators of the fractions of degrees, minutes, seconds."""
    steps = [
        1 / (unit * part.denominator)
        for part, unit in zip(parts, _UNITS, strict=False)
        if getattr(part, "denominator", 0) > 0 and math.isfinite(parse_number(part))
    ]
    return min(steps, default=math.nan)


def _parse_parts(value: Any) -> tuple[list[float], str]:
    """Degrees, minutes, seconds (unused ones are 0), and why they are not an angle; empty where they are."""
    parts = list(value) if isinstance(value, tuple | list) else [value]
    if not 1 <= len(parts) <= 3 or any(isinstance(part, str | bytes) for part in parts):
        return [], "is not degrees, minutes and seconds"
    numbers = [parse_number(part) for part in parts]
    while len(numbers) > 1 and math.isnan(numbers[-1]):  # 0/0: not used
        numbers.pop()
    if len(numbers) < len(parts) and getattr(parts[len(numbers) - 1], "denominator", 1) == 1:
        return [], f"has whole {_PART_NAMES[len(numbers) - 1]} and no {_PART_NAMES[len(numbers)]}"
    numbers += [0.0] * (3 - len(numbers))
    if not all(map(math.isfinite, numbers)):
        return [], "has a part that is no number"
    for number, name in zip(numbers[1:], _PART_NAMES[1:], strict=True):
        if abs(number) > 60:  # exactly 60 comes from rounding
            return [], f"has {number:g} {name}, above 60"
    for k in (0, 1):
        if numbers[k] % 1 and any(numbers[k + 1 :]):
            return [], f"has a fraction of {_PART_NAMES[k]} beside {_PART_NAMES[k + 1]} or seconds"
    signs = {math.copysign(1, number) for number in numbers if number}
    if len(signs) > 1 and next(number for number in numbers if number) > 0:
        return [], "has parts of different signs"
    return numbers, ""


def parse_gps_angle(value: Any, ref: Any, axis: str) -> GpsAngle:
    """Latitude or longitude.

    Args:
        value: GPSLatitude or GPSLongitude, as Pillow returns it; None where it is missing.
        ref: its reference.
        axis: ``latitude`` or ``longitude``.

    Returns:
        The angle, or the problem: out of range, ambiguous, or of unknown hemisphere.
    """
    tag = f"GPS{axis.capitalize()}"
    if value is None:
        return GpsAngle(problem=f"no {axis}")
    numbers, problem = _parse_parts(value)
    if problem:
        return GpsAngle(problem=f"{tag} {_format_value(value)} {problem}")
    sign = -1 if any(number < 0 for number in numbers) else 1
    magnitude_deg = sum(abs(number) / unit for number, unit in zip(numbers, _UNITS, strict=True))
    step_deg = _find_step(list(value) if isinstance(value, tuple | list) else [value])
    text = parse_text(ref)
    by_ref = _SIGNS[axis].get(text.upper())
    unsigned = GpsAngle(magnitude_deg=magnitude_deg, step_deg=step_deg)
    if by_ref is None and text:
        problem = f"{tag}Ref is '{text[:20]}', which is neither of {' and '.join(_LETTERS[axis])}"
    elif by_ref is None and sign > 0 and magnitude_deg:
        problem = f"{tag}Ref is missing, so that {_DIRECTIONS[axis]} is unknown"
    elif by_ref == 1 and sign < 0:
        problem = f"{tag} is negative and its reference is {text}"
    if problem:
        return GpsAngle(**(vars(unsigned) | {"problem": problem}))
    warning = ""
    if sign < 0:
        stated = f"and its reference is {text}" if text else "and has no reference"
        warning = f"{tag} is negative {stated}; taken as {_LETTERS[axis][1]}"
    elif isinstance(value, tuple | list) and any(math.isnan(parse_number(part)) for part in value):
        warning = f"{tag} has 0/0 in place of its last part; taken as {magnitude_deg:.6f} degrees"
    angle_deg = (by_ref or sign) * magnitude_deg
    return GpsAngle(angle_deg=angle_deg, step_deg=step_deg, warning=warning)


def parse_altitude_ref(value: Any) -> int | None:
    """The reference of an altitude by number or words; None where it is none of them."""
    if isinstance(value, bytes) and len(value) == 1 and value[0] < 4:
        return value[0]
    if isinstance(value, tuple | list) and len(value) == 1:
        value = value[0]
    return _ALTITUDE_REFS.get(parse_text(value).upper())


def parse_gps_altitude(value: Any, ref: Any) -> GpsAltitude:
    """The altitude, negative below its reference; NaN with a warning where its sign is ambiguous."""
    if value is None:
        return GpsAltitude()
    altitude_m = parse_number(value)
    if not math.isfinite(altitude_m):
        # 0/0 is how EXIF writes an unknown number.
        return (
            GpsAltitude()
            if parse_text(value) in ("nan", "")
            else GpsAltitude(warning=f"GPSAltitude {_format_value(value)} is not a number; the height is not used")
        )
    if ref is None or (parse_text(ref) == "" and not isinstance(ref, bytes)):
        number = None
    else:
        number = parse_altitude_ref(ref)
        if number is None:
            shown = parse_text(ref)[:20] or repr(ref)
            return GpsAltitude(
                warning=f"GPSAltitudeRef '{shown}' is neither above nor below; height {altitude_m:.1f} m is not used"
            )
    if altitude_m < 0 and number in _BELOW:
        return GpsAltitude(
            ref=number,
            warning=f"GPSAltitude is {altitude_m:.1f} m and its reference is 'below'; the height is not used",
        )
    warning = ""
    if altitude_m < 0 and number is not None:
        warning = f"GPSAltitude is {altitude_m:.1f} m and its reference is 'above'; taken as below"
    denominator = parse_number(getattr(value, "denominator", 0))
    return GpsAltitude(
        altitude_m=-altitude_m if number in _BELOW else altitude_m,
        step_m=1 / denominator if denominator > 0 else math.nan,
        ref=number,
        warning=warning,
    )
