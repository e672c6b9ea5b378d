"""The report of a campaign: one HTML page and its pictures, for owners and inspectors."""

from __future__ import annotations

from pathlib import Path

from facadelake.building.surface import Surface
from facadelake.core.geodesy import SITE_AXES
from facadelake.reporting.cards.cards import draw_cards
from facadelake.reporting.cards.crops import write_crops
from facadelake.reporting.distribution import (
    compute_distribution,
    draw_distribution,
    format_distribution_title,
    write_distribution,
)
from facadelake.reporting.elevations.elevation import Elevation, draw_elevations, map_defects_to_elevations
from facadelake.reporting.elevations.relief import has_model_edges
from facadelake.reporting.history.since_last_time import SinceLastTime, describe_since_last_time
from facadelake.reporting.history.symbols import SYMBOL_STYLE
from facadelake.reporting.html import (
    Html,
    html_from_value,
    render_figure,
    render_page,
    render_paragraph,
    render_row,
    render_section,
    render_tiles,
)
from facadelake.reporting.inspection import Inspection, PictureSettings
from facadelake.reporting.overlays import draw_overlays, select_overlay_photographs
from facadelake.reporting.page.campaign import (
    count_outcomes,
    describe_integrity,
    list_photographs_with_warnings,
    list_unused_photographs,
    summarise_checks,
)
from facadelake.reporting.page.coverage import describe_coverage
from facadelake.reporting.page.defects import count_by_facade, describe_severity_rules, list_defects
from facadelake.reporting.page.passport import render_passport
from facadelake.reporting.passport.facts import format_length
from facadelake.reporting.plan import draw_plan
from facadelake.reporting.severity_order import sort_by_severity
from schemas.vocabulary import PhotoOutcome, UtcOffset

_OVERLAY = (
    "Projected model edges, detections by outcome, and registered defects. Where model edges and building differ, the "
    "pose of the photograph or the model is inaccurate."
)
_OVERLAY_WITHOUT_EDGES = "Detections by outcome, and registered defects."
_PLAN = "Metres east and north of the site's origin. Arrows show viewing directions; short arrows point up or down."
_SINCE, _SINCE_TITLE = "since", "Since last time"
_CONTENTS = {
    "elevations": "Elevations",
    "coverage": "Coverage",
    "defects": "Defects",
    "severity": "Severity rules",
    "distribution": "Distribution",
    "plan": "Plan",
    "photographs": "Photographs",
    "passport": "Passport",
    "checks": "Checks",
}


def write_report(
    inspection: Inspection,
    surface: Surface,
    folder: Path,
    settings: PictureSettings | None = None,
    since: SinceLastTime | None = None,
) -> Path:
    """Write ``report.html`` with its pictures; links are relative, so that the folder can be moved as a whole.

    Args:
        inspection: the campaign.
        surface: surface of its building model.
        folder: folder to write into.
        settings: resolution and limits of the pictures; None: the defaults.
        since: the comparison with the campaign before; None: there is no section on it.

    Returns:
        The path of ``report.html``.
    """
    settings = settings or PictureSettings()
    folder.mkdir(parents=True, exist_ok=True)
    elevations = draw_elevations(inspection, surface, folder, settings)
    plan = draw_plan(inspection, folder / "plan.png")
    distribution = compute_distribution(inspection)
    bars = draw_distribution(distribution, format_distribution_title(inspection), folder / "distribution.png")
    write_distribution(distribution, folder / "distribution.csv")
    crops = write_crops(inspection, folder / "crops", settings)
    worst = [row["defect_id"] for row in sort_by_severity(inspection.defects)[: settings.report_cards]]
    cards = draw_cards(
        inspection, surface, worst, folder / "cards", overviews=map_defects_to_elevations(elevations),
        max_observations=settings.report_observations,
    )  # fmt: skip
    overlays = draw_overlays(
        inspection, surface, select_overlay_photographs(inspection, settings.report_overlays), folder, settings
    )
    title = f"{inspection.building_name} — {inspection.campaign_id}"
    overlay_caption = _OVERLAY if has_model_edges(inspection.building) else _OVERLAY_WITHOUT_EDGES
    body = [
        Html(f"<h1>{html_from_value(title)}</h1>"),
        render_paragraph(_format_subtitle(inspection), "under"),
        _render_contents(since is not None),
        _render_key_figures(inspection),
        *_describe_since(inspection, surface, since, folder),
        render_section("elevations", "Elevations", *(_render_elevation(e, folder) for e in elevations)),
        render_section("coverage", "Coverage", *describe_coverage(inspection, elevations, folder)),
        render_section("defects", "Defects", *list_defects(inspection, crops, cards.paths, elevations, folder)),
        render_section("severity", "Severity rules", *describe_severity_rules(inspection)),
        render_section(
            "distribution", "Distribution", count_by_facade(distribution),
            render_figure(bars, folder, "bars of defects by facade and storey", "Defects by facade and storey."),
        ),
        render_section("plan", "Plan", render_figure(plan, folder, "plan with cameras and defects", _PLAN)),
        render_section(
            "photographs", "Photographs", render_row(count_outcomes(inspection)), list_unused_photographs(inspection),
            list_photographs_with_warnings(inspection),
            *(render_figure(path, folder, "overlay of a photograph", overlay_caption) for path in overlays.values()),
        ),
        render_section("passport", "Passport: georeferencing and accuracy", *render_passport(inspection, folder)),
        render_section(
            "checks", "Data checks",
            render_row(summarise_checks(inspection.checks)), describe_integrity(inspection.integrity_views),
        ),
    ]  # fmt: skip
    path = folder / "report.html"
    path.write_text(render_page(title, body, style=SYMBOL_STYLE), encoding="utf-8")
    return path


