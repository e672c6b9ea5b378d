"""The sheet of a defect's card: best photograph, rectified view, facts, location and observations."""

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
BEST_PX = 600  # width of the two large pictures
TILE_PX = 240  # width of an observation's crop
_WIDTH_IN, _EDGE_IN, _GAP_IN, _HEAD_IN = 13.2, 0.25, 0.2, 0.85
_BIG_IN, _TILE_IN = BEST_PX / DPI, TILE_PX / DPI
_TILES_PER_ROW = 7
_TILE_GAP_IN = (_WIDTH_IN - 2 * _EDGE_IN - _TILES_PER_ROW * _TILE_IN) / (_TILES_PER_ROW - 1)
_NOTE_IN = 0.38
_LOCATION_IN = 3.3
_FACT_IN, _NAME_IN, _LINE_CHARACTERS = 0.168, 1.12, 44


@dataclass(frozen=True, kw_only=True, eq=False)
class ObservationTile:
    """An observation and its crop (RGB, ``TILE_PX`` wide); None where the photograph is unreadable."""

    observation: DefectObservation
    picture: UInt8Image | None


@dataclass(frozen=True, kw_only=True, eq=False)
class CardContents:
    """Contents of a card.

    ``best`` (RGB, ``BEST_PX`` wide) and ``patch`` are from ``best_photo_id``, the photograph with the best view of
    those that can be read; None where there is none. ``unreadable``: photographs that cannot be read. ``left_out``:
    number of observations that are not among ``tiles``.
    """

    mark: DefectMark
    subtitle: str
    facts: Sequence[CardFact]
    best: UInt8Image | None
    best_photo_id: str | None
    patch: PatchView | None
    tiles: Sequence[ObservationTile]
    left_out: int
    unreadable: Sequence[str]
    overview: FacadeOverview | None
    storeys: Sequence[StoreyBase]


