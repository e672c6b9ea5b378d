"""The summary at the end of an inspection, and where its results are."""

from __future__ import annotations

import os
import webbrowser
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

from cli.terminal.coverage import describe_totals
from facadelake.deduplication import describe_width_blur
from facadelake.lake import read_table
from facadelake.severity import describe_severity
from schemas.vocabulary import ControlKind, PlacementCheckOutcome, PoseSource, StateEvidence

if TYPE_CHECKING:
    from flows.inspect_building import InspectionResult
    from flows.track_building import TrackingResult


def _count_values(values: Sequence[Any]) -> str:
    counts = Counter("none" if value is None else str(value) for value in values)
    return ", ".join(f"{n} {name}" for name, n in sorted(counts.items(), key=lambda item: -item[1])) or "none"


def show_inspection(console: Console, lake: Path, result: InspectionResult) -> None:
    """Print photographs, georeference, detections by outcome, defects by class and storey, and the files."""

    def rows(name: str) -> list[dict[str, Any]]:
        table = read_table(lake, name, building_id=result.building_id, campaign_id=result.campaign_id)
        found: list[dict[str, Any]] = table.to_pylist()
        return found

    photos, poses, passport = rows("photos"), rows("poses"), rows("georeference")[0]
    detections, observations, defects, checks = (
        rows("detections"),
        rows("observations"),
        rows("defects"),
        rows("checks"),
    )
    views = [view["ssim"] for view in rows("integrity_views") if view["ssim"] is not None]
    localised = [pose for pose in poses if PoseSource(pose["pose_source"]).measured]
    refused = [photo for photo in photos if photo["photo_outcome"] != "accepted"]

    table = RichTable(title=f"{result.building_id} {result.campaign_id}", show_header=False, title_justify="left")
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    table.add_row("photographs", f"{len(photos)} in, {len(localised)} localised, {len(refused)} rejected")
    _add_examples(table, "rejected", refused)
    _add_examples(table, "not localised", [pose for pose in poses if not PoseSource(pose["pose_source"]).measured])
    warned = [photo | {"reason": photo["prior_warnings"]} for photo in photos if photo["prior_warnings"]]
    if warned:
        table.add_row("metadata", f"{len(warned)} photographs with warnings")
        _add_examples(table, "warning", warned, "photographs_with_warnings")
    table.add_row("georeference", escape("\n".join(format_georeference(passport))))
    if passport["remarks"]:
        table.add_row("", escape(passport["remarks"]))
    placement = rows("placement_checks")
    comparable = [row for row in placement if row["placement_check_outcome"] != PlacementCheckOutcome.NOT_COMPARABLE]
    disagreeing = [row for row in comparable if row["placement_check_outcome"] == PlacementCheckOutcome.DISAGREES]
    accepted = [row for row in comparable if row["placement_check_outcome"] == PlacementCheckOutcome.ACCEPTED]
    agreeing = [row["statement"] for row in comparable if row not in [*disagreeing, *accepted]]
    table.add_row(
        "placement", f"{len(agreeing)} of {len(comparable)} statements agree ({', '.join(agreeing) or 'none'})"
    )
    for row in disagreeing:
        table.add_row("[yellow]disagreement[/yellow]", escape(row["detail"]))
    for row in accepted:
        table.add_row("[yellow]accepted[/yellow]", escape(row["detail"]))
    found = [row["detection_outcome"] for row in detections if row["detection_outcome"] != "accepted"]
    detectors = ", ".join(sorted({row["detector"] for row in detections}))
    by = f" by {escape(detectors)}" if detectors else ""
    table.add_row("detections", f"{len(detections)}{by}: {_count_values([*found, *_list_outcomes(observations)])}")
    table.add_row("defects", f"{len(defects)}: {_count_values([row['defect_class'] for row in defects])}")
    table.add_row("  by storey", _count_values([row["storey"] for row in defects]))
    table.add_row("  by facade", _count_values([row["facade"] for row in defects]))
    table.add_row("  by severity", _count_values([row["severity"] for row in defects]))
    uncertain = Counter(text for row in defects if (text := describe_severity(row)) != row["severity"])
    if uncertain:
        table.add_row("  uncertain", _count_values(list(uncertain.elements())))
    overstated = describe_width_blur([row["crack_width_blur_mm"] for row in defects])
    if overstated:
        table.add_row("[yellow]warning[/yellow]", overstated)
    if views:
        table.add_row(
            "model check", f"SSIM of as-built and model depth: mean {sum(views) / len(views):.2f} in {len(views)} views"
        )
    cells = read_table(lake, "coverage", building_id=result.building_id, campaign_id=result.campaign_id)
    table.add_row("coverage", describe_totals(cells))
    table.add_row("history", escape(_describe_history(rows("track_states"), result.building_id)))
    table.add_row("checks", f"{sum(check['passed'] for check in checks)} of {len(checks)} passed")
    table.add_row(
        "lake",
        f"version {result.version}"
        + ("" if result.changed else "; the campaign is unchanged, it was made of the same inputs"),
    )
    table.add_row("time", _format_times(result))
    table.add_row("files", str(result.release))
    for warning in result.warnings:
        table.add_row("[yellow]warning[/yellow]", escape(warning))
    console.print(table)


