"""The command line: ``facadelake``. Heavy libraries are imported by the command that needs them."""

from __future__ import annotations

import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from facadelake.errors import FacadelakeError, InputDataError

if TYPE_CHECKING:
    from facadelake.registry import Portfolio

ROOT = Path(__file__).resolve().parent.parent
# Where the output goes to a file or a pipe there is no width to keep to.
console = Console(width=None if sys.stdout.isatty() else 160)
problems = Console(stderr=True)

app = typer.Typer(
    name="facadelake",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="Photographs of a building in, versioned tables of its facade defects out.\n\n"
    "Begin with [bold]facadelake demo[/bold], which makes a building, two campaigns of photographs, and inspects both. "
    "Then look with [bold]facadelake defects demo[/bold] or ask with [bold]facadelake sql[/bold].",
)

PortfolioPath = Annotated[
    Path,
    typer.Option("--portfolio", envvar="FACADELAKE_PORTFOLIO", help="Registry: a YAML file, or a folder of them."),
]
LakePath = Annotated[
    Path, typer.Option("--lake", envvar="FACADELAKE_LAKE", help="Folder of the lake; made if it is not there.")
]
AnyPortfolioPath = Annotated[
    Path, typer.Option("--portfolio", help="Taken as by every command; a question to the lake needs no registry.")
]
BuildingId = Annotated[str, typer.Argument(help="Id of the building in the registry.")]
CampaignId = Annotated[str, typer.Argument(help="Id of the campaign, such as 2026-04; 'latest' for the newest.")]
DEFAULT_PORTFOLIO = ROOT / "data" / "portfolio.yaml"
DEFAULT_LAKE = ROOT / "lake"
DEMO_RECIPE = ROOT / "data" / "demo" / "recipe.yaml"


class Georeference(StrEnum):
    """What places the campaign on the globe."""

    AUTO = "auto"
    GCP = "gcp"
    CAMPAIGN = "campaign"
    MODEL = "model"
    GPS = "gps"


def _portfolio(path: Path) -> Portfolio:
    from facadelake.registry import read_portfolio

    return read_portfolio(path)


