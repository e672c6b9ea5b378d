"""Tasks: what an inspected campaign found; the report of the portfolio as files, as artifacts and as messages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from inspect import isawaitable
from pathlib import Path

from prefect import task
from prefect.artifacts import create_markdown_artifact, create_table_artifact
from prefect.blocks.abstract import NotificationBlock
from prefect.blocks.core import Block
from prefect.blocks.notifications import AppriseNotificationBlock
from prefect.utilities.asyncutils import run_coro_as_sync
from pydantic import SecretStr

from facadelake.lake import answer_question
from facadelake.registry import NotifySetting
from facadelake.scheduling import (
    CampaignOutcome,
    PortfolioReport,
    find_news,
    format_address,
    format_report,
    summarise_report,
    write_report,
)
from schemas.vocabulary import TrackState

_DATES_SHOWN = ("building_id", "last_inspected_at", "next_date", "overdue_since", "legal_deadline", "legal_overdue")


def read_found(lake: Path, outcome: CampaignOutcome) -> CampaignOutcome:
    """The outcome with what the lake says was found; of one that is not in the lake, as it is."""
    if not outcome.is_done:
        return outcome
    parameters = {"building_id": outcome.building_id, "campaign_id": outcome.campaign_id}
    (row,) = answer_question(lake, "campaign_outcome", parameters).to_pylist()
    return replace(
        outcome,
        defects=row["defects_total"],
        states={state.value: row[state.value] for state in TrackState if row.get(state.value)},
        worst_severity=row["worst_severity"] or "",
        worst_defects=row["worst_defects"],
    )


@task(name="report-portfolio")
def report_portfolio(report: PortfolioReport, lake: Path) -> Path:
    """Write the report beside the lake, and as artifacts of the run: the page, and a table of the dates."""
    path = write_report(report, lake)
    create_markdown_artifact(
        key="portfolio-report", markdown=format_report(report), description=f"Inspection of the portfolio: {path}"
    )
    rows = [{name: str(getattr(one, name) or "") for name in _DATES_SHOWN} for one in report.dates]
    create_table_artifact(key="portfolio-dates", table=rows, description="Last, next and overdue inspections")
    return path


@task(name="notify")
def notify(report: PortfolioReport, setting: NotifySetting, told_overdue: Sequence[str]) -> tuple[str, ...]:
    """Send what there is to tell to each address; what could not be sent, with the reason.

    Args:
        report: the report.
        setting: addresses, and what they are told of.
        told_overdue: overdue dates that were told before.
    """
    news = find_news(report, setting.on, told_overdue)
    if not news:
        return ()
    subject, body = f"Facadelake: {summarise_report(report)}", "\n".join(news)
    problems = []
    for address in setting.to:
        try:
            block = load_notification_block(address)
            with block.raise_on_failure():
                sending = block.notify(body, subject)
                if isawaitable(sending):  # of blocks that know no other way
                    run_coro_as_sync(sending)
        except Exception as error:  # of any service that Apprise knows; a message is no reason to fail
            problems.append(f"not told {format_address(address)}: {str(error) or type(error).__name__}")
    return tuple(problems)


def load_notification_block(address: str) -> NotificationBlock:
    """Prefect's notification block of an address in Apprise's notation, or a saved one by ``type/name``."""
    if "://" in address:
        return AppriseNotificationBlock(url=SecretStr(address))
    block = Block.load(address)
    if not isinstance(block, NotificationBlock):
        raise TypeError(f"{type(block).__name__} is a block that sends no messages")
    return block
