"""Commands that read committed campaigns: listings, SQL, files, pictures. The lake is not changed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cli.options import (
    DEFAULT_LAKE,
    DEFAULT_PORTFOLIO,
    AnyPortfolioPath,
    AsOf,
    BuildingId,
    CampaignId,
    ExistingLakePath,
    PortfolioPath,
    console,
    read_portfolio_at,
    require_output_folder,
)


def campaigns(
    building: Annotated[str | None, typer.Argument(help="Only this building.")] = None,
    as_of: AsOf = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """List the registered campaigns and those in the lake, each with its version."""
    from cli.terminal.listings import show_campaigns
    from facadelake.lake import resolve_version

    show_campaigns(console, read_portfolio_at(portfolio), lake, building, resolve_version(lake, as_of))


def defects(
    building: BuildingId,
    campaign: Annotated[str | None, typer.Argument(help="Only this campaign.")] = None,
    defect_class: Annotated[str | None, typer.Option("--class", help="Only crack, spalling or moisture.")] = None,
    limit: Annotated[int, typer.Option(min=1, help="Maximum number of rows.")] = 40,
    as_of: AsOf = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """List the defects of a building: class, severity, place, size, number of photographs."""
    from cli.terminal.listings import show_defects
    from facadelake.lake import resolve_version

    show_defects(console, lake, portfolio, building, campaign, defect_class, limit, resolve_version(lake, as_of))


def tracks(
    building: BuildingId,
    state: Annotated[
        str | None, typer.Option(help="Only these states, separated by commas, such as new,grown,reopened.")
    ] = None,
    defect_class: Annotated[str | None, typer.Option("--class", help="Only crack, spalling or moisture.")] = None,
    limit: Annotated[int, typer.Option(min=1, help="Maximum number of rows.")] = 40,
    as_of: AsOf = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """List the defects of a building over all its campaigns: what became of each, its size and change, when it was
    first and last seen.

    The state is that of the building's latest campaign. 'facadelake sql track_history track_id=...' tells all of one.
    """
    from cli.terminal.tracks import show_tracks
    from facadelake.lake import resolve_version

    version = resolve_version(lake, as_of)
    show_tracks(console, lake, portfolio, building, states=state, defect_class=defect_class, limit=limit, as_of=version)


def coverage(
    building: BuildingId,
    campaign: Annotated[
        str | None, typer.Argument(help="The campaign; left out, the newest of the building in the lake.")
    ] = None,
    limit: Annotated[int, typer.Option(min=1, help="Maximum number of listed areas.")] = 20,
    least: Annotated[float, typer.Option(min=0.0, help="Smallest listed area, in square metres.")] = 0.5,
    as_of: AsOf = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """Show which parts of the facades a campaign's photographs show, how small a defect there would have been found,
    and the areas to be flown again.

    Coordinates are those of the elevations: u to the right as seen from outside, v up, from the site's origin.
    """
    from cli.terminal.coverage import show_coverage
    from facadelake.lake import resolve_version

    show_coverage(console, lake, portfolio, building, campaign, limit, least, resolve_version(lake, as_of))


def sql(
    question: Annotated[
        str | None, typer.Argument(help="A SELECT statement, or the name of a stored question (see --list).")
    ] = None,
    parameter: Annotated[
        list[str] | None, typer.Argument(help="Parameters of a stored question, as name=value.")
    ] = None,
    list_questions: Annotated[bool, typer.Option("--list", help="List the stored questions.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print rows as JSON.")] = False,
    as_of: AsOf = None,
    portfolio: AnyPortfolioPath = DEFAULT_PORTFOLIO,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """Query the lake in SQL. Queries are read-only.

    Example: facadelake sql "SELECT facade, count(*) AS n FROM defects GROUP BY facade ORDER BY n DESC"
    """
    from cli.terminal.answers import print_answer, show_questions
    from facadelake.lake import resolve_version

    if list_questions or question is None:
        show_questions(console)
        return
    print_answer(console, lake, question, parameter or [], as_of=resolve_version(lake, as_of), as_json=as_json)


def export(
    building: BuildingId,
    file: Annotated[Path, typer.Argument(help="File to write; the suffix is the format: .gpkg .parquet .geojson .csv")],
    campaign: Annotated[
        str | None, typer.Option(help="Only this campaign; not for tracks, which are of the whole history.")
    ] = None,
    table: Annotated[str, typer.Option(help="Table to export.")] = "defects",
    as_of: AsOf = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """Write a building's defects (or another table) to a file for GIS or a spreadsheet."""
    from cli.terminal.listings import read_exported, require_known
    from facadelake.lake import resolve_version
    from facadelake.publish import export_table

    require_known(lake, portfolio, building)
    version = resolve_version(lake, as_of)
    rows = read_exported(lake, table, building, campaign, version)
    export_table(table, rows, file)
    console.print(f"{len(rows)} rows of {table} written to {file}")


