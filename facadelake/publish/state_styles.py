"""The style of a layer of tracks in QGIS: a colour and a shape, or a pattern, for each state.

The colours are those of Okabe and Ito 2008, which colour-blind readers tell apart; shapes and patterns tell the states
apart without colour.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from xml.etree import ElementTree

from schemas.vocabulary import TrackState

_OPEN = "255,255,255,0"
_LINE = "35,35,35,255"


@dataclass(frozen=True, kw_only=True)
class _StateStyle:
    """Hex colour, QGIS' marker, whether it is an outline only, its angle, and QGIS' pattern of an area."""

    colour: str
    marker: str
    pattern: str
    is_open: bool = False
    angle_deg: int = 0


_STYLES = {
    TrackState.GROWN: _StateStyle(colour="#d55e00", marker="equilateral_triangle", pattern="solid"),
    TrackState.REOPENED: _StateStyle(colour="#d55e00", marker="star", pattern="cross"),
    TrackState.NEW: _StateStyle(colour="#cc79a7", marker="diamond", pattern="solid"),
    TrackState.FIRST_SEEN: _StateStyle(colour="#cc79a7", marker="diamond", pattern="b_diagonal", is_open=True),
    TrackState.REPAIRED: _StateStyle(colour="#009e73", marker="square", pattern="horizontal"),
    TrackState.NOT_FOUND: _StateStyle(colour="#e69f00", marker="cross2", pattern="diagonal_x"),
    TrackState.NOT_IMAGED: _StateStyle(colour="#000000", marker="square", pattern="no", is_open=True),
    TrackState.SHRUNK: _StateStyle(colour="#56b4e9", marker="equilateral_triangle", pattern="vertical", angle_deg=180),
    TrackState.SEEN: _StateStyle(colour="#0072b2", marker="circle", pattern="f_diagonal"),
}


@cache
def create_state_style(geometry_type: str) -> str:
    """QML of a layer whose column ``track_state`` selects the symbol; ``geometry_type``: GDAL's name of the type."""
    is_point = geometry_type.startswith("Point")
    root = ElementTree.Element("qgis", version="3.22.0", styleCategories="Symbology")
    renderer = ElementTree.SubElement(
        root, "renderer-v2", type="categorizedSymbol", attr="track_state", forceraster="0", symbollevels="0"
    )
    categories = ElementTree.SubElement(renderer, "categories")
    symbols = ElementTree.SubElement(renderer, "symbols")
    for number, (state, style) in enumerate(_STYLES.items()):
        label = state.value.replace("_", " ")
        ElementTree.SubElement(
            categories, "category", symbol=str(number), value=state.value, label=label, render="true"
        )
        symbol = ElementTree.SubElement(
            symbols, "symbol", name=str(number), type="marker" if is_point else "fill", alpha="1", clip_to_extent="1"
        )
        layer = ElementTree.SubElement(
            symbol, "layer", {"class": "SimpleMarker" if is_point else "SimpleFill", "enabled": "1", "pass": "0"}
        )
        add_settings(layer, _describe_marker(style) if is_point else _describe_fill(style))
    return write_document(root)


def write_document(root: ElementTree.Element) -> str:
    """The QML document of a style."""
    text: str = ElementTree.tostring(root, encoding="unicode")
    return f"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n{text}"


def _describe_marker(style: _StateStyle) -> dict[str, str]:
    colour = format_rgba(style.colour)
    is_line = style.is_open or style.marker == "cross2"  # which has no area to be filled
    return {
        "name": style.marker,
        "color": _OPEN if style.is_open else colour,
        "outline_color": colour if is_line else _LINE,
        "outline_style": "solid",
        "outline_width": "0.6" if is_line else "0.2",
        "outline_width_unit": "MM",
        "angle": str(style.angle_deg),
        "size": "3.2",
        "size_unit": "MM",
    }


def _describe_fill(style: _StateStyle) -> dict[str, str]:
    colour = format_rgba(style.colour)
    return {
        "color": colour,
        "style": style.pattern,
        "outline_color": colour,
        "outline_style": "solid",
        "outline_width": "0.5",
        "outline_width_unit": "MM",
    }


def format_rgba(colour: str) -> str:
    """A hex colour as QGIS writes it."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return f"{red},{green},{blue},255"


def add_settings(layer: ElementTree.Element, settings: dict[str, str]) -> None:
    """Settings in the form of QGIS from 3.26 on (Option), and of older ones (prop)."""
    options = ElementTree.SubElement(layer, "Option", type="Map")
    for name, value in settings.items():
        ElementTree.SubElement(options, "Option", type="QString", name=name, value=value)
    for name, value in settings.items():
        ElementTree.SubElement(layer, "prop", k=name, v=value)
