"""The report's tables of defects: each with its picture, and how many of which class are where."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from facadelake.reporting.cards.facts import crack_width_text
from facadelake.reporting.distribution import Distribution
from facadelake.reporting.drawing.palette import class_colour, short_ids
from facadelake.reporting.elevations.elevation import Elevation
from facadelake.reporting.inspection import Inspection
from facadelake.reporting.page.html import Html, html_of, link_of, paragraph, table

# Grades of every rule pack that ships (data/severity/), worst first; an unknown grade stands behind them, before those
# that say that there is no grade.
_WORST_FIRST = (
    "very_severe",
    "unsafe",
    "critical",
    "severe",
    "over_limit",
    "high",
    "swarmp",
    "moderate",
    "medium",
    "slight",
    "low",
    "minor",
    "very_slight",
    "negligible",
    "within_limit",
    "safe",
)
_NO_GRADE = ("not_measured", "not_covered", "ungraded", "none", "")


def counts_by_facade(distribution: Distribution) -> Html:
    """Defects by class for each facade and storey."""
    heads = ["facade", "storey", *distribution.classes, "all"]
    lines: list[list[object]] = []
    for facade in distribution.facades:
        for storey in distribution.storeys:
            cells = [distribution.counts[facade, storey, word] for word in distribution.classes]
            if sum(cells):
                lines.append([facade, storey, *cells, sum(cells)])
    if lines:
        totals = [distribution.total(None, word) for word in distribution.classes]
        lines.append(["all", "", *totals, distribution.total()])
    return table(heads, lines, numeric=range(2, len(heads)))


def _severity_rank(severity: str) -> int:
    word = severity.lower()
    if word in _NO_GRADE:
        return len(_WORST_FIRST) + 1 + _NO_GRADE.index(word)
    return _WORST_FIRST.index(word) if word in _WORST_FIRST else len(_WORST_FIRST)


def worst_first(defects: pa.Table) -> list[dict[str, Any]]:
    """Rows of table ``defects``: the worst grade first, then the largest."""
    rows: list[dict[str, Any]] = defects.to_pylist()
    return sorted(rows, key=lambda row: (_severity_rank(row["severity"]), -row["area_m2"], row["defect_id"]))


def defect_table(
    inspection: Inspection,
    crops: Mapping[str, Path],
    cards: Mapping[str, Path],
    elevations: Sequence[Elevation],
    folder: Path,
) -> list[Html]:
    """All defects, worst first, with their crops, which link their cards; before them what a reader must know."""
    labels = short_ids(inspection.defects.column("defect_id").to_pylist())
    rows = worst_first(inspection.defects)
    rules = ", ".join(sorted({row["severity_rule"] for row in rows}))
    drawn = {mark.defect_id for elevation in elevations for mark in elevation.marks}
    missing = sum(row["defect_id"] not in drawn for row in rows)
    notes = []
    if rows:
        words = f"Worst first, then largest. Found by {inspection.detectors}. "
        if "onnx:" in inspection.detectors:
            words += (
                "A model misses defects and shows some that are none; 'facadelake describe-detector' tells how often. "
            )
        notes.append(paragraph(f"{words}Severity is a proposal by {rules}, not a person's judgement."))
    if missing:
        notes.append(paragraph(f"{missing} of them lie on no elevation above (undersides, small facades)."))
    if cards:
        all_of_them = "facadelake pictures BUILDING CAMPAIGN --all"
        words = "This one has a card" if len(cards) == 1 else f"The first {len(cards)} have a card"
        note = f"{words}: all that is known of it on one sheet; '{all_of_them}' draws every defect's."
        notes.append(paragraph(note))
    lines = [
        _defect_row(row, labels[row["defect_id"]], crops.get(row["defect_id"]), cards.get(row["defect_id"]), folder)
        for row in rows
    ]
    heads = [
        "no.",
        "",
        "class",
        "severity",
        "size",
        "storey",
        "facade",
        "element",
        "seen in",
        "best photograph",
        "place",
    ]
    return [*notes, table(heads, lines, numeric=[0])]


def _defect_row(row: Mapping[str, Any], label: str, crop: Path | None, card: Path | None, folder: Path) -> list[object]:
    alternative = html_of(f"{row['defect_class']} {label}")
    target = card if card is not None else crop
    picture = Html('<span class="soft">no picture</span>')
    if crop is not None and target is not None:
        picture = Html(
            f'<a href="{link_of(target, folder)}">'
            f'<img class="crop" src="{link_of(crop, folder)}" alt="{alternative}"></a>'
        )
    number = Html(f'<b title="{html_of(row["defect_id"])}">{html_of(label)}</b>')
    if card is not None:
        number = Html(f'{number.text}<br><a href="{link_of(card, folder)}">card</a>')
    element = f"{row['element_name'] or row['ifc_class']}" + (f", {row['material']}" if row["material"] else "")
    return [
        number,
        picture,
        class_html(row["defect_class"]),
        row["severity"],
        _size(row),
        row["storey"],
        row["facade"],
        element,
        f"{row['photo_count']} photograph{'s' if row['photo_count'] != 1 else ''}",
        row["best_photo_id"],
        f"{row['lat_deg']:.7f}, {row['lon_deg']:.7f}; {row['height_map_m']:.2f} m",
    ]


def _size(row: Mapping[str, Any]) -> str:
    text, width = f"{row['width_m']:.2f} × {row['height_m']:.2f} m", crack_width_text(row)
    return text if width is None else f"{text}; crack {width}"


def class_html(word: str) -> Html:
    """A class with its colour."""
    return Html(f'<span class="dot" style="background:{class_colour(word)}"></span>{html_of(word)}')
