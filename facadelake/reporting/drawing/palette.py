"""Colours and names: safe for colour-blind readers (Okabe and Ito 2008), the same in every picture."""

from __future__ import annotations

from collections.abc import Sequence

from schemas.vocabulary import DefectClass, ObservationOutcome, PointKind

Dashes = tuple[float, tuple[float, ...]]

CLASS_COLOURS: dict[str, str] = {
    DefectClass.CRACK: "#d55e00",
    DefectClass.SPALLING: "#cc79a7",
    DefectClass.MOISTURE: "#0072b2",
}
# Colour is never alone: the outline's dashes tell the classes apart in a black and white print.
CLASS_DASHES: dict[str, Dashes] = {
    DefectClass.CRACK: (0.0, (1.0, 0.0)),
    DefectClass.SPALLING: (0.0, (3.0, 1.2)),
    DefectClass.MOISTURE: (0.0, (1.2, 0.8)),
}
CLASS_HATCHES: dict[str, str] = {DefectClass.SPALLING: "//", DefectClass.MOISTURE: ".."}
OUTCOME_COLOURS: dict[str, str] = {
    ObservationOutcome.REGISTERED: "#009e73",
    ObservationOutcome.OFF_TARGET: "#d55e00",
    ObservationOutcome.OCCLUDED: "#f0e442",
    ObservationOutcome.MASKED: "#000000",
    ObservationOutcome.GRAZING: "#e69f00",
    ObservationOutcome.OUTSIDE: "#cc79a7",
    ObservationOutcome.UNLOCALISED: "#56b4e9",
}
# Points of the passport: colour and marker, so that a black and white print tells them apart.
POINT_STYLES: dict[str, tuple[str, str]] = {
    PointKind.CONTROL: ("#0072b2", "^"),
    PointKind.HELD_OUT: ("#d55e00", "v"),
    PointKind.CHECK: ("#009e73", "s"),
    PointKind.GPS: ("#e69f00", "x"),
}
OTHER_COLOUR = "#595959"

_COMPASS = ("North", "North-east", "East", "South-east", "South", "South-west", "West", "North-west")


def get_class_colour(defect_class: str) -> str:
    """Hex colour of a defect class; grey for one this palette does not know."""
    return CLASS_COLOURS.get(defect_class, OTHER_COLOUR)


def get_class_dashes(defect_class: str) -> Dashes:
    """Line style of a defect class, in Matplotlib's notation: (offset, (on, off, ...)) in line widths."""
    return CLASS_DASHES.get(defect_class, (0.0, (3.0, 1.0, 1.0, 1.0)))


def get_class_hatch(defect_class: str) -> str:
    """Filling of a defect class in areas, in Matplotlib's notation."""
    return CLASS_HATCHES.get(defect_class, "")


def get_outcome_colour(outcome: str) -> str:
    """Hex colour of an observation's outcome; grey for one this palette does not know."""
    return OUTCOME_COLOURS.get(outcome, OTHER_COLOUR)


def bgr_from_hex(hex_colour: str) -> tuple[int, int, int]:
    """Blue, green, red of "#rrggbb", as OpenCV draws."""
    return int(hex_colour[5:7], 16), int(hex_colour[3:5], 16), int(hex_colour[1:3], 16)


def name_direction(azimuth_deg: float) -> str:
    """The nearest of the eight compass directions, in words."""
    return _COMPASS[round(azimuth_deg / 45.0) % 8]


def label_ids(ids: Sequence[str]) -> dict[str, str]:
    """A short label of each id: the id without what all ids share in front and leading zeros, else its rank.

    "D0001", "D0012" give "1", "12". A rank (1, 2, ...) is given where the rest is longer than four characters.
    """
    if not ids:
        return {}
    first, last = min(ids), max(ids)
    shared = 0
    while shared < min(len(first), len(last)) and first[shared] == last[shared]:
        shared += 1
    while shared > 0 and first[shared - 1].isdigit():
        shared -= 1
    rest = {name: name[shared:].lstrip("0") for name in ids}
    if all(0 < len(text) <= 4 for text in rest.values()) and len(set(rest.values())) == len(rest):
        return rest
    return {name: str(rank) for rank, name in enumerate(ids, start=1)}


def escape_mathtext(text: str) -> str:
    """Text that Matplotlib writes as it is: a pair of dollar signs would be taken for a formula."""
    return text.replace("$", r"\$")
