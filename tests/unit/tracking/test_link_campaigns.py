"""Chains of defects over campaigns: true identities, in any order of arrival, and frames that do not agree."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from facadelake.tracking import CampaignLink, TrackedCampaign, link_campaigns
from schemas.vocabulary import OffsetOutcome
from tests.unit.tracking.wall_defects import draw_wall, find_defects

AREA_M2 = 300.0


def collect_chains(campaigns: list[TrackedCampaign], links: list[CampaignLink]) -> set[frozenset[tuple[str, str]]]:
    """The chains as sets of campaign and true defect."""
    by_id = {campaign.campaign_id: campaign for campaign in campaigns}
    chains: dict[int, set[tuple[str, str]]] = {}
    for link in links:
        ids = by_id[link.campaign_id].defects.defect_id
        for row, chain in enumerate(link.chain.tolist()):
            chains.setdefault(chain, set()).add((link.campaign_id, str(ids[row])))
    return {frozenset(chain) for chain in chains.values()}


@pytest.mark.parametrize("seed", range(5))
def test_chains_are_the_true_defects(seed: int) -> None:
    wall = draw_wall(seed)
    campaigns = [
        find_defects(wall, number, offset_m=(0.03 * number, 0, -0.02 * number), seed=seed) for number in (0, 1, 2)
    ]
    chains = collect_chains(campaigns, link_campaigns(campaigns, AREA_M2))
    pure = [chain for chain in chains if len({true for _, true in chain}) == 1]
    found = {true for campaign in campaigns for true in campaign.defects.defect_id.tolist()}
    assert len(pure) >= 0.98 * len(chains)
    assert len(found) <= len(chains) <= len(found) + 2


def test_the_partition_does_not_depend_on_the_order_of_arrival() -> None:
    wall = draw_wall(7)
    campaigns = [find_defects(wall, number, recall=0.7) for number in range(3)]
    partitions = [collect_chains(campaigns, link_campaigns(list(order), AREA_M2)) for order in permutations(campaigns)]
    assert all(partition == partitions[0] for partition in partitions)


def test_the_offset_of_a_frame_is_told_with_a_sigma_that_covers_it() -> None:
    wall = draw_wall(3)
    campaigns = [find_defects(wall, 0), find_defects(wall, 1, offset_m=(0.05, 0.0, -0.04))]
    (_, link) = link_campaigns(campaigns, AREA_M2)
    building = link.offsets[0]
    assert building.outcome is OffsetOutcome.ESTIMATED and building.pairs > 30
    error = np.abs(building.xyz_m - [0.05, 0.0, -0.04])
    assert (error < 0.01).all() and (error < 3 * np.sqrt(np.diag(building.covariance_m2))).all()


def test_a_frame_that_jumped_by_half_a_metre_is_refused_and_later_ones_go_on() -> None:
    wall = draw_wall(4)
    campaigns = [find_defects(wall, 0), find_defects(wall, 1, offset_m=(0.5, 0.0, 0.0)), find_defects(wall, 2)]
    first, jumped, last = link_campaigns(campaigns, AREA_M2)
    (offset,) = jumped.offsets
    assert offset.outcome is OffsetOutcome.REFUSED and (jumped.chain == -1).all()
    assert abs(offset.xyz_m[0] - 0.5) < 0.03 and offset.limit_m is not None and offset.limit_m < 0.3
    assert len(np.intersect1d(first.chain, last.chain)) > 40


def test_an_offset_within_what_gps_admits_is_no_jump() -> None:
    wall = draw_wall(4)
    placed_by_gps = TrackedCampaign(**{**vars(find_defects(wall, 1, offset_m=(0.5, 0.0, 0.2))), "frame_sigma_m": 0.6})
    _, link = link_campaigns([find_defects(wall, 0), placed_by_gps], AREA_M2)
    assert link.offsets[0].outcome is OffsetOutcome.ESTIMATED
    assert np.count_nonzero(link.candidates.matched) > 40


def test_probabilities_tell_what_is_sure() -> None:
    wall = draw_wall(5)
    campaigns = [find_defects(wall, 0, recall=1.0), find_defects(wall, 1, recall=1.0)]
    _, link = link_campaigns(campaigns, AREA_M2)
    matched = ~np.isnan(link.probability)
    assert np.median(link.probability[matched]) > 0.99 and (link.probability[matched] <= 1.0 + 1e-9).all()
    assert 0.9 < link.found_again <= 1.0


def test_a_campaign_without_defects_breaks_nothing() -> None:
    wall = draw_wall(5)
    empty = find_defects(wall, 1, recall=0.0)
    links = link_campaigns([find_defects(wall, 0), empty, find_defects(wall, 2)], AREA_M2)
    assert len(links[1].chain) == 0 and np.count_nonzero(links[2].candidates.matched) > 40
