"""Sections of the report on defects: their list with pictures, and their numbers by facade and storey."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from facadelake.deduplication import describe_width_blur
from facadelake.reporting.cards.facts import format_crack_width, format_geo_position
from facadelake.reporting.distribution import Distribution
from facadelake.reporting.drawing.labels import label_ids
from facadelake.reporting.elevations.elevation import Elevation
from facadelake.reporting.html import Html, html_from_class, html_from_value, link_file, render_paragraph, render_table
from facadelake.reporting.inspection import Inspection
from facadelake.reporting.severity_order import read_rule_packs, sort_by_severity
from facadelake.severity import describe_severity
from schemas.vocabulary import CrackWidthOutcome, DefectClass


def count_by_facade(distribution: Distribution) -> Html:
    """Table of the numbers of defects by class for each facade and storey."""
    heads = ["facade", "storey", *distribution.classes, "all"]
    lines: list[list[object]] = []
    for facade in distribution.facades:
        for storey in distribution.storeys:
            cells = [distribution.counts[facade, storey, name] for name in distribution.classes]
            if sum(cells):
                lines.append([facade, storey, *cells, sum(cells)])
    if lines:
        totals = [distribution.count_defects(None, name) for name in distribution.classes]
        lines.append(["all", "", *totals, distribution.count_defects()])
    return render_table(heads, lines, numeric=range(2, len(heads)))


def describe_severity_rules(inspection: Inspection) -> list[Html]:
    """The rules by which the defects were graded, as their packs state them, and the cracks without a width."""
    rows = inspection.defects.to_pylist()
    packs = read_rule_packs(rows)
    cracks = [row for row in rows if row["defect_class"] == DefectClass.CRACK]
    if not rows:
        return [render_paragraph("No defect, so no severity.")]
    parts = []
    for name in sorted({row["severity_rule"] for row in rows}):
        if name not in packs:
            parts.append(render_paragraph(f"Rule pack {name} is not in data/severity/ of this Facadelake."))
            continue
        pack = packs[name]
        parts.append(render_paragraph(f"Rule pack {name}: {pack.meaning}. Severities, worst first: "
                                      f"{', '.join(pack.severities)}."))  # fmt: skip
        parts.append(Html(f"<pre>{html_from_value(chr(10).join(pack.basis))}</pre>"))
    if cracks:
        measured = sum(row["crack_width_mm"] is not None for row in cracks)
        bounded = sum(row["crack_width_outcome"] == CrackWidthOutcome.BELOW_LIMIT for row in cracks)
        parts.append(
            render_paragraph(
                f"Width measured of {measured} of {len(cracks)} cracks, known by an upper limit of {bounded}, "
                f"not measured of {len(cracks) - measured - bounded}."
            )
        )
        uncertain = sum(describe_severity(row) != row["severity"] for row in cracks)
        if uncertain:
            parts.append(
                render_paragraph(
                    f"The severity of {uncertain} cracks is not certain: in brackets are the severities for widths "
                    "two sigmas narrower and wider."
                )
            )
    return parts


def list_defects(
    inspection: Inspection,
    crops: Mapping[str, Path],
    cards: Mapping[str, Path],
    elevations: Sequence[Elevation],
    folder: Path,
) -> list[Html]:
    """Table of all defects, the most severe first, with notes on detection, grading and cards before it.

    Args:
        inspection: the campaign.
        crops: crops by defect_id; they are linked to the cards.
        cards: cards by defect_id.
        elevations: drawn elevations, for the note on defects that are on none.
        folder: folder of the page.
    """
    labels = label_ids(inspection.defects.column("defect_id").to_pylist())
    rows = sort_by_severity(inspection.defects)
    rules = ", ".join(sorted({row["severity_rule"] for row in rows}))
    on_elevations = {mark.defect_id for elevation in elevations for mark in elevation.marks}
    missing = [labels[row["defect_id"]] for row in rows if row["defect_id"] not in on_elevations]
    notes = []
    if rows:
        note = f"Sorted by severity, then by area. Detected by {inspection.detectors}. "
        if "onnx:" in inspection.detectors:
            note += (
                "Automatic detection misses defects and reports false ones; 'facadelake describe-detector' lists the "
                "rates. "
            )
        notes.append(
            render_paragraph(
                f"{note}Severities are proposed by rule pack {rules} (rules below) and require an engineer's "
                "assessment."
            )
        )
    overstated = describe_width_blur([row["crack_width_blur_mm"] for row in rows])
    if overstated:
        notes.append(render_paragraph(f"Warning: {overstated}."))
    if missing:
        notes.append(
            render_paragraph(
                f"Not on an elevation above (soffits, horizontal surfaces, walls hidden in the view): {len(missing)} "
                f"defect{'' if len(missing) == 1 else 's'}, number {', '.join(missing)}."
            )
        )
    if 0 < len(cards) < len(rows):
        note = (
            f"Only the first {len(cards)} of {len(rows)} defects have a card with all data on one sheet, to limit the "
            "time of a report; 'facadelake pictures BUILDING CAMPAIGN --all' draws the cards of all defects."
        )
        notes.append(render_paragraph(note))
    elif cards:
        notes.append(render_paragraph("Each defect has a card with all data on one sheet: see the links."))
    lines = [
        _format_defect(row, labels[row["defect_id"]], crops.get(row["defect_id"]), cards.get(row["defect_id"]), folder)
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
        "visible in",
        "best photograph",
        "longitude, latitude (deg), ellipsoidal height (m)",
    ]
    return [*notes, render_table(heads, lines, numeric=[0])]


def _format_defect(
    row: Mapping[str, Any], label: str, crop: Path | None, card: Path | None, folder: Path
) -> list[object]:
    alternative = html_from_value(f"{row['defect_class']} {label}")
    target = card if card is not None else crop
    picture = Html('<span class="soft">no picture: no photograph of it can be read</span>')
    if crop is not None and target is not None:
        picture = Html(
            f'<a href="{link_file(target, folder)}">'
            f'<img class="crop" src="{link_file(crop, folder)}" alt="{alternative}"></a>'
        )
    number = Html(f'<b title="{html_from_value(row["defect_id"])}">{html_from_value(label)}</b>')
    if card is not None:
        number = Html(f'{number.text}<br><a href="{link_file(card, folder)}">card</a>')
    element = f"{row['element_name'] or row['ifc_class']}" + (f", {row['material']}" if row["material"] else "")
    return [
        number,
        picture,
        html_from_class(row["defect_class"]),
        describe_severity(row),
        _format_size(row),
        row["storey"],
        row["facade"],
        element,
        f"{row['photo_count']} photograph{'s' if row['photo_count'] != 1 else ''}",
        row["best_photo_id"],
        format_geo_position(row),
    ]


def _format_size(row: Mapping[str, Any]) -> str:
    text, width = f"{row['width_m']:.2f} × {row['height_m']:.2f} m", format_crack_width(row)
    return text if width is None else f"{text}; crack {width}"
