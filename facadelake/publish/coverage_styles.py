"""The style of the layers of coverage in QGIS: the colours, classes and hatching of the elevations' coverage sheets.

What is not imaged has a colour and a pattern for what prevents it (Okabe and Ito 2008), and the imaged cells a class of
the smallest crack width found, or where that is unknown of all cells, of the longest side of a pixel on the surface.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pyarrow as pa
from matplotlib.colors import to_hex

from facadelake.core.arrays import Float64N
from facadelake.publish.state_styles import add_settings, format_rgba, write_document
from schemas.vocabulary import CoverageOutcome

COLOUR_MAP = "cividis"  # for all kinds of colour vision
_STEPS_MM = (0.1, 0.2, 0.3, 0.5, 0.7, 1, 1.5, 2, 3, 5, 7, 10, 15, 20, 30, 50, 70, 100, 150, 200, 300, 500)


@dataclass(frozen=True, kw_only=True)
class HatchedFill:
    """Hex colour; hatching as matplotlib and as QGIS name it; the words of the legend."""

    colour: str
    hatch: str
    pattern: str
    meaning: str


# Hatched, so that print in black and white tells them apart.
NOT_IMAGED_FILLS: Mapping[CoverageOutcome, HatchedFill] = MappingProxyType(
    {
        CoverageOutcome.OBSTRUCTED: HatchedFill(
            colour="#D55E00", hatch="xxx", pattern="diagonal_x", meaning="something before the wall"
        ),
        CoverageOutcome.GRAZING: HatchedFill(
            colour="#CC79A7", hatch="---", pattern="horizontal", meaning="grazing views only"
        ),
        CoverageOutcome.HIDDEN_BY_MODEL: HatchedFill(
            colour="#606060", hatch="...", pattern="dense6", meaning="hidden by the building"
        ),
        CoverageOutcome.NOT_IN_VIEW: HatchedFill(
            colour="#B00020", hatch="///", pattern="b_diagonal", meaning="in no photograph"
        ),
    }
)
NOT_SEARCHED_FILL = HatchedFill(
    colour="#FFFFFF", hatch="\\\\\\", pattern="f_diagonal", meaning="imaged, not searched by the detector"
)


def choose_limits_mm(value_mm: Float64N) -> Float64N:
    """Limits of classes, round millimetres, that contain nearly all values."""
    steps = np.array(_STEPS_MM, dtype=np.float64)
    low, high = np.quantile(value_mm, [0.01, 0.99])
    first = min(max(0, int(np.searchsorted(steps, low, side="right")) - 1), len(steps) - 2)
    last = min(max(first + 1, int(np.searchsorted(steps, high))), len(steps) - 1)
    return steps[first : last + 1]


def create_coverage_style(coverage: pa.Table) -> str:
    """QML of the layers of table ``coverage``, or of a facade of it; all layers of one table have the same classes."""
    root = ElementTree.Element("qgis", version="3.22.0", styleCategories="Symbology")
    renderer = ElementTree.SubElement(root, "renderer-v2", type="RuleRenderer", forceraster="0", symbollevels="0")
    rules = ElementTree.SubElement(renderer, "rules", key="{coverage}")
    symbols = ElementTree.SubElement(renderer, "symbols")
    for number, (condition, label, fills) in enumerate(_list_rules(coverage)):
        ElementTree.SubElement(
            rules, "rule", key=f"{{coverage-{number}}}", filter=condition, symbol=str(number), label=label
        )
        symbol = ElementTree.SubElement(symbols, "symbol", name=str(number), type="fill", alpha="1", clip_to_extent="1")
        for colour, pattern in fills:
            layer = ElementTree.SubElement(symbol, "layer", {"class": "SimpleFill", "enabled": "1", "pass": "0"})
            add_settings(layer, {"color": format_rgba(colour), "style": pattern, "outline_style": "no"})
    return write_document(root)


def _list_rules(coverage: pa.Table) -> Iterator[tuple[str, str, list[tuple[str, str]]]]:
    """Each rule: its filter, its label, and colour and QGIS' pattern of the fills that lie one on another."""
    yield from _list_classes(coverage)
    for outcome, fill in NOT_IMAGED_FILLS.items():
        yield f"\"coverage_outcome\" = '{outcome}'", fill.meaning, [(fill.colour, "solid"), ("#FFFFFF", fill.pattern)]
    fill = NOT_SEARCHED_FILL  # over the colour of its class
    imaged = f"\"coverage_outcome\" = '{CoverageOutcome.IMAGED}'"
    yield f'{imaged} AND "searched_count" = 0', fill.meaning, [(fill.colour, fill.pattern)]


def _list_classes(coverage: pa.Table) -> Iterator[tuple[str, str, list[tuple[str, str]]]]:
    """The classes of the imaged cells; small, which is good, is light."""
    found = coverage.column("found_crack_width_mm").to_numpy()
    value_mm, value, meaning = found, '"found_crack_width_mm"', "cracks found"
    if not np.isfinite(found).any():
        cosine = np.cos(np.radians(coverage.column("incidence_deg").to_numpy()))
        value_mm = coverage.column("gsd_mm").to_numpy() / cosine
        value, meaning = '"gsd_mm" / cos(radians("incidence_deg"))', "pixel on the surface"
    value_mm = value_mm[np.isfinite(value_mm)]
    if not len(value_mm):
        return
    limits = choose_limits_mm(value_mm)
    last = len(limits) - 2
    colours = mpl.colormaps[f"{COLOUR_MAP}_r"].resampled(max(2, last + 1))
    for number in range(last + 1):
        low, high = limits[number], limits[number + 1]
        conditions = [f"{value} >= {low:g}"] if number > 0 else []
        conditions += [f"{value} < {high:g}"] if number < last else []
        yield (
            " AND ".join(conditions) or f"{value} IS NOT NULL",
            f"{meaning}: {low:g} to {high:g} mm",
            [(to_hex(colours(number)), "solid")],
        )
