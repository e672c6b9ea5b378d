"""The report's tables of defects: each with its picture, and how many of which class are where."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from facadelake.pictures.distribution import NO_STOREY, facade_order, storey_order
from facadelake.pictures.elevations import Elevation
from facadelake.pictures.inspection import Inspection
from facadelake.pictures.page import Html, html_of, link_of, paragraph, table
from facadelake.pictures.palette import class_colour, short_ids

# Grades of every rule pack that ships, worst first; an unknown grade stands behind them, before "none".
_WORST_FIRST = (
    "unsafe",
    "critical",
    "severe",
    "high",
    "swarmp",
    "moderate",
    "medium",
    "slight",
    "low",
    "minor",
    "safe",
)


def counts_by_facade(inspection: Inspection) -> Html:
    """Defects by class for each facade and storey."""
    rows = inspection.defects.select(["defect_class", "facade", "storey"]).to_pylist()
    counts = Counter((row["facade"], row["storey"] or NO_STOREY, row["defect_class"]) for row in rows)
    classes = sorted({row["defect_class"] for row in rows})
    heads = ["facade", "storey", *classes, "all"]
    lines: list[list[object]] = []
    for facade in facade_order({row["facade"] for row in rows}):
        for storey in storey_order(inspection):
            cells = [counts[(facade, storey, name)] for name in classes]
            if sum(cells):
                lines.append([facade, storey, *cells, sum(cells)])
    if rows:
        lines.append(["all", "", *(sum(row["defect_class"] == name for row in rows) for name in classes), len(rows)])
    return table(heads, lines, numeric=range(2, len(heads)))


def _severity_rank(severity: str) -> int:
    word = re.split(r"[^a-z]", severity.lower(), maxsplit=1)[0]
    if word in ("none", "ungraded", ""):
        return len(_WORST_FIRST) + 1
    return _WORST_FIRST.index(word) if word in _WORST_FIRST else len(_WORST_FIRST)


def defect_table(
    inspection: Inspection, crops: Mapping[str, Path], elevations: Sequence[Elevation], folder: Path
) -> list[Html]:
    """All defects, worst first, with their crops; before them what a reader must know of the grades."""
    rows = inspection.defects.to_pylist()
    labels = short_ids([row["defect_id"] for row in rows])
    rows.sort(key=lambda row: (_severity_rank(row["severity"]), -row["area_m2"], row["defect_id"]))
    rules = ", ".join(sorted({row["severity_rule"] for row in rows}))
    drawn = {mark.defect_id for elevation in elevations for mark in elevation.marks}
    missing = sum(row["defect_id"] not in drawn for row in rows)
    notes = (
        [paragraph(f"Worst first, then largest. Severity is a proposal by {rules}, not a person's judgement.")]
        if rows
        else []
    )
    if missing:
        notes.append(paragraph(f"{missing} of them lie on no elevation above (undersides, small facades)."))
    lines = [_defect_row(row, labels[row["defect_id"]], crops.get(row["defect_id"]), folder) for row in rows]
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


def _defect_row(row: Mapping[str, Any], label: str, crop: Path | None, folder: Path) -> list[object]:
    alternative = html_of(f"{row['defect_class']} {label}")
    link = link_of(crop, folder) if crop is not None else ""
    picture = (
        Html(f'<a href="{link}"><img class="crop" src="{link}" alt="{alternative}"></a>')
        if crop is not None
        else Html('<span class="soft">no picture</span>')
    )
    element = f"{row['element_name'] or row['ifc_class']}" + (f", {row['material']}" if row["material"] else "")
    return [
        Html(f'<b title="{html_of(row["defect_id"])}">{html_of(label)}</b>'),
        picture,
        class_html(row["defect_class"]),
        row["severity"],
        f"{row['width_m']:.2f} × {row['height_m']:.2f} m",
        row["storey"],
        row["facade"],
        element,
        f"{row['sightings']} photograph{'s' if row['sightings'] != 1 else ''}",
        row["best_photo_id"],
        f"{row['lat_deg']:.6f}, {row['lon_deg']:.6f}; {row['height_map_m']:.1f} m",
    ]


def class_html(word: str) -> Html:
    """A class with its colour."""
    return Html(f'<span class="dot" style="background:{class_colour(word)}"></span>{html_of(word)}')
