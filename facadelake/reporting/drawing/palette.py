"""Colours, line styles and markers, the same in all pictures; safe for colour-blind readers (Okabe and Ito 2008)."""

from __future__ import annotations

from schemas.vocabulary import DefectClass, ObservationOutcome, PointKind

Dashes = tuple[float, tuple[float, ...]]

CLASS_COLOURS: dict[str, str] = {
    DefectClass.CRACK: "#d55e00",
    DefectClass.SPALLING: "#cc79a7",
    DefectClass.MOISTURE: "#0072b2",
}
# Line styles distinguish the classes in black and white prints.
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
# Points of the passport: colour and marker; the markers distinguish them in black and white prints.
POINT_STYLES: dict[str, tuple[str, str]] = {
    PointKind.CONTROL: ("#0072b2", "^"),
    PointKind.HELD_OUT: ("#d55e00", "v"),
    PointKind.CHECK: ("#009e73", "s"),
    PointKind.GPS: ("#e69f00", "x"),
}
OTHER_COLOUR = "#595959"


def get_class_colour(defect_class: str) -> str:
    """Hex colour of a defect class; grey for a class without a colour."""
    return CLASS_COLOURS.get(defect_class, OTHER_COLOUR)


def get_class_dashes(defect_class: str) -> Dashes:
    """Line style of a defect class in Matplotlib's notation: (offset, (on, off, ...)) in line widths."""
    return CLASS_DASHES.get(defect_class, (0.0, (3.0, 1.0, 1.0, 1.0)))


def get_class_hatch(defect_class: str) -> str:
    """Hatch of a defect class in Matplotlib's notation."""
    return CLASS_HATCHES.get(defect_class, "")


def get_outcome_colour(outcome: str) -> str:
    """Hex colour of an observation's outcome; grey for an outcome without a colour."""
    return OUTCOME_COLOURS.get(outcome, OTHER_COLOUR)


def bgr_from_hex(hex_colour: str) -> tuple[int, int, int]:
    """Blue, green and red (0 to 255) of a colour "#rrggbb", in OpenCV's order."""
    return int(hex_colour[5:7], 16), int(hex_colour[3:5], 16), int(hex_colour[1:3], 16)


def escape_mathtext(text: str) -> str:
    """The text with dollar signs escaped, because Matplotlib parses text between two of them as a formula."""
    return text.replace("$", r"\$")
