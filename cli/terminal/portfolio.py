"""The portfolio in the terminal: the plan of an inspection, its progress, its report."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.console import Console
from rich.markdown import Markdown
from rich.markup import escape
from rich.table import Table as RichTable

from facadelake.scheduling import (
    PORTFOLIO_FOLDER,
    InspectionLimits,
    PortfolioPlan,
    PortfolioReport,
    describe_overdue,
    format_report,
)

if TYPE_CHECKING:
    pass


def show_plan(console: Console, plan: PortfolioPlan, limits: InspectionLimits) -> None:
    """Print what would be inspected in which order, what is left out and why, and the dates of each building."""
    title = f"Waiting (at most {limits.side_by_side} at once, {limits.memory_mib / 1024:.1f} GiB together)"
    waiting = _make_table(title, "building", "campaign", "why", "priority", "photographs", "taken", "memory")
    for one in plan.waiting:
        waiting.add_row(
            one.building_id,
            one.campaign_id,
            one.reason + (" (overdue by law)" if one.legal_overdue else ""),
            one.priority,
            f"{one.photographs}",
            f"{one.captured_from:%Y-%m-%d}" if one.captured_from else "unknown",
            f"{one.need.mib / 1024:.1f} GiB, {one.need.basis}",
        )
    left_out = _make_table("Left out", "building", "campaign", "why")
    for out in plan.left_out:
        left_out.add_row(out.building_id, out.campaign_id, escape(out.reason))
    dates = _make_table("Dates", "building", "last inspection", "next date", "last day by law", "overdue")
    for date in plan.dates:
        dates.add_row(
            date.building_id,
            f"{date.last_inspected_at:%Y-%m-%d}" if date.last_inspected_at else "never",
            f"{date.next_date:%Y-%m-%d}" if date.next_date else "no schedule",
            f"{date.legal_deadline or ''}",
            describe_overdue(date),
        )
    for table, empty in ((waiting, "Nothing waits."), (left_out, ""), (dates, "")):
        if table.row_count:
            console.print(table)
        elif empty:
            console.print(empty)
    for remark in plan.remarks:
        console.print(remark, highlight=False, markup=False)
    for date in plan.dates:
        for remark in date.remarks:
            console.print(f"{date.building_id}: {remark}", highlight=False, markup=False)


def _make_table(title: str, *columns: str) -> RichTable:
    table = RichTable(title=title, title_justify="left")
    for column in columns:
        table.add_column(column, overflow="fold")
    return table


def inspect_portfolio_in_terminal(console: Console, *, portfolio: Path, lake: Path, settings: Path | None) -> None:
    """Run the flow ``inspect_portfolio`` and print its report; exit status 1 where a campaign failed.

    Where it is stopped, the report says what was done and what was not.
    """
    from cli.terminal.run import run_flow

    reported = lake.resolve() / PORTFOLIO_FOLDER / "latest.md"
    before = reported.resolve()

    def load() -> Callable[..., PortfolioReport]:
        from flows.inspect_portfolio import inspect_portfolio

        return inspect_portfolio

    try:
        report = run_flow(console, load, portfolio=portfolio, lake=lake, settings=str(settings) if settings else None)
    except SystemExit:
        if reported.resolve() != before:
            _show_markdown(console, reported.read_text(encoding="utf-8"))
        raise
    except Exception as error:
        report_of_failed = _get_report(error)
        if report_of_failed is None:
            raise
        _show_markdown(console, format_report(report_of_failed))
        console.print(f"Report: {reported.resolve()}", highlight=False)
        raise typer.Exit(1) from None
    _show_markdown(console, format_report(report))
    console.print(f"Report: {reported.resolve()}", highlight=False)


def _get_report(error: Exception) -> PortfolioReport | None:
    from flows.inspect_portfolio import PortfolioError

    return error.report if isinstance(error, PortfolioError) else None


def _show_markdown(console: Console, text: str) -> None:
    console.print(Markdown(text) if console.is_terminal else text, markup=False)
