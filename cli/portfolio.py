"""Command on the whole portfolio: what waits is inspected, and what is due and overdue is told."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cli.intake import OtherLake, OtherPortfolio, SettingsFile
from cli.options import DEFAULT_LAKE, DEFAULT_PORTFOLIO, console
from cli.service.commands import DEFAULT_SETTINGS


def inspect_portfolio(
    settings: SettingsFile = DEFAULT_SETTINGS,
    portfolio: OtherPortfolio = None,
    lake: OtherLake = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show what would be inspected, what not, and why; run nothing.")
    ] = False,
) -> None:
    """Inspect all campaigns that wait, side by side, and tell which inspections are due and overdue.

    A campaign waits when its photographs are complete and not in the lake as they are. A failure stops no other
    campaign. The report is in the lake's 'portfolio'. Exit status 1 where a campaign failed. More: docs/portfolio.md.
    """
    from cli.terminal.portfolio import inspect_portfolio_in_terminal, show_plan
    from facadelake.registry import read_service_settings

    if settings.exists():
        service = read_service_settings(settings)
        portfolio, lake = portfolio or Path(service.portfolio), lake or Path(service.lake)
    file = settings.resolve() if settings.exists() else None
    portfolio, lake = portfolio or DEFAULT_PORTFOLIO, lake or DEFAULT_LAKE
    if dry_run:
        from facadelake.core.code_version import compute_code_version
        from facadelake.scheduling import plan_work, prepare_work

        code = compute_code_version("flows.inspect_building").sha256
        work = prepare_work(str(portfolio), str(lake), str(file) if file else None, code_sha256=code)
        show_plan(console, plan_work(work), work.limits)
    else:
        inspect_portfolio_in_terminal(console, portfolio=portfolio, lake=lake, settings=file)
