"""Listings of what is registered, what the lake holds, and what a regrading changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

from facadelake.core.errors import InputDataError
from facadelake.lake import Regrading, exists, read_table, versions
from facadelake.registry import Portfolio, read_portfolio
from schemas.vocabulary import CrackWidthOutcome, DefectClass

ROOMY_COLUMNS = 120  # a narrower terminal is not shown where a defect is; 'facadelake sql' and 'export' tell


def show_campaigns(console: Console, portfolio: Portfolio, lake: Path, only: str | None) -> None:
    """One line for each campaign that is registered or in the lake."""
    if only is not None:
        portfolio.building(only)
    held = read_table(lake, "campaigns", building_id=only).to_pylist() if exists(lake) else []
    runs = {(r["building_id"], r["campaign_id"]): r for r in read_table(lake, "runs").to_pylist()} if held else {}
    newest = (
        {(v["building_id"], v["campaign_id"]): str(v["version"]) for v in versions(lake).to_pylist()} if held else {}
    )
    table = RichTable(title=f"Campaigns (lake {lake})", title_justify="left")
    for column in (
        "building",
        "campaign",
        "photographs",
        "localised",
        "detections",
        "defects",
        "inspected (UTC)",
        "version",
    ):
        table.add_column(column)
    lines: dict[tuple[str, str], tuple[str, ...]] = {}
    for building in portfolio.buildings:
        if only in (None, building.id):
            for campaign in building.known_campaigns():
                lines[building.id, campaign] = ("", "", "", "", "not yet inspected", "")
    for row in held:
        key = (row["building_id"], row["campaign_id"])
        counts = (row["photos_total"], row["photos_localised"], row["detections_total"], row["defects_total"])
        lines[key] = (*map(str, counts), f"{runs[key]['finished_at']:%Y-%m-%d %H:%M}", newest.get(key, ""))
    for key in sorted(lines):
        table.add_row(*key, *lines[key])
    console.print(table)


def require_known(lake: Path, portfolio: Path, building: str) -> None:
    """Raise for a building that neither the lake nor the registry knows, with the ids that the registry has.

    What the lake holds can be asked for, even when the registry no longer names it.
    """
    if not exists(lake) or not len(read_table(lake, "campaigns", building_id=building)):
        read_portfolio(portfolio).building(building)


def _crack_mm(row: Mapping[str, Any]) -> str:
    """A crack's mean width, or the bound it lies below; nothing where neither is known."""
    width, limit = row["crack_width_mm"], row["crack_width_limit_mm"]
    if width is not None:
        return f"{width:.1f}"
    return f"< {limit:.1f}" if row["crack_width_outcome"] == CrackWidthOutcome.BELOW_LIMIT and limit is not None else ""


def show_defects(
    console: Console,
    lake: Path,
    building: str,
    campaign: str | None,
    defect_class: str | None,
    limit: int,
    as_of: int | None,
) -> None:
    """A table of defects, the most severe classes first by size."""
    if defect_class is not None and defect_class not in set(DefectClass):
        raise InputDataError(f"there is no class '{defect_class}'; allowed are {', '.join(DefectClass)}")
    rows = read_table(lake, "defects", building_id=building, campaign_id=campaign, as_of=as_of).to_pylist()
    if not rows:
        raise InputDataError(
            f"the lake {lake} has no defects of building '{building}'"
            + (f", campaign '{campaign}'" if campaign else "")
            + "; 'facadelake campaigns' lists what it holds, 'facadelake inspect' adds to it"
        )
    chosen = [row for row in rows if defect_class in (None, row["defect_class"])]
    chosen.sort(key=lambda row: -max(row["width_m"], row["height_m"]))
    table = RichTable(title=f"{len(chosen)} defects of {building}, the largest first", title_justify="left")
    roomy = console.width >= ROOMY_COLUMNS
    for name in ("defect", "class", "severity", "facade", "storey", "size cm", "seen"):
        table.add_column(name, justify="right" if name in ("size cm", "seen") else "left", no_wrap=True)
    if roomy:
        table.add_column("crack mm", justify="right", no_wrap=True)
        table.add_column("element")
        table.add_column("lon, lat, ellipsoidal height", no_wrap=True)
    for row in chosen[:limit]:
        cells = [row["defect_id"], row["defect_class"], row["severity"], row["facade"], row["storey"] or ""]
        cells += [f"{row['width_m'] * 100:.0f} x {row['height_m'] * 100:.0f}", str(row["photo_count"])]
        if roomy:
            cells.append(_crack_mm(row))
            cells.append(escape(row["element_name"] or row["ifc_class"]))
            cells.append(f"{row['lon_deg']:.7f}, {row['lat_deg']:.7f}, {row['height_ellipsoidal_m']:.2f}")
        table.add_row(*cells)
    console.print(table)
    if len(chosen) > limit:
        console.print(f"{len(chosen) - limit} more; --limit {len(chosen)} shows all")


def show_regrading(console: Console, found: Regrading, releases: Sequence[Path], registered: str | None) -> None:
    """A line for each step from one grade to another, then what stays, the version and where its files are.

    ``registered``: the rule pack that the registry names for the building, None where it is not registered.
    """
    if found.steps:
        table = RichTable(title=f"{found.building_id} graded by {found.rules}", title_justify="left")
        for name in ("campaign", "from", "to", "defects"):
            table.add_column(name, justify="right" if name == "defects" else "left")
        for step in found.steps:
            (word, rule), (new_word, _) = step.before, step.after
            table.add_row(step.campaign_id, f"{word} ({rule})", new_word, str(step.defects))
        console.print(table)
    else:
        console.print(f"nothing changed: every defect of {found.building_id} has its grade by {found.rules} already")
    if found.unchanged and found.steps:
        console.print(f"{found.unchanged} more have this grade already")
    if found.by_persons:
        console.print(f"{found.by_persons} were graded by a person and stay as they are")
    if found.version is None:
        if found.steps:
            console.print("dry run: nothing was written")
        return
    console.print(f"lake version {found.version}; earlier versions stay readable (--as-of)")
    for release in releases:
        console.print(f"files {release}", soft_wrap=True, highlight=False)
    if registered not in (None, found.rules):
        console.print(
            f"the registry grades {found.building_id} by {registered}: a new inspection of changed inputs will, too; "
            f"set severity_rules: {found.rules} there to keep this",
            soft_wrap=True,
        )