def draw_card(contents: CardContents) -> Figure:
    """Draw a card; its height depends on the number of observations."""
    rows = -(-len(contents.tiles) // _TILES_PER_ROW)
    lines = [(name, textwrap.wrap(value, _LINE_CHARACTERS) or [""]) for name, value in contents.facts]
    facts_in = sum(len(wrapped) for _, wrapped in lines) * _FACT_IN + len(lines) * 0.05
    location_in = _LOCATION_IN + 0.62
    body_in = max(_BIG_IN + 0.3 + location_in, facts_in + 0.2)
    height = _HEAD_IN + body_in + 0.35 + rows * (_TILE_IN + _NOTE_IN) + _EDGE_IN
    figure = Figure(figsize=(_WIDTH_IN, height), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    sheet = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    sheet.set_xlim(0.0, _WIDTH_IN)
    sheet.set_ylim(0.0, height)
    sheet.axis("off")
    top = height - _HEAD_IN
    _write_heading(sheet, contents, height)
    _draw_best(sheet, contents, _EDGE_IN, top)
    _draw_patch(sheet, contents, _EDGE_IN + _BIG_IN + _GAP_IN, top)
    _write_facts(sheet, lines, _EDGE_IN + 2 * (_BIG_IN + _GAP_IN), top)
    _draw_location(figure, contents, top - _BIG_IN - 0.3, height)
    _draw_tiles(sheet, contents, top - body_in)
    # Images change the limits of the axes.
    sheet.set_xlim(0.0, _WIDTH_IN)
    sheet.set_ylim(0.0, height)
    return figure


def _draw_picture(
    sheet: Axes, picture: UInt8Image | None, left: float, top: float, side: float, placeholder: str
) -> None:
    """Draw a square picture, or a grey square with the placeholder text where it is None."""
    if picture is None:
        sheet.add_patch(Rectangle((left, top - side), side, side, facecolor="#ececec", edgecolor="#b0b0b0"))
        text = "\n".join(textwrap.wrap(placeholder, max(12, int(side * 9))))
        sheet.text(
            left + side / 2,
            top - side / 2,
            escape_mathtext(text),
            ha="center",
            va="center",
            fontsize=8,
            color="#505050",
        )
        return
    sheet.imshow(picture, extent=(left, left + side, top - side, top), interpolation="antialiased", aspect="auto")


def _write_heading(sheet: Axes, contents: CardContents, height: float) -> None:
    mark = contents.mark
    colour = get_class_colour(mark.defect_class)
    sheet.add_patch(Rectangle((0.0, height - 0.09), _WIDTH_IN, 0.09, facecolor=colour, edgecolor="none"))
    title = f"{mark.label}   {mark.defect_class}, {mark.severity}"
    sheet.text(_EDGE_IN, height - 0.22, escape_mathtext(title), fontsize=15, weight="bold", va="top")
    subtitle = f"{mark.defect_id} · {contents.subtitle}"
    sheet.text(_EDGE_IN, height - 0.54, escape_mathtext(subtitle), fontsize=8.5, va="top", color="#303030")


def _draw_best(sheet: Axes, contents: CardContents, left: float, top: float) -> None:
    names = ", ".join(contents.unreadable)
    placeholder = f"no photograph can be read: {names}" if names else "no photograph with a pose"
    _draw_picture(sheet, contents.best, left, top, _BIG_IN, placeholder)
    if contents.best is not None:
        note = f"photograph {contents.best_photo_id}"
        if names:
            note = f"{note}; cannot be read: {names}"
        sheet.text(
            left, top - _BIG_IN - 0.06, escape_mathtext(_cut_name(note, 62)), fontsize=8, va="top", color="#303030"
        )


def _draw_patch(sheet: Axes, contents: CardContents, left: float, top: float) -> None:
    """Draw the rectified view with the defect's outline and a scale bar."""
    patch = contents.patch
    _draw_picture(sheet, None if patch is None else patch.picture, left, top, _BIG_IN, "no rectified view")
    if patch is None:
        return
    per_m = _BIG_IN / patch.side_m
    centre = np.array([left + _BIG_IN / 2, top - _BIG_IN / 2])
    colour, dashes = get_class_colour(contents.mark.defect_class), get_class_dashes(contents.mark.defect_class)
    for ring in patch.rings_m:
        for edge, width, style in (("white", 2.6, "-"), (colour, 1.4, dashes)):
            sheet.add_patch(
                Polygon(centre + ring * per_m, fill=False, edgecolor=edge, linewidth=width, linestyle=style, zorder=3)
            )
    length = choose_bar_length_m(patch.side_m)
    bar = length * per_m
    corner = (left + 0.12, top - _BIG_IN + 0.12)
    background = Rectangle(
        (left, corner[1] - 0.12), max(bar, 0.5) + 0.24, 0.46, facecolor="black", alpha=0.55, linewidth=0
    )
    sheet.add_patch(background)
    for half, fill in enumerate(("white", "black")):
        sheet.add_patch(
            Rectangle(
                (corner[0] + half * bar / 2, corner[1]), bar / 2, 0.06, facecolor=fill, edgecolor="white", linewidth=0.7
            )
        )
    sheet.text(corner[0], corner[1] + 0.09, format_bar_length(length), fontsize=8, color="white", va="bottom")
    note = f"rectified, to scale, {1000 * patch.cell_m:.1f} mm/pixel"  # with the next line as wide as the picture
    if not patch.visible.all():
        note += "; grey: not visible in the photograph"
    sheet.text(left, top - _BIG_IN - 0.06, note, fontsize=8, va="top", color="#303030")


def choose_bar_length_m(width_m: float) -> float:
    """The largest of 1, 2 and 5 times 10^n metres that is at most a third of ``width_m``."""
    power = 10.0 ** np.floor(np.log10(width_m / 3))
    return float(max(n * power for n in (1, 2, 5) if n * power <= width_m / 3 * (1 + 1e-9)))


def format_bar_length(metres: float) -> str:
    """The length of a scale bar in m, cm or mm."""
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


def _draw_location(figure: Figure, contents: CardContents, top: float, height: float) -> None:
    """Draw the location of the defect on its facade, below the two large pictures."""
    width = 2 * _BIG_IN + _GAP_IN
    if contents.overview is None:
        note = "not on an elevation: soffit, roof, or facade too small to be drawn"
        figure.text(_EDGE_IN / _WIDTH_IN, top / height, note, fontsize=8, va="top", color="#303030")
        return
    overview = contents.overview
    per_m = min((width - 0.45) / overview.width_m, (_LOCATION_IN - 0.25) / overview.height_m)
    size = overview.width_m * per_m, overview.height_m * per_m
    left, bottom = _EDGE_IN + 0.45, top - 0.22 - size[1]
    axes = figure.add_axes((left / _WIDTH_IN, bottom / height, size[0] / _WIDTH_IN, size[1] / height))
    draw_defect_location(axes, overview, contents.storeys, contents.mark)
    title = f"{overview.facade.title} as seen from outside; u to the right, v up, from the site's origin (m)"
    figure.text(_EDGE_IN / _WIDTH_IN, top / height, escape_mathtext(title), fontsize=8, va="top", color="#303030")


def _draw_tiles(sheet: Axes, contents: CardContents, top: float) -> None:
    count = len(contents.tiles)
    title = f"{count} observation{'' if count == 1 else 's'}, best view first"
    if contents.left_out:
        title += f"; {contents.left_out} more not shown"
    sheet.text(_EDGE_IN, top, title, fontsize=9, weight="bold", va="top")
    for index, tile in enumerate(contents.tiles):
        row, column = divmod(index, _TILES_PER_ROW)
        left = _EDGE_IN + column * (_TILE_IN + _TILE_GAP_IN)
        y = top - 0.25 - row * (_TILE_IN + _NOTE_IN)
        _draw_picture(sheet, tile.picture, left, y, _TILE_IN, "photograph missing or unreadable")
        observation = tile.observation
        name = _cut_name(observation.photo_id, 26)
        sheet.text(left, y - _TILE_IN - 0.04, escape_mathtext(name), fontsize=6.6, va="top")
        view = [f"incidence {observation.incidence_deg:.0f}°"] if observation.incidence_deg is not None else []
        view += [f"{observation.gsd_mm:.1f} mm/pixel"] if observation.gsd_mm is not None else []
        note = ", ".join(view) or "not on the surface"
        sheet.text(left, y - _TILE_IN - 0.17, note, fontsize=6.6, va="top", color="#303030")


def _cut_name(text: str, characters: int) -> str:
    """The last ``characters`` of a longer text, because file names differ at their ends."""
    return text if len(text) <= characters else f"…{text[1 - characters :]}"
