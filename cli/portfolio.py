"""Command on the whole portfolio: what waits is inspected, and what is due and overdue is told."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cli.options import DEFAULT_SETTINGS, OtherLakePath, OtherPortfolioPath, SettingsPath, console, read_settings_at


def inspect_portfolio(
    settings: SettingsPath = DEFAULT_SETTINGS,
    portfolio: OtherPortfolioPath = None,
    lake: OtherLakePath = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show what would be inspected, what not, and why; run nothing.")
    ] = False,
) -> None:
    """Inspect all campaigns that wait, side by side, and tell which inspections are due and overdue.

    A campaign waits when its photographs are complete and not in the lake as they are. A failure stops no other
    campaign. The report is in the lake's 'portfolio'. Exit status 1 where a campaign failed. More: docs/portfolio.md.
    """
    from cli.terminal.portfolio import inspect_portfolio_in_terminal, show_plan

    service = read_settings_at(settings, portfolio, lake)
    file = settings.resolve() if settings.exists() else None
    if dry_run:
        from facadelake.core.code_version import compute_code_version
        from facadelake.scheduling import plan_work, prepare_work

        code = compute_code_version("flows.inspect_building").sha256
        work = prepare_work(service.portfolio, service.lake, str(file) if file else None, code_sha256=code)
        show_plan(console, plan_work(work), work.limits)
    else:
        inspect_portfolio_in_terminal(
            console, portfolio=Path(service.portfolio), lake=Path(service.lake), settings=file
        )