def _describe_history(states: Sequence[Mapping[str, Any]], building_id: str) -> str:
    """What became of the building's defects in a campaign."""
    if not states:
        return "none of its defects is followed: see the warnings"
    missed = sum(row["state_evidence"] == StateEvidence.LOOKS_THE_SAME for row in states)
    also = f"; {missed} of them not detected, but their places look the same" if missed else ""
    return f"{_count_values([row['track_state'] for row in states])}{also}; facadelake compare {building_id}"


def show_tracking(console: Console, result: TrackingResult) -> None:
    """Print the states of the latest campaign and the version of the lake."""
    counts = dict(result.stage.counts)
    tracks = counts.pop("tracks")
    states = ", ".join(f"{count} {state}" for state, count in counts.items() if state is not None)
    console.print(f"{result.building_id}: {tracks} tracks, in the latest campaign {states or 'none'}", highlight=False)
    version = "unchanged" if result.version is None else f"version {result.version}"
    console.print(f"lake: {version}; facadelake compare {result.building_id}", highlight=False)
    if result.version is not None:
        console.print(
            f"published: nothing yet; 'facadelake inspect {result.building_id}' publishes the latest campaign with "
            "this history",
            soft_wrap=True,
            highlight=False,
        )
    for warning in result.warnings:
        console.print(f"[yellow]warning[/yellow]: {escape(warning)}")


def format_georeference(passport: Mapping[str, Any]) -> list[str]:
    """A row of table ``georeference`` in a few lines: control, residuals, standard deviations, GPS offset."""
    axes = ("east", "north", "up")
    imported = passport["residual_mean_m"] is None
    placed = (
        f"{passport['control']} ({passport['method']}): {passport['points_used']} of {passport['points_total']} "
        f"{'poses' if imported else 'points'} used"
    )
    if not imported:
        placed += f", residual mean {passport['residual_mean_m']:.3f} m, max {passport['residual_max_m']:.3f} m"
    placed += "; "
    if passport["check_points"]:
        placed += (
            f"{passport['check_points']} held out: mean {passport['check_residual_mean_m']:.3f} m, "
            f"max {passport['check_residual_max_m']:.3f} m"
        )
    else:
        placed += "no held-out points"
    sigmas = " / ".join(f"{passport[f'sigma_{axis}_m']:.3f}" for axis in axes)
    lines = [placed, f"sigma {sigmas} m east / north / up; {_format_frame(passport)}"]
    offsets = [passport[f"gps_offset_{axis}_m"] for axis in axes]
    if passport["control"] != ControlKind.GPS and None not in offsets:
        lines.append(f"GPS offset {' / '.join(f'{part:+.2f}' for part in offsets)} m east / north / up")
    return lines


def _format_frame(passport: Mapping[str, Any]) -> str:
    text = f"{passport['map_crs']}, heights {passport['vertical_datum']}"
    earlier = passport["reference_campaign"]
    return text if earlier is None else f"{text}, in the frame of campaign {earlier}"


def _add_examples(
    table: RichTable, what: str, rows: Sequence[dict[str, Any]], question: str = "photographs_rejected"
) -> None:
    """Add the first three photographs with their reasons, and count the others, which the question lists."""
    for row in rows[:3]:
        table.add_row("", f"{what}: {escape(row['photo_id'])}, {escape(row['reason'] or '')}")
    if len(rows) > 3:
        table.add_row("", f"{what}: {len(rows) - 3} more (facadelake sql {question})")


def _list_outcomes(observations: Sequence[dict[str, Any]]) -> list[str]:
    return [row["observation_outcome"] for row in observations]


def _format_times(result: InspectionResult) -> str:
    fresh = [stage for stage in result.stages if not stage.hit]
    cached = len(result.stages) - len(fresh)
    parts = [f"{stage.stage} {stage.seconds:.0f} s" for stage in fresh if stage.seconds >= 1]
    total = sum(stage.seconds for stage in result.stages)
    text = f"{total:.0f} s in stages"
    if parts:
        text += f" ({', '.join(parts)})"
    if cached:
        text += f"; {cached} of {len(result.stages)} stages from the cache"
    return text


def show_next_steps(console: Console, lake: Path, results: Sequence[InspectionResult]) -> None:
    """Print what to open and to query after the demo; on a desktop the report is opened."""
    console.print("\n[bold]Reports[/bold]")
    for result in results:
        console.print(f"  {result.release / 'report.html'}", soft_wrap=True, highlight=False)
    last = results[-1]
    if console.is_terminal and any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")):
        webbrowser.open((last.release / "report.html").as_uri())
    console.print("[bold]Queries[/bold]")
    console.print(f"  .venv/bin/facadelake defects {last.building_id} {last.campaign_id}", highlight=False)
    console.print(
        '  .venv/bin/facadelake sql "SELECT campaign_id, defect_class, count(*) AS n FROM defects '
        'GROUP BY ALL ORDER BY ALL"',
        soft_wrap=True,
        highlight=False,
    )
    console.print("  .venv/bin/facadelake sql --list", highlight=False)
    console.print(f"[bold]In QGIS[/bold]\n  {last.release / 'defects.gpkg'}", soft_wrap=True, highlight=False)
