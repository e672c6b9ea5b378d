"""Listings in the terminal: registered and committed campaigns, defects, changes of a regrading."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

from facadelake.core.errors import InputDataError, suggest_name
from facadelake.core.tables import list_rows
from facadelake.lake import answer_question, find_latest_campaign, has_lake, query, read_table
from facadelake.registry import Portfolio, read_portfolio
from facadelake.severity import describe_severity
from schemas.tables import HISTORY_TABLES
from schemas.vocabulary import CrackWidthOutcome, DefectClass

if TYPE_CHECKING:
    import pyarrow as pa

    from facadelake.lake import Regrading

_OF_WHOLE_HISTORY = frozenset(name for name, table in HISTORY_TABLES.items() if "campaign_id" not in table.key)
WIDE_COLUMNS = 120  # a narrower terminal shows no coordinates; 'facadelake sql' and 'export' have them


def show_campaigns(console: Console, portfolio: Portfolio, lake: Path, only: str | None, as_of: int | None) -> None:
    """Print one line for each campaign that is registered or in the lake at version ``as_of`` (None: the newest)."""
    if only is not None:
        portfolio.get_building(only)
    held = list_rows(answer_question(lake, "campaigns", as_of=as_of)) if has_lake(lake) else []
    at = "" if as_of is None else f" at version {as_of}"
    table = RichTable(title=f"Campaigns (lake {lake}{at})", title_justify="left")
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
            for campaign in building.list_campaigns():
                lines[building.id, campaign] = ("", "", "", "", "not yet inspected", "")
    for row in (row for row in held if only in (None, row["building_id"])):
        key = (row["building_id"], row["campaign_id"])
        counts = (row["photos_total"], row["photos_localised"], row["detections_total"], row["defects_total"])
        lines[key] = (*map(str, counts), f"{row['finished_at']:%Y-%m-%d %H:%M}", str(row["version"] or ""))
    # Those in the lake in order of time, as it lists them, then those that are not inspected yet.
    places = {(row["building_id"], row["campaign_id"]): place for place, row in enumerate(held)}
    for key in sorted(lines, key=lambda key: (key[0], places.get(key, len(places)), key[1])):
        table.add_row(*key, *lines[key])
    console.print(table)


def require_known(lake: Path, portfolio: Path, building: str) -> None:
    """Raise InputDataError for a building that is neither in the lake nor in the portfolio, listing the known ids.

    A building in the lake can be queried even if the portfolio no longer has it.
    """
    if not has_lake(lake) or not len(read_table(lake, "campaigns", building_id=building)):
        read_portfolio(portfolio).get_building(building)


def require_committed(lake: Path, building: str, campaign: str | None, as_of: int | None) -> None:
    """Raise InputDataError for a campaign that the lake at version ``as_of`` does not have, with those that it has."""
    if campaign is None or not has_lake(lake):
        return
    known = read_table(lake, "campaigns", building_id=building, as_of=as_of).column("campaign_id").to_pylist()
    if campaign not in known:
        at = "" if as_of is None else f" at version {as_of}"
        like = suggest_name(campaign, known)
        raise InputDataError(
            f"the lake {lake} has{at} no campaign '{campaign}' of building '{building}'{like}; "
            f"it has {', '.join(known) or 'none'}"
        )


def read_exported(lake: Path, name: str, building: str, campaign: str | None, as_of: int | None) -> pa.Table:
    """Rows of a table of a building to be exported.

    Args:
        lake: folder of the lake.
        name: the table.
        building: a building of the lake or of the portfolio.
        campaign: only this campaign; None: all.
        as_of: an earlier version of the lake; None: the newest.

    Returns:
        The rows, at least one.

    Raises:
        InputDataError: there are none, or a campaign is named for a table of the whole history.
    """
    require_committed(lake, building, campaign, as_of)
    if campaign is not None and name in _OF_WHOLE_HISTORY:
        raise InputDataError(
            f"table {name} is of the whole history of a building, and is filed with its latest campaign "
            f"({find_latest_campaign(lake, building, as_of=as_of)}); leave out --campaign, or export track_states, "
            f"which has what campaign '{campaign}' says of each track"
        )
    rows = read_table(lake, name, building_id=building, campaign_id=campaign, as_of=as_of)
    if len(rows):
        return rows
    held = set(read_table(lake, name, building_id=building, as_of=as_of).column("campaign_id").to_pylist())
    at = "" if as_of is None else f" at version {as_of}"
    if held:
        raise InputDataError(
            f"the lake {lake} has{at} no rows of '{name}' for building '{building}', campaign '{campaign}'; it has "
            f"some of {', '.join(sorted(held))}"
        )
    if name in HISTORY_TABLES and not len(read_table(lake, "frame_offsets", building_id=building, as_of=as_of)):
        reason = f"its campaigns were committed without a history; 'facadelake track {building}' makes it"
    else:
        reason = "'facadelake campaigns' lists what it holds"
    raise InputDataError(f"the lake {lake} has{at} no rows of '{name}' for building '{building}'; {reason}")


def _format_crack_width(row: Mapping[str, Any]) -> str:
    """The mean width of a crack, or its upper bound; empty where neither is known."""
    width, limit = row["crack_width_mm"], row["crack_width_limit_mm"]
    if width is not None:
        sigma = row["crack_width_sigma_mm"]
        return f"{width:.1f}" if sigma is None else f"{width:.1f} ± {sigma:.1f}"
    return f"< {limit:.1f}" if row["crack_width_outcome"] == CrackWidthOutcome.BELOW_LIMIT and limit is not None else ""


def show_defects(
    console: Console,
    lake: Path,
    portfolio: Path,
    building: str,
    campaign: str | None,
    defect_class: str | None,
    limit: int,
    as_of: int | None,
) -> None:
    """Print a table of defects, the largest first. Raises InputDataError where there are none."""
    if defect_class is not None and defect_class not in set(DefectClass):
        raise InputDataError(f"there is no class '{defect_class}'; allowed are {', '.join(DefectClass)}")
    if not has_lake(lake):
        require_known(lake, portfolio, building)
    rows = list_rows(read_table(lake, "defects", building_id=building, campaign_id=campaign, as_of=as_of))
    if not rows:
        require_known(lake, portfolio, building)
        require_committed(lake, building, campaign, as_of)
        raise InputDataError(
            f"the lake {lake} has no defects of building '{building}'"
            + (f", campaign '{campaign}'" if campaign else "")
            + "; 'facadelake campaigns' lists what it holds, 'facadelake inspect' adds to it"
        )
    chosen = [row for row in rows if defect_class in (None, row["defect_class"])]
    chosen.sort(key=lambda row: -max(row["width_m"], row["height_m"]))
    tracks = _read_tracks(lake, building, as_of)
    table = RichTable(title=f"{len(chosen)} defects of {building}, the largest first", title_justify="left")
    wide = console.width >= WIDE_COLUMNS
    names = ("defect", *(("track",) if tracks else ()), "class", "severity", "facade", "storey", "size cm", "photos")
    for name in names:
        table.add_column(name, justify="right" if name in ("size cm", "photos") else "left", no_wrap=True)
    if wide:
        table.add_column("crack mm", justify="right", no_wrap=True)
        table.add_column("element")
        table.add_column("lon, lat, ellipsoidal height", no_wrap=True)
    for row in chosen[:limit]:
        cells = [row["defect_id"], *((tracks.get((row["campaign_id"], row["defect_id"]), ""),) if tracks else ())]
        cells += [row["defect_class"], describe_severity(row), row["facade"], row["storey"] or ""]
        cells += [f"{row['width_m'] * 100:.0f} x {row['height_m'] * 100:.0f}", str(row["photo_count"])]
        if wide:
            cells.append(_format_crack_width(row))
            cells.append(escape(row["element_name"] or row["ifc_class"]))
            cells.append(f"{row['lon_deg']:.7f}, {row['lat_deg']:.7f}, {row['height_ellipsoidal_m']:.2f}")
        table.add_row(*cells)
    console.print(table)
    if len(chosen) > limit:
        console.print(f"{len(chosen) - limit} more; --limit {len(chosen)} shows all")


def _read_tracks(lake: Path, building: str, as_of: int | None) -> dict[tuple[str, str], str]:
    """The track of each defect, by campaign and defect; empty where the building has no history."""
    sql = "SELECT campaign_id, defect_id, track_id FROM defect_tracks WHERE building_id = $building_id"
    rows = list_rows(query(lake, sql, {"building_id": building}, as_of=as_of))
    return {(row["campaign_id"], row["defect_id"]): row["track_id"] for row in rows}


def show_regrading(console: Console, found: Regrading, releases: Sequence[Path], registered: str | None) -> None:
    """Print a line for each change of grade, the number of unchanged defects, the version and its files.

    ``registered``: the rule pack of the building in the portfolio, None where it is not registered.
    """
    if found.changes:
        table = RichTable(title=f"{found.building_id} graded by {found.rules}", title_justify="left")
        for name in ("campaign", "from", "to", "defects"):
            table.add_column(name, justify="right" if name == "defects" else "left")
        for step in found.changes:
            (grade, rule), (new_grade, _) = step.before, step.after
            table.add_row(step.campaign_id, f"{grade} ({rule})", new_grade, str(step.defects))
        console.print(table)
    else:
        console.print(f"nothing changed: every defect of {found.building_id} already has its grade by {found.rules}")
    if found.unchanged and found.changes:
        console.print(f"{found.unchanged} more already have this grade")
    if found.graded_by_person:
        console.print(f"{found.graded_by_person} were graded by a person and are kept")
    if found.version is None:
        if found.changes:
            console.print("dry run: nothing was written")
        return
    console.print(f"lake version {found.version}; earlier versions stay readable (--as-of)")
    for release in releases:
        console.print(f"files {release}", soft_wrap=True, highlight=False)
    if registered not in (None, found.rules):
        console.print(
            f"the portfolio grades {found.building_id} by {registered}, as will a new inspection of changed inputs; "
            f"set severity_rules: {found.rules} there to keep these grades",
            soft_wrap=True,
        )
