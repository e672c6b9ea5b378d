"""Command that compares committed campaigns with truth. The lake is not changed."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.options import (
    DEFAULT_LAKE,
    DEFAULT_PORTFOLIO,
    AsOf,
    BuildingId,
    ExistingLakePath,
    PortfolioPath,
    console,
    problems,
    read_portfolio_at,
    require_output_folder,
)
from facadelake.core.errors import InputDataError

if TYPE_CHECKING:
    from facadelake.registry import Building


def evaluate(
    building: BuildingId,
    campaign: Annotated[
        str | None, typer.Argument(help="Id of the campaign, or 'latest'; left out with --history.")
    ] = None,
    *,
    truth: Annotated[
        Path,
        typer.Option(
            help="Folder with cameras.csv, checkpoints.csv and detections.csv; with --history that of all campaigns."
        ),
    ],
    history: Annotated[
        bool,
        typer.Option(
            "--history", help="Evaluate all campaigns together: identity, states and changes of the building's tracks."
        ),
    ] = False,
    detections: Annotated[
        str | None,
        typer.Option(
            help="Evaluate another detections file on the committed poses: one of the portfolio's alternatives, or a "
            "path. The lake is not changed."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON with stable keys.")] = False,
    plots: Annotated[
        Path | None,
        typer.Option(
            help="Folder for pictures: distribution, vectors, deviation, sigmas, views; with --history a sheet for "
            "each kind of wrong state, with the place before and after."
        ),
    ] = None,
    as_of: AsOf = None,
    portfolio: PortfolioPath = DEFAULT_PORTFOLIO,
    lake: ExistingLakePath = DEFAULT_LAKE,
) -> None:
    """Compare a committed campaign with truth: cameras, rays, positions, sigmas, merging, elements.

    With --history the tracks of all campaigns of the building: IDF1, states right and wrong, false repairs, changes.
    """
    registered = read_portfolio_at(portfolio).get_building(building)
    require_output_folder(plots, "--plots")
    if history:
        given = {"CAMPAIGN": campaign, "--detections": detections, "--as-of": as_of}
        _evaluate_history(registered, lake, truth, plots, given, as_json=as_json)
    elif campaign is None:
        raise InputDataError(f"name a campaign of {building}, or evaluate all of them with --history")
    else:
        _evaluate_campaign(registered, campaign, lake, truth, detections, plots, as_of, as_json=as_json)


def _evaluate_campaign(
    building: Building,
    campaign: str,
    lake: Path,
    truth: Path,
    detections: str | None,
    plots: Path | None,
    as_of: str | None,
    *,
    as_json: bool,
) -> None:
    from cli.terminal.answers import show_figures
    from facadelake.campaigns import resolve_campaign
    from facadelake.evaluation.campaigns import compare_campaign, compute_figures
    from facadelake.lake import resolve_version

    version, campaign = resolve_version(lake, as_of), resolve_campaign(building, campaign)
    compared = compare_campaign(building, campaign, lake=lake, truth=truth, detections=detections, as_of=version)
    if plots is not None:
        from facadelake.evaluation.campaigns import write_plots

        for path in write_plots(compared, plots, f"{building.id} {campaign}"):
            problems.print(f"written: {path}", soft_wrap=True, highlight=False)
    figures = compute_figures(compared)
    if as_json:
        sys.stdout.write(json.dumps(figures.convert_to_json(), indent=2) + "\n")
    else:
        show_figures(console, figures)


def _evaluate_history(
    building: Building,
    lake: Path,
    truth: Path,
    plots: Path | None,
    given: Mapping[str, str | None],
    *,
    as_json: bool,
) -> None:
    from cli.terminal.history_figures import show_history_figures
    from facadelake.evaluation.history import compare_history, compute_history_figures

    needless = [name for name, value in given.items() if value is not None]
    if needless:
        raise InputDataError(
            "--history evaluates all campaigns of the lake as it is, with their committed detections: leave out "
            f"{' and '.join(needless)}; other detections are inspected into a lake of their own"
        )
    evaluated = compare_history(building, lake=lake, truth=truth)
    if plots is not None:
        from facadelake.evaluation.history import write_confusion_sheets

        for path in write_confusion_sheets(evaluated, plots, building.id):
            problems.print(f"written: {path}", soft_wrap=True, highlight=False)
    figures = compute_history_figures(evaluated.compared)
    if as_json:
        sys.stdout.write(json.dumps(figures.convert_to_json(), indent=2) + "\n")
    else:
        show_history_figures(console, figures)