def view(
    building: BuildingId,
    campaign: CampaignId,
    photo: Annotated[str, typer.Argument(help="Photograph, by its photo_id or its file name.")],
    output: Annotated[
        Path | None, typer.Option(help="Picture to write (.png); default: view_<photo>.png in this folder.")
    ] = None,
    scale: Annotated[
        float | None,
        typer.Option(min=0.01, max=1.0, help="Scale of the panels to the photograph; default: 1000 pixels wide."),
    ] = None,
    as_of: AsOf = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """Draw a photograph beside the virtual view of the model, with depth and elements, to check its pose.

    The images are also written as a NumPy archive (.npz) beside the picture.
    """
    from facadelake.lake import resolve_version
    from facadelake.reporting import view_photograph

    shown = view_photograph(
        read_portfolio_at(portfolio).get_building(building),
        campaign,
        photo,
        lake=lake,
        output=output,
        scale=scale,
        as_of=resolve_version(lake, as_of),
    )
    console.print(f"{shown.photo_id} written to {shown.path}, its images to {shown.path.with_suffix('.npz')}")


def pictures(
    building: BuildingId,
    campaign: CampaignId = "latest",
    defect: Annotated[
        list[str] | None,
        typer.Option(help="Draw a card of this defect, by its id or its number on the elevations. Repeatable."),
    ] = None,
    facade: Annotated[
        list[str] | None,
        typer.Option(help="Draw the elevation of this facade, such as SE or south-east. Repeatable."),
    ] = None,
    photo: Annotated[
        list[str] | None, typer.Option(help="Draw this photograph with model edges, boxes and points. Repeatable.")
    ] = None,
    all_of_them: Annotated[bool, typer.Option("--all", help="Draw every defect, facade and photograph.")] = False,
    output: Annotated[
        Path | None, typer.Option(help="Folder to write to; default: one in the lake's 'pictures'.")
    ] = None,
    as_of: AsOf = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """Draw pictures of a committed campaign: cards of defects, elevations of facades, overlays of photographs.

    Without --defect, --facade or --photo it draws what the report shows: the worst defects, all facades, a few
    photographs, the distribution. Running it again overwrites the files.
    """
    from cli.terminal.drawing import draw_in_terminal, get_default_folder
    from facadelake.campaigns import resolve_campaign
    from facadelake.lake import resolve_version
    from facadelake.reporting import draw_pictures

    registered = read_portfolio_at(portfolio).get_building(building)
    require_output_folder(output, "--output")
    chosen, version = resolve_campaign(registered, campaign), resolve_version(lake, as_of)
    draw_in_terminal(
        console,
        lambda: draw_pictures(
            registered,
            chosen,
            lake=lake,
            folder=output or get_default_folder(lake, building, chosen, version),
            defects=tuple(defect or ()),
            facades=tuple(facade or ()),
            photos=tuple(photo or ()),
            draw_all=all_of_them,
            as_of=version,
        ),
    )
