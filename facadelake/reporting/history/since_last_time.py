"""Section of a campaign's report: what became of the defects since the campaign before it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path

import pyarrow as pa

from facadelake.building.surface import Surface
from facadelake.core.errors import InputDataError
from facadelake.core.geodesy import SiteOrigin
from facadelake.registry import Building
from facadelake.reporting.history.compared_track import ComparedTrack
from facadelake.reporting.history.comparison import (
    BuildingComparison,
    compare_campaigns,
    order_campaigns,
)
from facadelake.reporting.history.draw import (
    BuildingTables,
    create_request,
    create_track_marks,
    locate_comparison,
    read_photographs,
)
from facadelake.reporting.history.findings import Finding
from facadelake.reporting.history.page import PAGE_NAME
from facadelake.reporting.history.pairs import Pair, PosedPhotographs, write_pairs
from facadelake.reporting.history.sentences import (
    describe_evidence,
    describe_grade,
    describe_offsets,
    describe_sizes,
    describe_span,
)
from facadelake.reporting.history.size_changes import format_changes
from facadelake.reporting.history.symbols import render_class, render_definitions, render_named_symbol
from facadelake.reporting.html import Html, html_from_value, link_file, render_paragraph, render_table
from schemas.vocabulary import OffsetOutcome

_OMITTED = frozenset({Finding.NOT_FOUND, Finding.MISSED, Finding.SHRUNK})
_FIRST = "No earlier campaign of the building is in the lake, so there is nothing to compare."
_LISTED_MAX, _PICTURED_MAX, _CELLS_MAX = 60, 20, 200


@dataclass(frozen=True, kw_only=True, eq=False)
class SinceLastTime:
    """What a report tells of the campaign before: a comparison with both campaigns' photographs, else a remark.

    ``photographs``: of the earlier and the later campaign; None where they are not known. ``page``: link to the page of
    the comparison; empty where there is none.
    """

    comparison: BuildingComparison | None
    photographs: tuple[PosedPhotographs, PosedPhotographs] | None = None
    page: str = ""
    remark: str = ""


def compare_with_previous(
    tables: Mapping[str, pa.Table], building: Building, campaign_id: str, lake: Path, origin: SiteOrigin
) -> SinceLastTime:
    """Compare a campaign with the one before it by capture time, of those that are tracked.

    Args:
        tables: tables of the building: those of a comparison, buildings and poses.
        building: the building in the portfolio.
        campaign_id: the campaign.
        lake: folder of the lake, where a page of the comparison may be.
        origin: origin of the site frame.

    Returns:
        The comparison; a remark for a first campaign, and for one that is not tracked.
    """
    refused = {
        row["campaign_id"]
        for row in tables["frame_offsets"].to_pylist()
        if row["offset_outcome"] == OffsetOutcome.REFUSED and row["campaign_id"] != campaign_id
    }
    campaigns = tables["campaigns"]
    kept = campaigns.filter(
        pa.array([name not in refused for name in campaigns.column("campaign_id").to_pylist()], pa.bool_())
    )
    if order_campaigns(kept)[0]["campaign_id"] == campaign_id:
        return SinceLastTime(
            comparison=None,
            remark="No earlier campaign of the building is in the lake, so there is nothing to compare.",
        )
    try:
        comparison = compare_campaigns({**tables, "campaigns": kept}, None, campaign_id)
    except InputDataError as error:
        return SinceLastTime(comparison=None, remark=f"Not compared with the campaign before: {error}.")
    history = BuildingTables(building_id=building.id, lake=lake, version=None, tables=tables)
    earlier, later = (
        read_photographs(history, building, name, origin) for name in (comparison.earlier, comparison.later)
    )
    folder = locate_comparison(lake, building.id, comparison.earlier, comparison.later)
    link = Path("../../../..") / folder.relative_to(lake) / PAGE_NAME  # from a release in published/
    return SinceLastTime(
        comparison=comparison,
        photographs=(earlier, later),
        page=link.as_posix() if (folder / PAGE_NAME).is_file() else "",
    )


def describe_since_last_time(since: SinceLastTime, surface: Surface, origin: SiteOrigin, folder: Path) -> list[Html]:
    """Counts by finding, and a table of what is new, reopened, grown, repaired or not imaged, with pictures.

    Args:
        since: the comparison.
        surface: the building's surface.
        origin: origin of the site frame.
        folder: folder of the report; pictures are written into ``since_last_time/``.
    """
    comparison = since.comparison
    if comparison is None:
        return [render_paragraph(since.remark)]
    counts = comparison.count_findings()
    shown = [track for track in comparison.listed if track.finding not in _OMITTED]
    pairs = _draw_pairs(shown[:_PICTURED_MAX], since, surface, origin, folder)
    parts = [
        render_definitions(),
        render_paragraph(f"{describe_span(comparison)}. {describe_offsets(comparison)}"),
        render_table(
            ["", "defects"], [[render_named_symbol(finding), count] for finding, count in counts.items()], numeric=[1]
        ),
        render_paragraph(_link_page(since, comparison)),
    ]
    if not shown:
        return [
            *parts,
            render_paragraph(
                "Nothing is new, reopened, grown, of another class or severity, repaired, or was not looked at."
            ),
        ]
    heads = [
        "track", "", comparison.earlier, comparison.later, "class", "severity", "facade", "storey", "change ± sigma",
        "why",
    ]  # fmt: skip
    rows = [_render_row(track, pairs.get(track.track_id), folder) for track in shown[:_LISTED_MAX]]
    caption = "New, reopened, grown, of another class or severity, repaired, not looked at"
    if len(shown) > _LISTED_MAX:
        caption += f" (the {_LISTED_MAX} most urgent of {len(shown)})"
    if len(shown) > _PICTURED_MAX:
        caption += f"; pictures of the first {_PICTURED_MAX}"
    return [*parts, render_table(heads, rows, caption=caption), *_list_remarks(pairs)]


def _draw_pairs(
    tracks: list[ComparedTrack], since: SinceLastTime, surface: Surface, origin: SiteOrigin, folder: Path
) -> Mapping[str, Pair]:
    """Small pictures of tracks.

    Args:
        tracks: the tracks.
        since: the comparison with its photographs.
        surface: the building's surface.
        origin: origin of the site frame.
        folder: folder of the report.
    """
    if since.photographs is None or since.comparison is None or not tracks:
        return {}
    marks = create_track_marks([track.place for track in tracks], [track.track_id for track in tracks], origin)
    requests = [create_request(track, since.comparison, marks[track.track_id]) for track in tracks]
    return write_pairs(requests, *since.photographs, surface, folder / "since_last_time", _CELLS_MAX)


def _link_page(since: SinceLastTime, comparison: BuildingComparison) -> Html:
    command = f"facadelake compare {comparison.building_id} {comparison.earlier} {comparison.later}"
    if since.page:
        link = escape(since.page, quote=True)
        return Html(f'<a href="{link}">Comparison with elevations, pictures and differences of all listed defects</a>')
    return Html(
        f"<code>{html_from_value(command)}</code> writes a page with elevations, pictures and differences of all "
        "listed defects."
    )


def _render_row(track: ComparedTrack, pair: Pair | None, folder: Path) -> list[object]:
    pictures = [None, None] if pair is None else [pair.before, pair.after]
    return [
        Html(f'<span class="one-line">{html_from_value(track.track_id)}</span>'),
        render_named_symbol(track.finding),
        *(
            _render_sight(path, size, folder, f"{track.track_id} in {name}")
            for path, size, name in zip(pictures, describe_sizes(track), track.pair, strict=True)
        ),
        render_class(track),
        describe_grade(track),
        track.place["facade"],
        track.place["storey"],
        format_changes(track.changes, track.defect_class, track.pair) or None,
        describe_evidence(track) or None,
    ]


def _render_sight(path: Path | None, size: str, folder: Path, alternative: str) -> Html | None:
    """The picture of a place in a campaign above the size of the defect there; None where there is neither."""
    parts = [html_from_value(size)] if size else []
    if path is not None:
        link = link_file(path, folder)
        image = f'<img class="crop" src="{link}" alt="{escape(alternative, quote=True)}">'
        parts.insert(0, f'<a href="{link}">{image}</a>')
    return Html("".join(parts)) if parts else None


def _list_remarks(pairs: Mapping[str, Pair]) -> list[Html]:
    """Why pictures are missing, each reason once with its tracks."""
    tracks: dict[str, list[str]] = {}
    for track_id, pair in pairs.items():
        for remark in pair.remarks:
            tracks.setdefault(remark, []).append(track_id)
    return [render_paragraph(f"{', '.join(sorted(names))}: {remark}.", "soft") for remark, names in tracks.items()]
