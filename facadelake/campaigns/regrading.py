"""Regrading of committed campaigns by another rule pack, and publishing of the new grades."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from facadelake.lake import Regrading, list_versions, preview_regrading, regrade
from facadelake.publish import publish_regraded
from facadelake.registry import Building, read_portfolio
from facadelake.severity import find_rule_file


def find_registered_rules(portfolio: Path, building_id: str) -> str | None:
    """The rule pack that the portfolio names for a building; None where the building is not registered."""
    if not portfolio.exists():
        return None
    known = {building.id: building.severity_rules for building in read_portfolio(portfolio).buildings}
    return known.get(building_id)


def describe_replaced_regrading(building: Building, campaign_id: str, rules: str) -> str:
    """Notice that a new inspection replaced a regrading by the portfolio's rule pack."""
    return (
        f"the previous version was regraded by {rules}, this one is graded by the portfolio's {building.severity_rules}"
        f"; to grade it by {rules}: facadelake regrade {building.id} {campaign_id} --rules {rules}"
    )


def preview_grades(lake: Path, building_id: str, campaign_id: str | None, rules: str) -> Regrading:
    """What ``regrade_campaigns`` would change; nothing is written.

    Args:
        lake: path of the lake.
        building_id: the building.
        campaign_id: its campaign; None: all.
        rules: name of the rule pack.
    """
    return preview_regrading(lake, building_id=building_id, campaign_id=campaign_id, rule_file=find_rule_file(rules))


def regrade_campaigns(
    lake: Path, building_id: str, campaign_id: str | None, rules: str
) -> tuple[Regrading, Sequence[Path]]:
    """Regrade one campaign or all of a building, and publish the releases with the new grades.

    A regrading whose publishing was interrupted is published by the next call.

    Args:
        lake: path of the lake.
        building_id: the building.
        campaign_id: its campaign; None: all.
        rules: name of the rule pack.

    Returns:
        The regrading, and the folders of the releases.

    Raises:
        FacadelakeError: where the rule pack or the campaign is unknown, or the lake cannot be written.
    """
    regrading = regrade(lake, building_id=building_id, campaign_id=campaign_id, rule_file=find_rule_file(rules))
    newest = {
        row["campaign_id"]: row
        for row in list_versions(lake).to_pylist()
        # A review changes nothing published; the history of a building by itself (of no campaign) is no release.
        if row["building_id"] == building_id and row["campaign_id"] is not None and row["reviewed_by"] is None
    }
    releases = [
        publish_regraded(lake, building_id=building_id, campaign_id=campaign, version=row["version"])
        for campaign, row in sorted(newest.items())
        if row["regraded_by"] is not None and campaign_id in (None, campaign)
    ]
    return regrading, releases