@app.command()
def inspect(
    building: BuildingId,
    campaign: CampaignId = "latest",
    georeference: Annotated[
        Georeference,
        typer.Option(
            help="Control: control points (gcp), the frame of an earlier campaign (campaign), the building model's "
            "faces and edges (model), GPS tags alone (gps: metres, and said so). auto takes the best there is: an "
            "earlier campaign that is placed to centimetres, control points, the model, GPS; a campaign that cannot "
            "be placed well enough is refused with what to bring."
        ),
    ] = Georeference.AUTO,
    detections: Annotated[
        str | None,
        typer.Option(help="Instead of the registry's detections: the name of one of its alternatives, or a COCO file."),
    ] = None,
    poses: Annotated[
        Path | None,
        typer.Option(
            help="Instead of finding them: camera poses of another program, a poses.csv or a folder with COLMAP's text "
            "files (docs/poses-csv.md)."
        ),
    ] = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """Inspect one campaign of a building, from photographs to tables, pictures and GIS files.

    Running it again is safe: finished stages come from the cache, unchanged inputs make no second copy. After Ctrl-C
    run it again; it goes on after the last finished stage.
    """
    from flows.precheck import check_files, chosen_poses, resolved_campaign
    from flows.terminal.inspection import show_inspection
    from flows.terminal.run import inspect_in_terminal

    registered = _portfolio(portfolio).building(building)
    resolved = resolved_campaign(registered, campaign)
    check_files(registered, resolved, detections)  # before Prefect takes its time
    chosen_poses(registered, resolved, georeference, str(poses) if poses else None)
    result = inspect_in_terminal(
        console,
        building_id=building,
        campaign_id=campaign,
        portfolio=portfolio,
        lake=lake,
        georeference=georeference,
        detections=detections,
        poses=str(poses.resolve()) if poses else None,
    )
    show_inspection(console, lake, result)


@app.command()
def demo(
    folder: Annotated[Path, typer.Option(help="Where the demo building is made.")] = ROOT / "build" / "demo",
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """Make the demo building with two campaigns of photographs, inspect both, and say where to look."""
    from flows.terminal.inspection import show_inspection, show_where_to_look
    from flows.terminal.run import make_demo_in_terminal

    results = make_demo_in_terminal(console, folder=folder, lake=lake, recipe=DEMO_RECIPE, portfolio=portfolio)
    for result in results:
        show_inspection(console, lake, result)
    show_where_to_look(console, lake, results)


@app.command()
def campaigns(
    building: Annotated[str | None, typer.Argument(help="Only this building.")] = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """List what is registered and what the lake holds, with each campaign's version."""
    from flows.terminal.listings import show_campaigns

    show_campaigns(console, _portfolio(portfolio), lake, building)


@app.command()
def defects(
    building: BuildingId,
    campaign: Annotated[str | None, typer.Argument(help="Only this campaign.")] = None,
    defect_class: Annotated[str | None, typer.Option("--class", help="Only crack, spalling or moisture.")] = None,
    limit: Annotated[int, typer.Option(min=1, help="At most so many rows.")] = 40,
    as_of: Annotated[int | None, typer.Option(help="As the lake was at this version.")] = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """Show the defects of a building: what, where, how large, how often seen."""
    from flows.terminal.listings import require_known, show_defects

    require_known(lake, portfolio, building)
    show_defects(console, lake, building, campaign, defect_class, limit, as_of)


@app.command()
def sql(
    question: Annotated[
        str | None, typer.Argument(help="A SELECT statement, or the name of a stored question (see --list).")
    ] = None,
    parameter: Annotated[
        list[str] | None, typer.Argument(help="Parameters of a stored question, as name=value.")
    ] = None,
    list_questions: Annotated[bool, typer.Option("--list", help="List the stored questions.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print rows as JSON.")] = False,
    as_of: Annotated[int | None, typer.Option(help="As the lake was at this version.")] = None,
    portfolio: AnyPortfolioPath = DEFAULT_PORTFOLIO,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """Ask the lake in SQL; nothing can be changed that way.

    Example: facadelake sql "SELECT facade, count(*) AS n FROM defects GROUP BY facade ORDER BY n DESC"
    """
    from flows.terminal.answers import ask, show_questions

    if list_questions or question is None:
        show_questions(console)
        return
    ask(console, lake, question, parameter or [], as_of=as_of, as_json=as_json)


@app.command()
def export(
    building: BuildingId,
    file: Annotated[Path, typer.Argument(help="File to write; its suffix chooses: .gpkg .parquet .geojson .csv")],
    campaign: Annotated[str | None, typer.Option(help="Only this campaign.")] = None,
    table: Annotated[str, typer.Option(help="Which table.")] = "defects",
    as_of: Annotated[int | None, typer.Option(help="As the lake was at this version.")] = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """Write a building's defects (or another table) to a file for GIS or a spreadsheet."""
    from facadelake.lake.read import read_table
    from facadelake.publish.releases import export as export_table
    from flows.terminal.listings import require_known

    require_known(lake, portfolio, building)
    rows = read_table(lake, table, building_id=building, campaign_id=campaign, as_of=as_of)
    if not len(rows):
        raise InputDataError(
            f"the lake {lake} has no rows of '{table}' for building '{building}'"
            + (f", campaign '{campaign}'" if campaign else "")
            + "; 'facadelake campaigns' lists what it holds"
        )
    export_table(table, rows, file)
    console.print(f"{len(rows)} rows of {table} written to {file}")


@app.command()
def regrade(
    building: BuildingId,
    campaign: Annotated[str | None, typer.Argument(help="Only this campaign; left out, all of the building's.")] = None,
    *,
    rules: Annotated[str, typer.Option(help="The rule pack, such as nyc_fisp_v1 (docs/severity.md lists them).")],
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what would change, and write nothing.")] = False,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """Grade the defects of committed campaigns by another rule pack, as a new version, and publish it.

    Grades of persons stay. Running it again changes nothing. A new inspection grades by the registry's rule pack.
    """
    from flows.regrading import preview_grades, registered_rules, regrade_campaigns
    from flows.terminal.grades import show_regrading

    registered = registered_rules(portfolio, building)
    if dry_run:
        show_regrading(console, preview_grades(lake, building, campaign, rules), [], registered)
    else:
        show_regrading(console, *regrade_campaigns(lake, building, campaign, rules), registered)


@app.command()
def view(
    building: BuildingId,
    campaign: CampaignId,
    photo: Annotated[str, typer.Argument(help="Which photograph: its id, or its file's name.")],
    output: Annotated[
        Path | None, typer.Option(help="Picture to write (.png); view_<photo>.png here if left out.")
    ] = None,
    scale: Annotated[
        float | None,
        typer.Option(min=0.01, max=1.0, help="Size of the panels to the photograph's; 1000 pixels wide if left out."),
    ] = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """Show a photograph beside the virtual view of the model, with depth and elements: is the pose right?

    The images are written beside the picture as a NumPy archive, .npz.
    """
    from flows.photo_view import view_photograph

    shown = view_photograph(
        _portfolio(portfolio).building(building), campaign, photo, lake=lake, output=output, scale=scale
    )
    console.print(f"{shown.photo_id} drawn to {shown.path}, its images to {shown.path.with_suffix('.npz')}")


@app.command()
def pictures(
    building: BuildingId,
    campaign: CampaignId = "latest",
    defect: Annotated[
        list[str] | None,
        typer.Option(help="A card of this defect: its id, or the number on the elevations. Repeatable."),
    ] = None,
    facade: Annotated[
        list[str] | None, typer.Option(help="The elevation of this facade, such as south or SE. Repeatable.")
    ] = None,
    photo: Annotated[
        list[str] | None, typer.Option(help="This photograph with model edges, boxes and points. Repeatable.")
    ] = None,
    all_of_them: Annotated[bool, typer.Option("--all", help="Every defect, facade and photograph.")] = False,
    output: Annotated[
        Path | None, typer.Option(help="Folder to write to; without it, one below the lake's 'pictures'.")
    ] = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """Draw pictures of a committed campaign: cards of defects, elevations of facades, overlays of photographs.

    Without a name it draws what the report shows: the worst defects, all facades, a few photographs, the distribution.
    Running it again is safe: files are written over.
    """
    from flows.pictures import draw_pictures
    from flows.precheck import resolved_campaign
    from flows.terminal.drawing import default_folder, draw_in_terminal

    registered = _portfolio(portfolio).building(building)
    chosen = resolved_campaign(registered, campaign)
    draw_in_terminal(
        console,
        lambda: draw_pictures(
            registered,
            chosen,
            lake=lake,
            folder=output or default_folder(lake, building, chosen),
            defects=tuple(defect or ()),
            facades=tuple(facade or ()),
            photos=tuple(photo or ()),
            all_of_them=all_of_them,
        ),
    )


@app.command()
def evaluate(
    building: BuildingId,
    campaign: CampaignId,
    truth: Annotated[Path, typer.Option(help="Folder with cameras.csv, checkpoints.csv and detections.csv.")],
    detections: Annotated[
        str | None,
        typer.Option(
            help="Judge another detections file (a name of the registry's alternatives, or a path) on the committed "
            "poses; the lake is not changed."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON, with stable keys.")] = False,
    plots: Annotated[
        Path | None, typer.Option(help="Folder for pictures: distribution, vectors, deviation, sigmas, views.")
    ] = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """Compare a committed campaign with truth: cameras, rays, positions, sigmas, merging, elements."""
    from facadelake.evaluate.evaluation import figures_of
    from flows.evaluation import compare_campaign
    from flows.terminal.answers import show_figures

    compared = compare_campaign(
        _portfolio(portfolio).building(building), campaign, lake=lake, truth=truth, detections=detections
    )
    if plots is not None:
        from facadelake.evaluate.plots import write_plots

        for path in write_plots(compared, plots, f"{building} {campaign}"):
            problems.print(f"written: {path}", soft_wrap=True, highlight=False)
    figures = figures_of(compared)
    if as_json:
        sys.stdout.write(json.dumps(figures.to_json(), indent=2) + "\n")
    else:
        show_figures(console, figures)


@app.command()
def doctor(portfolio: PortfolioPath = DEFAULT_PORTFOLIO, lake: LakePath = DEFAULT_LAKE) -> None:
    """Check this machine: libraries, rendering, extensions, disk, models; says what is missing and how to get it."""
    from facadelake.doctor import Status, run_checks
    from facadelake.registry import OnnxDetectorSetting
    from flows.terminal.answers import show_checks

    detectors = [building.detector for building in _portfolio(portfolio).buildings]
    checks = run_checks(lake, [Path(d.model) for d in detectors if isinstance(d, OnnxDetectorSetting)])
    show_checks(console, checks)
    if any(check.status is Status.MISSING for check in checks):
        raise typer.Exit(1)


@app.command()
def serve_prefect(
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port of Prefect's page on this machine.")] = 4200,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """Run Prefect's server and the registry's schedules until Ctrl-C; the page shows runs, tables and pictures."""
    from flows.serve import serve_schedules

    serve_schedules(console, _portfolio(portfolio), portfolio=portfolio, lake=lake, port=port)


def main() -> None:
    """Entry point: errors as messages, never as tracebacks of ours."""
    try:
        app()
    except FacadelakeError as error:
        problems.print(f"[bold red]{type(error).__name__}[/bold red]: ", end="")
        problems.print(str(error), markup=False, highlight=False, soft_wrap=True)
        sys.exit(1)
