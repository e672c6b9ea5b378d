"""Section of the report on the passport: assessment, picture, facts with meaning and limit, residuals."""

from __future__ import annotations

from pathlib import Path

from facadelake.core.geodesy import SITE_AXES
from facadelake.reporting.html import Html, html_from_value, render_figure, render_paragraph, render_table
from facadelake.reporting.inspection import Inspection
from facadelake.reporting.passport.facts import FactStatus, list_passport_facts, summarise_passport
from facadelake.reporting.passport.figure import draw_passport
from schemas.vocabulary import PlacementCheckOutcome, PointKind

_STYLES = {FactStatus.GOOD: "good", FactStatus.CHECK: "check", FactStatus.POOR: "bad", FactStatus.NONE: "soft"}
_OUTCOMES = {
    PlacementCheckOutcome.AGREES: "good",
    PlacementCheckOutcome.DISAGREES: "bad",
    PlacementCheckOutcome.ACCEPTED: "check",
    PlacementCheckOutcome.NOT_COMPARABLE: "soft",
}
_CAPTION = (
    "Plan view and view from the south: cameras with 95 % confidence ellipses, surveyed points with arrows from the "
    "surveyed to the adjusted position, and GPS positions of the photographs. Right: facts and residuals."
)


def render_passport(inspection: Inspection, folder: Path) -> list[Html]:
    """Method and accuracy of the georeferencing; ``passport.png`` is written into ``folder``."""
    if not len(inspection.georeference):
        return [render_paragraph("The campaign has no passport.", "bad")]
    row = inspection.georeference.to_pylist()[0]
    facts = list_passport_facts(row, inspection.poses, placement_sigma_max_m=inspection.placement_sigma_max_m)
    status, sentence = summarise_passport(row, facts)
    lines = [[fact.name, fact.value, fact.meaning, fact.limit or None, _render_status(fact.status)] for fact in facts]
    elements = [
        render_paragraph(sentence, _STYLES[status]),
        render_figure(
            draw_passport(inspection, folder / "passport.png"), folder, "the passport of the campaign", _CAPTION
        ),
        render_table(["quantity", "value", "meaning", "limit", "assessment"], lines),
        _list_placement_checks(inspection),
        _list_surveyed_points(inspection),
    ]
    remarks = [remark for remark in row["remarks"].split("; ") if remark]
    if remarks:
        elements.append(
            Html("<p>Remarks</p><ul>" + "".join(f"<li>{html_from_value(one)}</li>" for one in remarks) + "</ul>")
        )
    return elements


def _render_status(status: FactStatus) -> Html:
    return Html(f'<span class="{_STYLES[status]}">{status or "not assessed"}</span>')


def _list_placement_checks(inspection: Inspection) -> Html:
    """Table of the statements that the placement was compared with, disagreements first, then accepted ones."""
    rows = inspection.placement_checks.to_pylist()
    first = [PlacementCheckOutcome.DISAGREES, PlacementCheckOutcome.ACCEPTED]
    rows.sort(key=lambda row: [row["placement_check_outcome"] != outcome for outcome in first])
    lines = [
        [
            row["statement"].replace("_", " "),
            _render_outcome(row["placement_check_outcome"]),
            row["detail"],
        ]
        for row in rows
    ]
    return render_table(["statement", "outcome", "comparison"], lines, caption="Placement checks: independent evidence")


def _render_outcome(outcome: str) -> Html:
    style = _OUTCOMES[PlacementCheckOutcome(outcome)]
    return Html(f'<span class="{style}">{outcome.replace("_", " ")}</span>')


def _list_surveyed_points(inspection: Inspection) -> Html:
    """Table of the residuals at control points, held-out points and check points."""
    rows = [row for row in inspection.georeference_points.to_pylist() if row["point_kind"] != PointKind.GPS]
    if not rows:
        return Html("")
    lines = [
        [
            row["point_name"],
            row["point_kind"].replace("_", " "),
            *(f"{-1000 * row[f'residual_{axis}_m']:+.0f}" for axis in SITE_AXES),
        ]
        for row in rows
    ]
    heads = ["point", "kind", *(f"{axis} (mm)" for axis in SITE_AXES)]
    return render_table(heads, lines, caption="Surveyed points: adjusted minus surveyed position", numeric=[2, 3, 4])
