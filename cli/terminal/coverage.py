"""Coverage in the terminal: totals by facade and storey, and the areas that no photograph shows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

from cli.terminal.listings import require_committed, require_known
from facadelake.building.surface import Surface
from facadelake.campaigns import read_committed_model
from facadelake.core.errors import FacadelakeError, InputDataError
from facadelake.core.tables import Row, list_rows
from facadelake.coverage import (
    ALL_STOREYS,
    OBSTACLES,
    CoverageTotal,
    ReflightList,
    describe_contradictions,
    list_reflights,
    summarise_coverage,
)
from facadelake.lake import find_latest_campaign, read_tables
from facadelake.registry import read_portfolio
from schemas.vocabulary import SurfaceKind


def show_coverage(
    console: Console,
    lake: Path,
    portfolio: Path,
    building: str,
    campaign: str | None,
    limit: int,
    least_m2: float,
    as_of: int | None,
) -> None:
    """Print the totals of a committed campaign and its re-flight list.

    Args:
        console: where to print.
        lake: folder of the lake.
        portfolio: path of the portfolio.
        building: the building.
        campaign: the campaign; None: the newest of the building in the lake.
        limit: largest number of areas that are listed.
        least_m2: smallest area that is listed, square metres.
        as_of: an earlier version of the lake; None: the newest.

    Raises:
        InputDataError: the building or campaign is unknown, or the campaign has no coverage.
    """
    require_known(lake, portfolio, building)
    require_committed(lake, building, campaign, as_of)
    chosen = campaign or find_latest_campaign(lake, building, as_of=as_of)
    tables = read_tables(
        lake, ["coverage", "buildings", "defects"], building_id=building, campaign_id=chosen, as_of=as_of
    )
    if not len(tables["coverage"]):
        raise InputDataError(
            f"campaign '{chosen}' of building '{building}' has no coverage: it was committed before coverage was "
            "measured, or its building has no facades; 'facadelake inspect' measures it, finished stages are kept"
        )
    totals = summarise_coverage(tables["coverage"])
    console.print(_build_totals(f"Coverage of {building} {chosen}", totals))
    for line in _explain_totals(totals):
        console.print(line)
    if SurfaceKind.AS_BUILT in tables["buildings"].column("surface_kind").to_pylist():
        console.print("The surface is the campaign's own: what no photograph shows is not in it, and is not counted.")
    contradictions = describe_contradictions(tables["coverage"], tables["defects"])
    if contradictions:
        console.print(f"[yellow]{escape(contradictions)}[/yellow]")
    surface = _read_surface(portfolio, building, chosen, list_rows(tables["buildings"])[0])
    reflights = list_reflights(tables["coverage"], surface, least_m2=least_m2)
    if reflights.areas:
        console.print(_build_areas(reflights, limit))
    console.print(reflights.describe())


def describe_totals(coverage: pa.Table) -> str:
    """The totals of table ``coverage`` of one campaign in a line."""
    whole = [total for total in summarise_coverage(coverage) if total.storey == ALL_STOREYS]
    surface = sum(total.surface_m2 for total in whole)
    if not surface:
        return "the building has no facades"
    imaged, searched = sum(total.imaged_m2 for total in whole), sum(total.searched_m2 for total in whole)
    found = [total.found_crack_width_mm for total in whole if total.searched_m2]
    worst = "unknown" if not found or None in found else f"{max(width for width in found if width):.1f} mm"
    return (
        f"{100 * imaged / surface:.1f} % of {surface:.0f} m² of facades imaged, {100 * searched / surface:.1f} % "
        f"searched; smallest crack found: {worst}; see facadelake coverage"
    )


def _build_totals(title: str, totals: Sequence[CoverageTotal]) -> RichTable:
    table = RichTable(title=title, title_justify="left")
    table.add_column("facade")
    table.add_column("storey")
    for name in ("surface m²", "imaged", "searched", "GSD mm", "cracks from mm", "patches from mm"):
        table.add_column(name, justify="right")
    table.add_column("not imaged, m²")
    for total in totals:
        whole = total.storey == ALL_STOREYS
        table.add_row(
            f"[bold]{escape(total.facade)}[/bold]" if whole else "",
            "" if whole else escape(total.storey),
            f"{total.surface_m2:.1f}",
            f"{100 * total.imaged_share:.1f} %",
            f"{100 * total.searched_m2 / total.surface_m2:.1f} %",
            _format(total.gsd_mm, 1),
            _format(total.found_crack_width_mm, 1),
            _format(total.found_patch_mm, 0),
            ", ".join(f"{area:.1f} {OBSTACLES[word]}" for word, area in total.prevented_m2.items() if area >= 0.05),
        )
    return table


def _format(value: float | None, digits: int) -> str:
    return "unknown" if value is None else f"{value:.{digits}f}"


def _explain_totals(totals: Sequence[CoverageTotal]) -> list[str]:
    lines = [
        "Cracks and patches: the smallest that the detector finds with 90 % probability on 90 % of what it searched."
    ]
    if all(total.found_crack_width_mm is None and total.found_patch_mm is None for total in totals):
        lines.append(
            "Unknown where the detector's card, or the portfolio for imported boxes, declares no recall by size that "
            "reaches 90 % (key recall_by_size; docs/coverage.md)."
        )
    if any(total.searched_m2 < total.imaged_m2 - 0.05 for total in totals):
        lines.append(
            "Searched is less than imaged: the detector did not process, or the imported file does not list, all."
        )
    return lines


def _read_surface(portfolio: Path, building: str, campaign: str, committed: Row) -> Surface | None:
    """The surface of the portfolio's model; None where there is none, or another than the campaign's."""
    try:
        model = read_committed_model(read_portfolio(portfolio).get_building(building), campaign, committed)
    except FacadelakeError:
        return None
    return Surface(model) if model.has_surface else None


def _build_areas(reflights: ReflightList, limit: int) -> RichTable:
    areas = reflights.areas
    rest = areas[limit:]
    caption = f"{len(areas)} area{'' if len(areas) == 1 else 's'}, {sum(area.area_m2 for area in areas):.1f} m²"
    if rest:
        caption += f"; the smallest {len(rest)} of them, {sum(area.area_m2 for area in rest):.1f} m², are not listed"
    table = RichTable(
        title="Not imaged, to be flown again", title_justify="left", caption=caption, caption_justify="left"
    )
    for name in ("facade", "storey"):
        table.add_column(name)
    for name in ("u m", "v m", "m²"):
        table.add_column(name, justify="right")
    table.add_column("why")
    for area in areas[:limit]:
        table.add_row(
            escape(area.facade),
            escape(", ".join(area.storeys)),
            f"{area.u_min_m:.2f} to {area.u_max_m:.2f}",
            f"{area.v_min_m:.2f} to {area.v_max_m:.2f}",
            f"{area.area_m2:.2f}",
            OBSTACLES[area.outcome],
        )
    return table
