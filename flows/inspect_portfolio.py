"""Flow: all campaigns of the portfolio that wait, side by side; one report of what is done, failed, due and overdue."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock, Timeout
from prefect import flow

from facadelake.core.code_version import compute_code_version
from facadelake.core.errors import FacadelakeError, StoreError
from facadelake.scheduling import (
    PORTFOLIO_FOLDER,
    CampaignOutcome,
    PortfolioPlan,
    PortfolioReport,
    PortfolioWork,
    WaitingCampaign,
    find_building_dates,
    list_overdue_dates,
    plan_work,
    prepare_work,
    read_committed_buildings,
    summarise_report,
    write_building_log,
    write_logs,
    write_report,
)
from flows.campaign_runs import CampaignRuns
from flows.running import HOOKS
from tasks.portfolio.report import notify, read_found, report_portfolio

log = logging.getLogger("facadelake.flows")

_NEED_A_PERSON = ("too_large", "unreadable")
_INSPECTION = "flows.inspect_building"


class PortfolioError(FacadelakeError):
    """Campaigns were not committed; ``report`` says which, why, and what else was done."""

    def __init__(self, message: str, report: PortfolioReport) -> None:
        super().__init__(message)
        self.report = report


@flow(name="inspect-portfolio", flow_run_name="portfolio", validate_parameters=True, **HOOKS)
def inspect_portfolio(
    portfolio: str | None = None, lake: str | None = None, settings: str | None = None
) -> PortfolioReport:
    """Inspect the campaigns that wait; a failure, a crash or a killed process of one does not stop the others.

    Args:
        portfolio: path of the portfolio; None: that of the settings.
        lake: folder of the lake; None: that of the settings.
        settings: path of the service's settings; None: the defaults, the limits of the machine, and nobody is told.

    Returns:
        The report, which is also written to ``portfolio/`` in the lake.

    Raises:
        PortfolioError: campaigns failed, cannot be read, or are too large for this machine; the others are done.
        StoreError: another inspection of the portfolio is running.
    """
    work = prepare_work(portfolio, lake, settings, code_sha256=compute_code_version(_INSPECTION).sha256)
    with hold_portfolio(work.lake):
        plan = plan_work(work)
        write_logs(work, plan)
        runs = CampaignRuns(
            portfolio=str(Path(work.settings.portfolio).resolve()),
            lake=work.lake,
            folder=work.lake / PORTFOLIO_FOLDER / "runs" / f"{work.started_at:%Y%m%dT%H%M%SZ}",
            limits=work.limits,
            record=lambda one, outcome: _record(work, plan, one, outcome),
        )
        try:
            runs.run_all(plan.waiting)
        except BaseException:  # stopped: what is done is kept and told
            write_report(_build_report(work, plan, runs.outcomes), work.lake)
            raise
        report = _build_report(work, plan, runs.outcomes)
        told = [date for one in plan.logs.values() for date in one.told_overdue]
        problems = notify(report, work.settings.notify, told)
        for problem in problems:
            log.warning("%s", problem)
        report = replace(report, remarks=(*report.remarks, *problems))
        if work.settings.notify.to and not problems:
            _remember_overdue(work, plan, report)
        path = report_portfolio(report, work.lake)
    failed = [f"{one.building_id} {one.campaign_id}: {one.problem}" for one in report.list_failed()]
    failed += [
        f"{one.building_id} {one.campaign_id}: {one.reason}" for one in report.left_out if one.kind in _NEED_A_PERSON
    ]
    if failed:
        reasons = "\n  ".join(failed)
        raise PortfolioError(f"{summarise_report(report)} (report: {path})\n  {reasons}", report)
    return report


@contextmanager
def hold_portfolio(lake: Path) -> Iterator[None]:
    """Refuse a second inspection of the portfolio: both would start the same campaigns."""
    folder = lake / PORTFOLIO_FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder / ".lock", timeout=0):
            yield
    except Timeout as error:
        raise StoreError(
            f"another inspection of the portfolio is running with the lake {lake}; wait until it ends"
        ) from error


def _record(
    work: PortfolioWork, plan: PortfolioPlan, one: WaitingCampaign, outcome: CampaignOutcome
) -> CampaignOutcome:
    """Remember a failure, or forget earlier ones; the outcome with what was found."""
    building_log = plan.logs[one.building_id]
    if outcome.outcome == "committed" or outcome.outcome == "unchanged":
        building_log.clear_failure(one.campaign_id)
    else:
        building_log.record_failure(
            one.campaign_id,
            outcome=outcome.outcome,
            fingerprint=one.fingerprint,
            problem=outcome.problem,
            peak_mib=outcome.peak_mib,
            at=datetime.now(UTC),
        )
    write_building_log(work.lake, one.building_id, building_log)
    return read_found(work.lake, outcome)


def _build_report(work: PortfolioWork, plan: PortfolioPlan, outcomes: list[CampaignOutcome]) -> PortfolioReport:
    """The report, with the dates as they are after the inspections."""
    now = datetime.now(UTC)
    committed = read_committed_buildings(work.lake, [one.id for one in work.registered.buildings])
    ended = {(one.building_id, one.campaign_id) for one in outcomes}
    return PortfolioReport(
        started_at=work.started_at,
        finished_at=now,
        outcomes=tuple(outcomes),
        left_out=plan.left_out,
        not_done=tuple(
            f"{one.building_id} {one.campaign_id}"
            for one in plan.waiting
            if (one.building_id, one.campaign_id) not in ended
        ),
        dates=tuple(
            find_building_dates(one, committed[one.id], plan.logs[one.id], now) for one in work.registered.buildings
        ),
        remarks=plan.remarks,
    )


def _remember_overdue(work: PortfolioWork, plan: PortfolioPlan, report: PortfolioReport) -> None:
    """An overdue date is told once; one that is no longer overdue is forgotten."""
    if "overdue" in work.settings.notify.on:
        for one in report.dates:
            plan.logs[one.building_id].told_overdue = list_overdue_dates(one)
    write_logs(work, plan)
