"""A defect's card: all that is known of one defect on one sheet."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from facadelake.core.arrays import UInt8Image
from facadelake.reporting.cards.facts import CardFact
from facadelake.reporting.cards.observations import DefectObservation
from facadelake.reporting.cards.patch_view import PatchView
from facadelake.reporting.drawing.palette import escape_mathtext, get_class_colour, get_class_dashes
from facadelake.reporting.elevations.marks import DefectMark
from facadelake.reporting.elevations.overview import FacadeOverview, draw_defect_location
from facadelake.reporting.elevations.storeys import StoreyBase

DPI = 150
BEST_PX = 600  # width of the large pieces
TILE_PX = 240  # of a sighting's piece
_WIDTH_IN, _EDGE_IN, _GAP_IN, _HEAD_IN = 13.2, 0.25, 0.2, 0.85
_BIG_IN, _TILE_IN = BEST_PX / DPI, TILE_PX / DPI
_TILES_A_ROW = 7
_TILE_GAP_IN = (_WIDTH_IN - 2 * _EDGE_IN - _TILES_A_ROW * _TILE_IN) / (_TILES_A_ROW - 1)
_NOTE_IN = 0.38
_PLACE_IN = 3.3
_FACT_IN, _NAME_IN, _LINE_CHARACTERS = 0.168, 1.12, 44


@dataclass(frozen=True, kw_only=True, eq=False)
class ObservationTile:
    """A sighting and its piece (RGB, ``TILE_PX`` wide) of the photograph; None where that could not be read."""

    observation: DefectObservation
    picture: UInt8Image | None


@dataclass(frozen=True, kw_only=True, eq=False)
class CardContents:
    """What a card shows.

    ``best`` (RGB, ``BEST_PX`` wide) and ``patch`` come from ``best_photo_id``, the best photograph that could be read;
    all three are None where none could. ``left_out`` sightings are not among ``tiles``.
    """

    mark: DefectMark
    subtitle: str
    facts: Sequence[CardFact]
    best: UInt8Image | None
    best_photo_id: str | None
    patch: PatchView | None
    tiles: Sequence[ObservationTile]
    left_out: int
    overview: FacadeOverview | None
    storeys: Sequence[StoreyBase]


def draw_card(material: CardContents) -> Figure:
    """The finished sheet; its height follows from the number of sightings."""
    rows = -(-len(material.tiles) // _TILES_A_ROW)
    lines = [(name, textwrap.wrap(value, _LINE_CHARACTERS) or [""]) for name, value in material.facts]
    facts_in = sum(len(wrapped) for _, wrapped in lines) * _FACT_IN + len(lines) * 0.05
    place_in = _PLACE_IN + 0.62
    body_in = max(_BIG_IN + 0.3 + place_in, facts_in + 0.2)
    height = _HEAD_IN + body_in + 0.35 + rows * (_TILE_IN + _NOTE_IN) + _EDGE_IN
    figure = Figure(figsize=(_WIDTH_IN, height), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    sheet = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    sheet.set_xlim(0.0, _WIDTH_IN)
    sheet.set_ylim(0.0, height)
    sheet.axis("off")
    top = height - _HEAD_IN
    _write_heading(sheet, material, height)
    _draw_best(sheet, material, _EDGE_IN, top)
    _draw_patch(sheet, material, _EDGE_IN + _BIG_IN + _GAP_IN, top)
    _write_facts(sheet, lines, _EDGE_IN + 2 * (_BIG_IN + _GAP_IN), top)
    _draw_location(figure, material, top - _BIG_IN - 0.3, height)
    _draw_tiles(sheet, material, top - body_in)
    # Images set limits of their own.
    sheet.set_xlim(0.0, _WIDTH_IN)
    sheet.set_ylim(0.0, height)
    return figure


def _draw_picture(sheet: Axes, picture: UInt8Image | None, left: float, top: float, side: float, instead: str) -> None:
    if picture is None:
        sheet.add_patch(Rectangle((left, top - side), side, side, facecolor="#ececec", edgecolor="#b0b0b0"))
        words = "\n".join(textwrap.wrap(instead, max(12, int(side * 9))))
        sheet.text(left + side / 2, top - side / 2, words, ha="center", va="center", fontsize=8, color="#505050")
        return
    sheet.imshow(picture, extent=(left, left + side, top - side, top), interpolation="antialiased", aspect="auto")


def _write_heading(sheet: Axes, material: CardContents, height: float) -> None:
    mark = material.mark
    colour = get_class_colour(mark.defect_class)
    sheet.add_patch(Rectangle((0.0, height - 0.09), _WIDTH_IN, 0.09, facecolor=colour, edgecolor="none"))
    title = f"{mark.label}   {mark.defect_class}, {mark.severity}"
    sheet.text(_EDGE_IN, height - 0.22, escape_mathtext(title), fontsize=15, weight="bold", va="top")
    subtitle = f"{mark.defect_id} · {material.subtitle}"
    sheet.text(_EDGE_IN, height - 0.54, escape_mathtext(subtitle), fontsize=8.5, va="top", color="#303030")


def _draw_best(sheet: Axes, material: CardContents, left: float, top: float) -> None:
    _draw_picture(sheet, material.best, left, top, _BIG_IN, "none of its photographs could be read")
    if material.best is not None:
        note = f"as {material.best_photo_id} shows it"
        sheet.text(
            left, top - _BIG_IN - 0.06, escape_mathtext(_shorten(note, 62)), fontsize=8, va="top", color="#303030"
        )


def _draw_patch(sheet: Axes, material: CardContents, left: float, top: float) -> None:
    """The rectified surroundings with the defect's outline and a bar; the sheet's inches are metres times a scale."""
    patch = material.patch
    _draw_picture(sheet, None if patch is None else patch.picture, left, top, _BIG_IN, "no rectified view")
    if patch is None:
        return
    per_m = _BIG_IN / patch.side_m
    middle = np.array([left + _BIG_IN / 2, top - _BIG_IN / 2])
    colour, dashes = get_class_colour(material.mark.defect_class), get_class_dashes(material.mark.defect_class)
    for ring in patch.rings_m:
        for ink, width, style in (("white", 2.6, "-"), (colour, 1.4, dashes)):
            sheet.add_patch(
                Polygon(middle + ring * per_m, fill=False, edgecolor=ink, linewidth=width, linestyle=style, zorder=3)
            )
    length = choose_bar_length_m(patch.side_m)
    bar = length * per_m
    at = (left + 0.12, top - _BIG_IN + 0.12)
    ground = Rectangle((left, at[1] - 0.12), max(bar, 0.5) + 0.24, 0.46, facecolor="black", alpha=0.55, linewidth=0)
    sheet.add_patch(ground)
    for half, ink in enumerate(("white", "black")):
        sheet.add_patch(
            Rectangle((at[0] + half * bar / 2, at[1]), bar / 2, 0.06, facecolor=ink, edgecolor="white", linewidth=0.7)
        )
    sheet.text(at[0], at[1] + 0.09, format_bar_length(length), fontsize=8, color="white", va="bottom")
    note = f"square-on, true to scale, {1000 * patch.cell_m:.1f} mm a cell"
    if not patch.shown.all():
        note += "; grey: not seen in it"
    sheet.text(left, top - _BIG_IN - 0.06, note, fontsize=8, va="top", color="#303030")


def choose_bar_length_m(width_m: float) -> float:
    """The longest of 1, 2, 5 x 10^n metres that fits a third of ``width_m``."""
    power = 10.0 ** np.floor(np.log10(width_m / 3))
    return float(max(n * power for n in (1, 2, 5) if n * power <= width_m / 3 * (1 + 1e-9)))


def format_bar_length(metres: float) -> str:
    """A round length in its unit."""
    if metres >= 1:
        return f"{metres:g} m"
    return f"{100 * metres:g} cm" if metres >= 0.01 else f"{1000 * metres:g} mm"


def _write_facts(sheet: Axes, lines: Sequence[tuple[str, list[str]]], left: float, top: float) -> None:
    y = top
    for name, wrapped in lines:
        sheet.text(left, y, escape_mathtext(name), fontsize=8, va="top", color="#5a5a5a")
        for line in wrapped:
            sheet.text(left + _NAME_IN, y, escape_mathtext(line), fontsize=8, va="top")
            y -= _FACT_IN
        y -= 0.05


def _draw_location(figure: Figure, material: CardContents, top: float, height: float) -> None:
    """Where it is on its facade, below the two large pieces."""
    wide = 2 * _BIG_IN + _GAP_IN
    if material.overview is None:
        note = "it lies on no elevation: an underside, a roof, or a facade too small to be drawn"
        figure.text(_EDGE_IN / _WIDTH_IN, top / height, note, fontsize=8, va="top", color="#303030")
        return
    backdrop = material.overview
    per_m = min((wide - 0.45) / backdrop.width_m, (_PLACE_IN - 0.25) / backdrop.height_m)
    size = backdrop.width_m * per_m, backdrop.height_m * per_m
    left, bottom = _EDGE_IN + 0.45, top - 0.22 - size[1]
    axes = figure.add_axes((left / _WIDTH_IN, bottom / height, size[0] / _WIDTH_IN, size[1] / height))
    draw_defect_location(axes, backdrop, material.storeys, material.mark)
    zero = material.storeys[0].name if material.storeys else "the lowest point"
    title = f"{backdrop.facade.title} from outside: metres along it, and above {zero}"
    figure.text(_EDGE_IN / _WIDTH_IN, top / height, escape_mathtext(title), fontsize=8, va="top", color="#303030")


def _draw_tiles(sheet: Axes, material: CardContents, top: float) -> None:
    count = len(material.tiles)
    words = f"{count} sighting{'' if count == 1 else 's'}, the best first"
    if material.left_out:
        words += f"; {material.left_out} more are not drawn here"
    sheet.text(_EDGE_IN, top, words, fontsize=9, weight="bold", va="top")
    for place, piece in enumerate(material.tiles):
        row, column = divmod(place, _TILES_A_ROW)
        left = _EDGE_IN + column * (_TILE_IN + _TILE_GAP_IN)
        y = top - 0.25 - row * (_TILE_IN + _NOTE_IN)
        _draw_picture(sheet, piece.picture, left, y, _TILE_IN, "photograph missing or unreadable")
        sighting = piece.observation
        sheet.text(left, y - _TILE_IN - 0.04, escape_mathtext(_shorten(sighting.photo_id, 26)), fontsize=6.6, va="top")
        seen = [f"{sighting.incidence_deg:.0f}° off square"] if sighting.incidence_deg is not None else []
        seen += [f"{sighting.gsd_mm:.1f} mm a pixel"] if sighting.gsd_mm is not None else []
        note = ", ".join(seen) or "surface not met"
        sheet.text(left, y - _TILE_IN - 0.17, note, fontsize=6.6, va="top", color="#303030")


def _shorten(text: str, characters: int) -> str:
    """``text``, its beginning left out where it is longer than ``characters``: names differ at their ends."""
    return text if len(text) <= characters else f"…{text[1 - characters :]}"
