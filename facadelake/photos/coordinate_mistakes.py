"""Mistakes of writing longitude and latitude: a sign lost, the two exchanged; and how far apart two positions are."""

from __future__ import annotations

import math

from facadelake.core.proj.operations import METRES_PER_DEGREE

LonLat = tuple[float, float]

# One statement is the other with a mistake of writing where its correction brings it this near, and ten times nearer.
_SAME_PLACE_M = 100.0
_NEARER_FACTOR = 10.0


def measure_apart_m(first: LonLat, second: LonLat) -> float:
    """Distance in metres of two positions (lon, lat), by a spherical approximation that holds where they are near."""
    north = second[1] - first[1]
    east = ((second[0] - first[0] + 180) % 360 - 180) * math.cos(math.radians(first[1]))
    return math.hypot(north, east) * METRES_PER_DEGREE


def list_corrections(place: LonLat) -> dict[str, LonLat]:
    """The positions (lon, lat) that may be meant where ``place`` is written wrongly, by the mistake."""
    lon, lat = place
    corrections = {
        "latitude and longitude swapped": (lat, lon),
        "the sign of the longitude (E/W) changed": (-lon, lat),
        "the sign of the latitude (N/S) changed": (lon, -lat),
        "both signs changed": (-lon, -lat),
        "latitude and longitude swapped and the sign of the longitude changed": (-lat, lon),
    }
    return {name: position for name, position in corrections.items() if abs(position[1]) <= 90}


def name_mistake(place: LonLat, other: LonLat) -> str:
    """The mistake of writing by which two positions (lon, lat) differ; empty where there is none such."""
    limit_m = min(_SAME_PLACE_M, measure_apart_m(place, other) / _NEARER_FACTOR)
    near = {name: measure_apart_m(other, corrected) for name, corrected in list_corrections(place).items()}
    best = min(near, key=lambda name: near[name])
    return best if near[best] <= limit_m else ""
