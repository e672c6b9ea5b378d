"""The command line ``facadelake``: its commands in groups, errors as messages."""

from __future__ import annotations

import errno
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from cli import cache, detectors, evaluation, history, intake, portfolio, results, reviews
from cli.options import (
    DEFAULT_LAKE,
    DEFAULT_PORTFOLIO,
    BuildingId,
    CampaignId,
    ExistingLakePath,
    LakePath,
    PortfolioPath,
    console,
    problems,
    read_portfolio_at,
)
from cli.service import commands
from facadelake.core.checkout import CHECKOUT
from facadelake.core.errors import FacadelakeError

DEMO_RECIPE = CHECKOUT / "data" / "demo" / "recipe.yaml"

app = typer.Typer(
    name="facadelake",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="Photographs of a building in, versioned tables of its facade defects out.\n\n"
    "Begin with [bold]facadelake demo[/bold], which makes a building with four campaigns and inspects them. "
    "Then list defects with [bold]facadelake defects demo[/bold] or query with [bold]facadelake sql[/bold].",
)


def _print_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        sys.stdout.write(f"facadelake {version('facadelake')}\n")
        raise typer.Exit


@app.callback()
def take_options(
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Options before the command; the help text is that of the app."""


class ControlOption(StrEnum):
    """The control that georeferences a campaign."""

    AUTO = "auto"
    GCP = "gcp"
    CAMPAIGN = "campaign"
    MODEL = "model"
    GPS = "gps"


@app.command()
def inspect(
    building: BuildingId,
    campaign: CampaignId = "latest",
    georeference: Annotated[
        ControlOption,
        typer.Option(
            help="Control: control points (gcp), the frame of an earlier campaign (campaign), faces and edges of the "
            "building model (model), GPS tags alone (gps: accurate to metres). auto selects the best available: an "
            "earlier campaign placed to centimetres, control points, the model, GPS. A campaign that cannot be placed "
            "accurately enough is refused; the message says what to supply."
        ),
    ] = ControlOption.AUTO,
    detections: Annotated[
        str | None,
        typer.Option(help="Other detections than the portfolio's: one of its alternatives by name, or a COCO file."),
    ] = None,
    poses: Annotated[
        Path | None,
        typer.Option(
            help="Import camera poses of another program instead of computing them: a poses.csv, or a folder with "
            "COLMAP's text files (docs/poses-csv.md)."
        ),
    ] = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """Inspect one campaign of a building, from photographs to tables, pictures and GIS files.

    Running it again is safe: finished stages are taken from the cache, and unchanged inputs make no new version. After
    Ctrl-C run it again; it continues after the last finished stage.
    """
    from cli.terminal.inspection import show_inspection
    from cli.terminal.run import inspect_in_terminal
    from facadelake.campaigns import plan_inspection

    plan_inspection(  # before Prefect takes its time
        read_portfolio_at(portfolio).get_building(building),
        campaign,
        georeference=georeference,
        detections=detections,
        poses=str(poses) if poses else None,
    )
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


app.command()(portfolio.inspect_portfolio)


@app.command()
def track(building: BuildingId, portfolio: PortfolioPath = DEFAULT_PORTFOLIO, lake: LakePath = DEFAULT_LAKE) -> None:
    """Follow a building's defects through all its campaigns in the lake anew: after reviews, or in an older lake.

    An inspection does this, too. Ids of known tracks stay. Running it again changes nothing.
    """
    from cli.terminal.inspection import show_tracking
    from cli.terminal.run import track_in_terminal

    read_portfolio_at(portfolio).get_building(building)  # before Prefect takes its time
    result = track_in_terminal(console, building_id=building, portfolio=portfolio, lake=lake)
    show_tracking(console, result)


@app.command()
def demo(
    folder: Annotated[Path, typer.Option(help="Where the demo building is made.")] = CHECKOUT / "build" / "demo",
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: LakePath = DEFAULT_LAKE,
) -> None:
    """Generate the demo building with four campaigns of photographs, inspect them in order, and list the results."""
    from cli.terminal.inspection import show_inspection, show_next_steps
    from cli.terminal.run import make_demo_in_terminal

    results = make_demo_in_terminal(console, folder=folder, lake=lake, recipe=DEMO_RECIPE, portfolio=portfolio)
    for result in results:
        show_inspection(console, lake, result)
    show_next_steps(console, lake, results)


app.command()(results.campaigns)
app.command()(results.defects)
app.command()(results.tracks)
app.command()(results.coverage)
app.command()(results.sql)
app.command()(results.export)


@app.command()
def regrade(
    building: BuildingId,
    campaign: Annotated[str | None, typer.Argument(help="Only this campaign; left out, all of the building's.")] = None,
    *,
    rules: Annotated[str, typer.Option(help="The rule pack, such as nyc_fisp_v1 (docs/severity.md lists them).")],
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what would change, and write nothing.")] = False,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """Grade the defects of committed campaigns by another rule pack; this makes a new version and publishes it.

    Grades given by a person are kept. Running it again changes nothing. A new inspection grades by the rule pack of the
    portfolio.
    """
    from cli.terminal.listings import show_regrading
    from facadelake.campaigns import find_registered_rules, preview_grades, regrade_campaigns

    registered = find_registered_rules(portfolio, building)
    if dry_run:
        show_regrading(console, preview_grades(lake, building, campaign, rules), [], registered)
    else:
        show_regrading(console, *regrade_campaigns(lake, building, campaign, rules), registered)


app.command()(results.view)
app.command()(results.pictures)
app.command()(history.compare)
app.command()(history.why)
app.command()(evaluation.evaluate)
app.command()(detectors.evaluate_detector)
app.command()(detectors.describe_detector)
app.add_typer(reviews.review, name="review")
app.add_typer(cache.cache, name="cache")
app.add_typer(intake.intake, name="intake")
app.command()(reviews.training_set)
app.command()(reviews.compare_models)
app.command()(reviews.promote_model)


@app.command()
def doctor(portfolio: PortfolioPath = DEFAULT_PORTFOLIO, lake: ExistingLakePath = DEFAULT_LAKE) -> None:
    """Check this machine: libraries, rendering, disk, models, grids. Lists what is missing, and how to get it."""
    from cli.terminal.answers import show_checks
    from facadelake.doctor import Status, run_checks
    from facadelake.registry import DEFAULT_MODEL, OnnxDetectorSetting

    buildings = read_portfolio_at(portfolio).buildings
    settings = [building.detector for building in buildings]
    models = {d.model for d in settings if isinstance(d, OnnxDetectorSetting)} - {DEFAULT_MODEL}
    checks = run_checks(lake, [Path(model) for model in sorted(models)], buildings)
    show_checks(console, checks)
    if any(check.status is Status.MISSING for check in checks):
        raise typer.Exit(1)


for command in (commands.up, commands.down, commands.status, commands.deploy, commands.systemd_unit):
    app.command()(command)


# Caused by the path or the disk that the user named; any other OSError is a bug and shows its traceback.
_NOT_WRITABLE = {
    errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.ENOTDIR, errno.EISDIR, errno.EEXIST
}  # fmt: skip


def main() -> None:
    """Run the command line; an expected error is printed as a message, with exit status 1."""
    try:
        app()
    except FacadelakeError as error:
        problems.print(f"[bold red]{type(error).__name__}[/bold red]: ", end="")
        problems.print(str(error), markup=False, highlight=False, soft_wrap=True)
        sys.exit(1)
    except OSError as error:
        if error.errno not in _NOT_WRITABLE:
            raise
        problems.print("[bold red]the disk[/bold red]: ", end="")
        message = f"{error.strerror}: {error.filename or 'a file being written'}; choose another folder or free space"
        problems.print(message, markup=False, highlight=False, soft_wrap=True)
        sys.exit(1)
