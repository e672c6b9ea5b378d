"""Grade committed campaigns by another rule pack, and publish them with their new grades."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from facadelake.lake import Regrading, list_versions, preview_regrading, regrade
from facadelake.publish import publish_regraded
from facadelake.registry import Building, read_portfolio
from facadelake.severity import find_rule_file


def find_registered_rules(portfolio: Path, building_id: str) -> str | None:
    """The rule pack that the registry names for a building, None where it does not know the building."""
    if not portfolio.exists():
        return None
    known = {building.id: building.severity_rules for building in read_portfolio(portfolio).buildings}
    return known.get(building_id)


def describe_replaced_regrading(building: Building, campaign_id: str, rules: str) -> str:
    """What to tell of a regrading that a new inspection has replaced by the registry's grades."""
    return (
        f"the earlier version was regraded by {rules}, this one is graded by the registry's {building.severity_rules}; "
        f"'facadelake regrade {building.id} {campaign_id} --rules {rules}' grades it so again"
    )


def preview_grades(lake: Path, building_id: str, campaign_id: str | None, rules: str) -> Regrading:
    """What ``regrade_campaigns`` would change; nothing is written."""
    return preview_regrading(lake, building_id=building_id, campaign_id=campaign_id, rule_file=find_rule_file(rules))


def regrade_campaigns(
    lake: Path, building_id: str, campaign_id: str | None, rules: str
) -> tuple[Regrading, Sequence[Path]]:
    """The regrading of one campaign (None: of all) and the releases that show it.

    A regrading whose publishing was cut off is published by the next call. Raises FacadelakeError where the pack or the
    campaign is unknown, or the lake cannot be written.
    """
    done = regrade(lake, building_id=building_id, campaign_id=campaign_id, rule_file=find_rule_file(rules))
    newest = {
        row["campaign_id"]: row
        for row in list_versions(lake).to_pylist()
        if row["building_id"] == building_id and row["reviewed_by"] is None  # a review changes nothing published
    }
    releases = [
        publish_regraded(lake, building_id=building_id, campaign_id=campaign, version=row["version"])
        for campaign, row in sorted(newest.items())
        if row["regraded_by"] is not None and campaign_id in (None, campaign)
    ]
    return done, releases
