"""Commands of the intake: what became of each upload, and a pass by hand."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.options import DEFAULT_SETTINGS, OtherLakePath, OtherPortfolioPath, SettingsPath, console, read_settings_at

if TYPE_CHECKING:
    pass

intake = typer.Typer(invoke_without_command=True, rich_markup_mode="rich")


@intake.callback()
def list_uploads(
    context: typer.Context,
    settings: SettingsPath = DEFAULT_SETTINGS,
    lake: OtherLakePath = None,
    every: Annotated[bool, typer.Option("--all", help="Those that went from their source, too.")] = False,
) -> None:
    """List the uploads as of the last pass: state, since when, what is wrong with them and what to bring.

    A building of the portfolio with [bold]intake: {source: ...}[/bold] receives photographs from there: a folder, or an
    [bold]s3://bucket/prefix[/bold], with a folder for each campaign. An upload is

    - growing while it changes, or its marker is not there;
    - received once nothing has changed for the quiet time (or the marker is there): its photographs are then in the
      building's folder of photographs, as campaign 2026-04 where its folder's name says so, else by the capture dates;
    - refused where something contradicts it: dates, positions, photographs that were received before. Do what the
      message says, or answer in a file campaign.yaml (or the marker) in it: campaign: 2026-04, or accept: dates;
    - failed where it could not be read or copied; it is tried again;
    - stalled where it has not become complete for days.

    The folder stays as it is: nothing is removed from a source. More: docs/intake.md.
    """
    if context.invoked_subcommand is None:
        from cli.terminal.intake import show_uploads
        from facadelake.intake import list_uploads as read_ledger

        show_uploads(console, *read_ledger(read_settings_at(settings, None, lake)), every=every)


@intake.command()
def receive(
    settings: SettingsPath = DEFAULT_SETTINGS, portfolio: OtherPortfolioPath = None, lake: OtherLakePath = None
) -> None:
    """Make one pass now, as the service does every few minutes: observe all sources, receive what is complete.

    An upload that is seen for the first time is never received by the same pass. Running it again is safe.
    Exit status 1 where an upload is refused or failed, or a source cannot be read.
    Example: facadelake intake receive --portfolio portfolio.yaml --lake lake
    """
    from cli.terminal.intake import show_uploads
    from facadelake.intake import UploadState, receive_complete_uploads
    from facadelake.registry import read_portfolio

    service = read_settings_at(settings, portfolio, lake)
    report = receive_complete_uploads(read_portfolio(Path(service.portfolio)).buildings, service)
    show_uploads(console, report.uploads, report.problems, every=False)
    wrong = (UploadState.REFUSED, UploadState.FAILED)
    if report.problems or any(one.state in wrong and one.in_source for one in report.uploads):
        raise typer.Exit(1)
