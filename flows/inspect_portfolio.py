"""Flow: every campaign of the portfolio that is not in the lake yet."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

from prefect import flow

from facadelake.campaigns import order_by_capture
from facadelake.core.errors import FacadelakeError
from facadelake.lake import has_lake, read_table
from facadelake.registry import read_portfolio
from flows.inspect_building import inspect_building

log = logging.getLogger("facadelake.flows")


@dataclass(frozen=True, kw_only=True)
class PortfolioOutcome:
    """Outcome of one campaign: its version in the lake, or the problem."""

    building_id: str
    campaign_id: str
    version: int | None
    problem: str


@flow(name="inspect-portfolio")
def inspect_portfolio(portfolio: str = "data/portfolio.yaml", lake: str = "lake") -> list[PortfolioOutcome]:
    """Inspect the campaigns that are not in the lake, one after another; a failure does not stop the others.

    Raises FacadelakeError at the end if any failed, with the reason of each.
    """
    folder = Path(lake).resolve()
    held = read_table(folder, "campaigns").to_pylist() if has_lake(folder) else []
    done = {(row["building_id"], row["campaign_id"]) for row in held}
    outcomes = []
    for building in read_portfolio(Path(portfolio)).buildings:
        order = order_by_capture(building)  # a campaign is placed by those that were flown before it
        for remark in order.remarks:
            log.warning("%s", remark)
        for campaign in order.campaigns:
            if (building.id, campaign) not in done:
                outcomes.append(_attempt(building.id, campaign, portfolio, lake))
    failed = [outcome for outcome in outcomes if outcome.version is None]
    if failed:
        reasons = "\n  ".join(f"{o.building_id} {o.campaign_id}: {o.problem}" for o in failed)
        raise FacadelakeError(f"{len(failed)} of {len(outcomes)} campaigns were not committed:\n  {reasons}")
    return outcomes


def _attempt(building_id: str, campaign_id: str, portfolio: str, lake: str) -> PortfolioOutcome:
    try:
        result = inspect_building(building_id, campaign_id, portfolio=portfolio, lake=lake)
    except FacadelakeError as error:
        log.error("%s %s: %s", building_id, campaign_id, error)
        return PortfolioOutcome(building_id=building_id, campaign_id=campaign_id, version=None, problem=str(error))
    return PortfolioOutcome(building_id=building_id, campaign_id=campaign_id, version=result.version, problem="")
