"""The page of a comparison: counts, elevations, the list of what changed, and a pair of pictures for each track."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from facadelake.reporting.history.compared_track import ComparedTrack
from facadelake.reporting.history.comparison import BuildingComparison
from facadelake.reporting.history.elevations import ElevationPicture, render_elevation
from facadelake.reporting.history.findings import COUNTED_ONLY, MEANINGS, Finding
from facadelake.reporting.history.pair_view import PAIR_SCRIPT, PAIR_STYLE, render_pair
from facadelake.reporting.history.pairs import Pair
from facadelake.reporting.history.sentences import (
    describe_count,
    describe_evidence,
    describe_grade,
    describe_look,
    describe_offsets,
    describe_place,
    describe_sizes,
    describe_span,
    format_offset,
)
from facadelake.reporting.history.size_changes import format_changes
from facadelake.reporting.history.symbols import (
    SYMBOL_STYLE,
    render_class,
    render_definitions,
    render_named_symbol,
    render_symbol,
    render_timeline,
)
from facadelake.reporting.html import (
    Html,
    html_from_value,
    render_page,
    render_paragraph,
    render_section,
    render_table,
    render_tiles,
)

PAGE_NAME = "comparison.html"
_STYLE = (
    # On a narrow screen an elevation is scrolled: scaled down, its signs and numbers could not be read.
    "figure.elevation { overflow-x: auto; } figure.elevation svg { min-width: min(720px, var(--widest)); }"
    " figure.elevation svg { width: 100%; height: auto; max-height: 88vh; background: #fff; "
    "border: 1px solid var(--line); }"
    " path.storey { stroke: #202020; stroke-dasharray: 10 6; opacity: 0.5; }"
    " text.storey { fill: #202020; font-family: system-ui, sans-serif; } path.scale { stroke: #202020; fill: none; }"
    " .ring { fill: none; stroke: var(--mark); } .tag rect { fill: #fff; stroke: var(--mark); opacity: 0.92; }"
    " .tag text { fill: #111; font-family: system-ui, sans-serif; font-weight: 600; }"
    " ol.strip { display: flex; flex-wrap: wrap; gap: 0.3rem; list-style: none; padding: 0; margin: 0.4rem 0; }"
    " ol.strip li { border: 1px solid var(--line); border-radius: 4px; padding: 0.15rem 0.6rem; font-size: 0.85rem; }"
    " ol.strip li.chosen { background: var(--band); border-color: var(--soft); }"
    " article { border-top: 1px solid var(--line); padding: 0.7rem 0; }"
    " article h3 { margin: 0; font-size: 1.02rem; } article p { margin: 0.15rem 0; }"
    " article:target h3 { background: #f0e44266; }"
    " .filter { display: flex; flex-wrap: wrap; gap: 0.2rem 1.2rem; margin: 0.5rem 0; } "
    + " ".join(
        f"body:has(#show-{finding.name.lower()}:not(:checked)) article"
        f".f-{finding.name.lower()}, body:has(#show-{finding.name.lower()}:not(:checked)) figure.elevation "
        f".f-{finding.name.lower()}, body:has(#show-{finding.name.lower()}:not(:checked)) #list "
        f"tr:has(svg.f-{finding.name.lower()}) {{ display: none; }}"
        for finding in Finding
    )
    + " #list td:last-child { min-width: 12rem; }"
    + " @media print { #list td:last-child { min-width: 0; } .filter { display: none; }"
    + " article { break-inside: avoid; } }"
)


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparisonPictures:
    """What was drawn of a comparison: elevations, pairs by track, links to cards by campaign and defect.

    ``shown_max``: number of listed tracks that are shown with their pairs; more would make the page too large.
    ``remark``: why there are no elevations or pairs; empty where there are.
    """

    elevations: Sequence[ElevationPicture]
    pairs: Mapping[str, Pair]
    cards: Mapping[tuple[str, str], str]
    shown_max: int
    remark: str = ""


def write_page(comparison: BuildingComparison, pictures: ComparisonPictures, building_name: str, folder: Path) -> Path:
    """Write ``comparison.html`` into ``folder``, which holds the pictures; returns its path.

    Args:
        comparison: the comparison.
        pictures: its pictures.
        building_name: name of the building.
        folder: existing folder.
    """
    title = f"{building_name} — {comparison.earlier} to {comparison.later}"
    shown = comparison.listed[: pictures.shown_max]
    anchors = {track.track_id: _name_anchor(track) for track in shown}
    findings = {track.track_id: track.finding for track in comparison.tracks}
    body = [
        render_definitions(),
        Html(f"<h1>{html_from_value(title)}</h1>"),
        render_paragraph(f"Comparison of two inspections · {describe_span(comparison)}", "under"),
        Html(
            '<nav><a href="#counts">Counts</a><a href="#elevations">Elevations</a><a href="#list">List</a>'
            '<a href="#pairs">Before and after</a><a href="#places">Facades and storeys</a>'
            '<a href="#frames">Frames</a></nav>'
        ),
        _render_key_figures(comparison),
        render_section("counts", "What became of the defects", *_render_counts(comparison)),
        render_section(
            "elevations",
            "Elevations",
            *(render_elevation(one, findings, anchors, folder) for one in pictures.elevations),
            *_note_missing_elevations(pictures, comparison),
        ),
        render_section("list", "What needs attention", *_render_list(comparison, anchors)),
        render_section(
            "pairs",
            "Before and after",
            *_introduce_pairs(comparison, pictures),
            *(_render_track(track, pictures, comparison, folder) for track in shown),
        ),
        render_section("places", "By facade and storey", _render_places(comparison)),
        render_section("frames", "Offset between the campaigns", *_render_offsets(comparison)),
        Html(f"<script>{PAIR_SCRIPT}</script>"),
    ]
    path = folder / PAGE_NAME
    path.write_text(render_page(title, body, style=f"{SYMBOL_STYLE}{PAIR_STYLE}{_STYLE}"), encoding="utf-8")
    return path


def _name_anchor(track: ComparedTrack) -> str:
    return f"track-{track.track_id}"


def _render_key_figures(comparison: BuildingComparison) -> Html:
    counts = comparison.count_findings()
    tiles: list[tuple[object, str]] = [
        (comparison.there_count, f"defects in {comparison.earlier} or {comparison.later}")
    ]
    tiles += [
        (Html(f"{render_symbol(finding).text} {count}"), str(finding))
        for finding, count in counts.items()
        if finding not in COUNTED_ONLY
    ]
    return render_tiles(tiles)


def _render_counts(comparison: BuildingComparison) -> list[Html]:
    counts = comparison.count_findings()
    rows = [[render_named_symbol(finding), count, MEANINGS[finding]] for finding, count in counts.items()]
    boxes = "".join(
        f'<label><input type="checkbox" id="show-{finding.name.lower()}" checked> '
        f"{render_named_symbol(finding).text} ({count})</label>"
        for finding, count in counts.items()
    )
    return [
        render_table(["", "defects", "meaning"], rows, caption=describe_count(comparison), numeric=[1]),
        Html(f'<p class="soft">Show on this page:</p><div class="filter">{boxes}</div>'),
    ]


def _note_missing_elevations(pictures: ComparisonPictures, comparison: BuildingComparison) -> list[Html]:
    if pictures.remark:
        return [render_paragraph(pictures.remark)]
    if not pictures.elevations:
        return [render_paragraph("No defect is on a facade that can be drawn.")]
    drawn = {mark.defect_id for picture in pictures.elevations for mark in picture.marks}
    missing = [track.track_id for track in comparison.listed if track.track_id not in drawn]
    if not missing:
        return []
    return [
        render_paragraph(
            f"On no elevation (soffits, horizontal surfaces, walls hidden in the view): {', '.join(missing)}."
        )
    ]


def _render_list(comparison: BuildingComparison, anchors: Mapping[str, str]) -> list[Html]:
    heads = [
        "track", "", "class", "severity", "facade", "storey", comparison.earlier, comparison.later,
        "change ± sigma", "why",
    ]  # fmt: skip
    rows = [
        [
            _link_track(track, anchors),
            render_named_symbol(track.finding),
            render_class(track),
            describe_grade(track),
            track.place["facade"],
            track.place["storey"],
            *(size or None for size in describe_sizes(track)),
            format_changes(track.changes, track.defect_class, track.pair) or None,
            describe_evidence(track) or None,
        ]
        for track in comparison.listed
    ]
    counted = len(comparison.tracks) - len(rows)
    note = (
        "Defects that are reopened, grown or of another class first, the most severe at the head. Length and area are "
        "medians of a campaign's sightings; the change is their difference, with one standard error. 'Grown' and "
        "'shrunk' are significant beyond both campaigns' errors. "
        f"{counted} unchanged defect{'' if counted == 1 else 's'} (or still repaired) are counted, not listed."
    )
    return [render_paragraph(note), render_table(heads, rows)]


def _link_track(track: ComparedTrack, anchors: Mapping[str, str]) -> Html:
    name, anchor = html_from_value(track.track_id), anchors.get(track.track_id)
    link = f'<a href="#{escape(anchor, quote=True)}">{name}</a>' if anchor else name
    return Html(f'<span class="one-line">{link}</span>')


def _introduce_pairs(comparison: BuildingComparison, pictures: ComparisonPictures) -> list[Html]:
    text = (
        f"Left of the slider {comparison.earlier}, right of it {comparison.later}: both photographs are rectified onto "
        "the surface at one scale with one size of cell, and the later one is aligned with the earlier one. The "
        "difference is without light and shadow: orange became darker, blue became lighter. The dashed line is the "
        "defect's outline."
    )
    parts = [render_paragraph(text)] if pictures.pairs else [render_paragraph(pictures.remark)]
    omitted = len(comparison.listed) - pictures.shown_max
    if omitted > 0:
        parts.append(
            render_paragraph(
                f"Pairs of {pictures.shown_max} of {len(comparison.listed)} listed defects are shown, those that "
                f"matter most; {omitted} are omitted to limit the size of the page. 'facadelake why TRACK "
                "--pictures FOLDER' draws those of one defect, 'facadelake compare --pairs N' more of them."
            )
        )
    return parts


def _render_track(
    track: ComparedTrack, pictures: ComparisonPictures, comparison: BuildingComparison, folder: Path
) -> Html:
    sizes = [f"{name}: {size or 'not detected'}" for name, size in zip(track.pair, describe_sizes(track), strict=True)]
    change = format_changes(track.changes, track.defect_class, track.pair)
    facts = " · ".join([describe_place(track), *sizes, *([change] if change else [])])
    links = [
        f'<a href="{escape(link, quote=True)}">card of {escape(campaign)}</a>'
        for (campaign, defect_id), link in pictures.cards.items()
        if any(
            entry.campaign_id == campaign and entry.defect is not None and entry.defect["defect_id"] == defect_id
            for entry in track.timeline
        )
    ]
    head = (
        f"{render_symbol(track.finding).text} {html_from_value(track.track_id)} · {html_from_value(track.finding)} · "
        f"{render_class(track).text} · {html_from_value(describe_grade(track))}"
    )
    told = "".join(
        f"<p>{html_from_value(text)}</p>"
        for text in (describe_evidence(track), describe_look(track, comparison))
        if text
    )
    pair, names = pictures.pairs.get(track.track_id), (comparison.earlier, comparison.later)
    anchor = escape(_name_anchor(track), quote=True)
    return Html(
        f'<article id="{anchor}" class="f-{track.finding.name.lower()}"><h3>{head}</h3>'
        f'<p class="soft">{html_from_value(facts)}</p>{told}'
        f"{render_pair(track.track_id, pair, names, folder).text if pair else ''}"
        f"{render_timeline(track.timeline, names).text}"
        f"<p>{' · '.join(links)}</p></article>"
    )


def _render_places(comparison: BuildingComparison) -> Html:
    counts = comparison.count_findings()
    heads = ["facade", "storey", *(str(finding) for finding in counts), "all"]
    rows: list[list[object]] = [
        [*place, *(own.get(finding) for finding in counts), sum(own.values())]
        for place, own in comparison.count_by_place().items()
    ]
    rows.append(["all", "", *counts.values(), sum(counts.values())])
    return render_table(heads, rows, numeric=range(2, len(heads)))


def _render_offsets(comparison: BuildingComparison) -> list[Html]:
    rows = [
        [
            offset.facade or "whole building",
            *format_offset(offset),
            *(count or None for count in offset.counts),
            offset.remark or None,
        ]
        for offset in comparison.offsets
    ]
    heads = [
        "facade", "east, cm", "north, cm", "up, cm", f"defects of {comparison.earlier}",
        f"defects of {comparison.later}", "",
    ]  # fmt: skip
    note = (
        f"All offsets here are of {comparison.later} from {comparison.earlier}. Table frame_offsets of the lake has "
        f"those of each campaign from the first one, {comparison.campaigns[0]}; 'facadelake why' tells each from the "
        "campaign before it."
    )
    return [
        render_paragraph(describe_offsets(comparison)),
        render_table(heads, rows, numeric=[1, 2, 3, 4, 5]),
        render_paragraph(note, "soft"),
    ]