def _format_subtitle(inspection: Inspection) -> str:
    times = [time for time in inspection.photos.column("taken_at").to_pylist() if time is not None]
    when = f"photographed {min(times):%Y-%m-%d}" if times else "date of photographs unknown"
    if times and max(times).date() != min(times).date():
        when += f" to {max(times):%Y-%m-%d}"
    if UtcOffset.UNKNOWN in inspection.photos.column("utc_offset").to_pylist():
        when += " by a clock of unknown offset from UTC"
    return f"Facade inspection · {when} · georeferenced by {inspection.control}"


def _describe_since(inspection: Inspection, surface: Surface, since: SinceLastTime | None, folder: Path) -> list[Html]:
    if since is None:
        return []
    parts = describe_since_last_time(since, surface, inspection.building.origin, folder)
    return [render_section(_SINCE, _SINCE_TITLE, *parts)]


def _render_contents(has_since: bool) -> Html:
    contents = {**({_SINCE: _SINCE_TITLE} if has_since else {}), **_CONTENTS}
    return Html("<nav>" + "".join(f'<a href="#{name}">{title}</a>' for name, title in contents.items()) + "</nav>")


def _render_key_figures(inspection: Inspection) -> Html:
    passed = inspection.checks.column("passed").to_pylist()
    failed = len(passed) - sum(passed)
    sigmas = [inspection.georeference.column(f"sigma_{axis}_m").to_pylist() for axis in SITE_AXES]
    accepted = inspection.photos.column("photo_outcome").to_pylist().count(PhotoOutcome.ACCEPTED)
    return render_tiles(
        [
            (len(inspection.defects), "defects"),
            (f"{len(inspection.posed)} / {accepted}", "photographs localised"),
            (len(inspection.detections), "detections"),
            (format_length(max(sigma[0] for sigma in sigmas)) if sigmas[0] else None, "largest standard deviation"),
            (Html(f'<span class="bad">{failed} of {len(passed)}</span>' if failed else f"{len(passed)}"),
             "checks failed" if failed else "checks passed"),
        ]
    )  # fmt: skip


def _render_elevation(elevation: Elevation, folder: Path) -> Html:
    count = len(elevation.marks)
    name = elevation.facade.title
    caption = (
        f"{name}, azimuth {elevation.facade.azimuth_deg:.0f}°, {elevation.facade.area_m2:.0f} m² of walls and "
        f"openings, {count} defect{'' if count == 1 else 's'}. Orthographic view from outside; rectified photographs "
        f"cover {100 * elevation.covered_share:.0f} % of the surface, elsewhere the model is shown. "
        f"{_describe_hidden(elevation)} Labels are the numbers in the table of defects."
    )
    return render_figure(elevation.path, folder, f"elevation of the {name} with {count} defects", caption)


def _describe_hidden(elevation: Elevation) -> str:
    """What hides the facade from the photographs, which is not covered, and whether it could be known."""
    if elevation.hidden_regions:
        regions = "; ".join(
            f"u {one.u_min_m:.1f} to {one.u_max_m:.1f} m, v {one.v_min_m:.1f} to {one.v_max_m:.1f} m "
            f"({one.area_m2:.1f} m²)"
            for one in elevation.hidden_regions
        )
        text = (
            f"Hatched and not counted as covered ({100 * elevation.hidden_share:.1f} % of the surface), because an "
            f"object in front of the wall hides it or photographs contradict one another: {regions}."
        )
    else:
        text = "Nothing larger than 0.1 m² was found to hide it."
    if not elevation.obstructions_known:
        text += " There is no as-built surface here, so objects that all photographs show alike were not found."
    return text
