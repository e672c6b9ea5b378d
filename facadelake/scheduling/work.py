"""What an inspection of the portfolio is given, and the plan that is made of it."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from facadelake.intake import observe_campaign
from facadelake.registry import Building, Portfolio, ServiceSettings, read_portfolio, read_service_settings
from facadelake.scheduling.building_log import write_building_log
from facadelake.scheduling.plan import PortfolioPlan, UploadCheck, describe_recent_change, plan_portfolio
from facadelake.scheduling.side_by_side import InspectionLimits, find_limits


@dataclass(frozen=True, kw_only=True)
class PortfolioWork:
    """What an inspection of the portfolio is given: settings, limits, and the moment that it started."""

    registered: Portfolio
    lake: Path
    settings: ServiceSettings
    limits: InspectionLimits
    check_upload: UploadCheck
    code_sha256: str
    started_at: datetime


def prepare_work(portfolio: str | None, lake: str | None, settings: str | None, *, code_sha256: str) -> PortfolioWork:
    """Read portfolio and settings, and find the limits of this machine.

    With settings, uploads are observed by the intake, which remembers what it saw; without, a folder is complete when
    nothing was written to it for the default time.

    Args:
        portfolio: path of the portfolio; None: that of the settings.
        lake: folder of the lake; None: that of the settings.
        settings: path of the service's settings; None: the defaults.
        code_sha256: version of the code of an inspection.

    Returns:
        The work. Raises InputDataError where portfolio or settings have mistakes.
    """
    service = read_service_settings(Path(settings)) if settings else ServiceSettings()
    service = service.model_copy(
        update={"portfolio": portfolio or service.portfolio, "lake": str(Path(lake or service.lake).resolve())}
    )
    quiet = timedelta(minutes=service.intake.quiet_minutes)

    def observe(building: Building, campaign_id: str) -> str:
        return observe_campaign(building, campaign_id, service).explanation

    def look(building: Building, campaign_id: str) -> str:
        folder = building.locate_photographs(campaign_id)
        return describe_recent_change(folder, quiet=quiet, now=datetime.now(UTC))

    return PortfolioWork(
        registered=read_portfolio(Path(service.portfolio)),
        lake=Path(service.lake),
        settings=service,
        limits=find_limits(service.limits),
        check_upload=observe if settings else look,
        code_sha256=code_sha256,
        started_at=datetime.now(UTC),
    )


def plan_work(work: PortfolioWork) -> PortfolioPlan:
    """What waits, what is left out and why, and the dates; nothing is run or written."""
    return plan_portfolio(
        work.registered,
        work.lake,
        code_sha256=work.code_sha256,
        now=work.started_at,
        check_upload=work.check_upload,
        memory_mib=work.limits.memory_mib,
    )


def write_logs(work: PortfolioWork, plan: PortfolioPlan) -> None:
    """Write what is remembered of each building."""
    for building_id, one in plan.logs.items():
        write_building_log(work.lake, building_id, one)
