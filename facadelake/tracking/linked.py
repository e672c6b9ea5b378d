"""The defects of all campaigns of a building as chains, what changed between their detections, and where to look."""

from __future__ import annotations

from bisect import bisect
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from datetime import timedelta

import numpy as np
from scipy.spatial import cKDTree

from facadelake.core.arrays import Float64x3
from facadelake.registration import compute_tangents
from facadelake.tracking.campaign_defects import CLASSES
from facadelake.tracking.chain import CampaignLink, link_campaigns
from facadelake.tracking.records import CampaignRecords
from facadelake.tracking.second_look.look import LookRequest
from facadelake.tracking.size_change import DefectSizes
from facadelake.tracking.size_pairs import SizedDefects, SizeDifference, compare_sized_pairs
from facadelake.tracking.sizes import share_blur
from schemas.vocabulary import DefectClass, OffsetOutcome, TrackRelation, TrendQuantity

YEAR = timedelta(days=365.25)
_COVERED_MIN = 0.7  # share of a defect's extents that another one covers, of which it is then a part
_COVERED_DEPTH_M = 0.3


@dataclass(frozen=True, kw_only=True)
class ChainDefect:
    """Defect ``row`` of campaign ``campaign`` (numbers), ``previous``: the detection before, of the same chain."""

    campaign: int
    row: int
    previous: tuple[int, int] | None
    probability: float | None


@dataclass(frozen=True, kw_only=True)
class Relation:
    """A relation of a chain in a campaign to ``other`` (None: a change of its class), in words."""

    chain: int
    campaign: int
    kind: TrackRelation
    other: int | None
    detail: str


@dataclass(frozen=True, kw_only=True, eq=False)
class _DefectTree:
    """Places of a campaign's defects in the first campaign's frame, and the largest of their extents."""

    tree: cKDTree
    extent_max_m: float


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkedHistory:
    """All campaigns of a building, linked.

    ``campaigns`` in order of capture, without those whose frame was ``refused``, and ``links`` of both.
    ``sightings``: of each chain, by number of the campaign. ``changes``: by (campaign, row) and quantity. ``parts``: by
    chain, campaigns in which a defect of another chain covers its place. ``scales``: by (campaign, quantity), of the
    sigmas of sizes.
    """

    campaigns: Sequence[CampaignRecords]
    refused: Sequence[CampaignRecords]
    links: Sequence[CampaignLink]
    sightings: Sequence[dict[int, ChainDefect]]
    changes: dict[tuple[int, int], dict[TrendQuantity, SizeDifference]]
    scales: dict[tuple[int, TrendQuantity], float]
    parts: Sequence[frozenset[int]]
    relations: Sequence[Relation]

    @property
    def time_remarks(self) -> dict[str, str]:
        """What is to be said of the campaigns' times."""
        return {one.campaign_id: one.time_remark for one in (*self.campaigns, *self.refused) if one.time_remark}

    def find_link(self, campaign: int) -> CampaignLink:
        """The link of a campaign by its number."""
        return next(link for link in self.links if link.campaign_id == self.campaigns[campaign].campaign_id)


def link_history(records: Sequence[CampaignRecords], area_m2: float) -> LinkedHistory:
    """Link the campaigns of a building; the result does not depend on their order.

    Args:
        records: the campaigns.
        area_m2: area of the building's surface.
    """
    links = link_campaigns([one.tracked for one in records], area_m2)
    by_id = {one.campaign_id: one for one in records}
    tracked = [link for link in links if link.offsets[0].outcome is not OffsetOutcome.REFUSED]
    campaigns = [by_id[link.campaign_id] for link in tracked]
    shared = share_blur([one.sizes for one in campaigns])
    campaigns = [replace(one, sizes=sizes) for one, sizes in zip(campaigns, shared, strict=True)]
    sightings = _list_chain_defects(tracked)
    changes, scales = _compare_detections(campaigns, sightings)
    parts, relations = _relate(campaigns, tracked, sightings)
    return LinkedHistory(
        campaigns=campaigns,
        refused=[one for one in records if one.campaign_id not in {link.campaign_id for link in tracked}],
        links=links,
        sightings=sightings,
        changes=changes,
        scales=scales,
        parts=parts,
        relations=relations,
    )


def list_look_requests(history: LinkedHistory) -> list[LookRequest]:
    """The places to look at: of each chain, in every campaign that did not detect it, against the nearest detection.

    The nearest is the last one before the campaign, else the first one after it.
    """
    requests = []
    tracked = [history.find_link(number) for number in range(len(history.campaigns))]
    for sightings in history.sightings:
        known = sorted(sightings)
        for campaign in range(len(history.campaigns)):
            if campaign in sightings:
                continue
            seen = known[max(bisect(known, campaign) - 1, 0)]
            row = sightings[seen].row
            records = history.campaigns[seen]
            defects = records.tracked.defects
            in_first = defects.xyz_site_m[row] - tracked[seen].offset_m[row]
            requests.append(
                LookRequest(
                    seen_campaign=records.campaign_id,
                    defect_id=str(defects.defect_id[row]),
                    defect_class=DefectClass(CLASSES[defects.defect_class[row]]),
                    campaign_id=history.campaigns[campaign].campaign_id,
                    xyz_seen_m=defects.xyz_site_m[row],
                    xyz_other_m=in_first + _find_offset(tracked[campaign], str(defects.facade[row])),
                    normal_site=defects.normal_site[row],
                    width_m=float(defects.width_m[row]),
                    height_m=float(defects.height_m[row]),
                )
            )
    return requests


def _find_offset(link: CampaignLink, facade: str) -> Float64x3:
    """The campaign's offset on a facade, else on the building."""
    by_facade = {offset.facade: offset.xyz_m for offset in link.offsets}
    return by_facade.get(facade, by_facade[""])


def _list_chain_defects(links: Sequence[CampaignLink]) -> list[dict[int, ChainDefect]]:
    count = max((int(link.chain.max(initial=-1)) + 1 for link in links), default=0)
    found: list[dict[int, ChainDefect]] = [{} for _ in range(count)]
    for campaign, link in enumerate(links):
        for row, chain in enumerate(link.chain.tolist()):
            before = found[chain]
            last = max(before, default=None)
            probability = float(link.probability[row])
            before[campaign] = ChainDefect(
                campaign=campaign,
                row=row,
                previous=None if last is None else (last, before[last].row),
                probability=None if np.isnan(probability) else probability,
            )
    return found


def _compare_detections(
    campaigns: Sequence[CampaignRecords], sightings: Sequence[dict[int, ChainDefect]]
) -> tuple[dict[tuple[int, int], dict[TrendQuantity, SizeDifference]], dict[tuple[int, TrendQuantity], float]]:
    """Changes of every detection against the one before, significant over all defects of the building."""
    changes: dict[tuple[int, int], dict[TrendQuantity, SizeDifference]] = {}
    scales: dict[tuple[int, TrendQuantity], float] = {}
    for number in range(len(campaigns)):
        found = [one[number] for one in sightings if number in one and one[number].previous is not None]
        if not found:
            continue
        before = [one.previous for one in found if one.previous is not None]
        after = [(one.campaign, one.row) for one in found]
        compared = compare_sized_pairs(_gather_sizes(campaigns, before), _gather_sizes(campaigns, after))
        scales |= {(number, quantity): scale for quantity, scale in compared.scales.items()}
        changes |= dict(zip(after, compared.changes, strict=True))
    return changes, scales


def _gather_sizes(campaigns: Sequence[CampaignRecords], places: Sequence[tuple[int, int]]) -> SizedDefects:
    """The defects at ``places`` (campaign, row)."""
    found = [(campaigns[campaign], row) for campaign, row in places]
    return SizedDefects(
        defect_class=[DefectClass(CLASSES[one.tracked.defects.defect_class[row]]) for one, row in found],
        sizes={
            quantity: DefectSizes(
                **{
                    field.name: np.array([getattr(one.sizes[quantity], field.name)[row] for one, row in found])
                    for field in fields(DefectSizes)
                }
            )
            for quantity in TrendQuantity
        },
    )


def _relate(
    campaigns: Sequence[CampaignRecords], links: Sequence[CampaignLink], sightings: Sequence[dict[int, ChainDefect]]
) -> tuple[list[frozenset[int]], list[Relation]]:
    """Which chains are a part of another one in campaigns that did not detect them; splits, joins, changes of class."""
    parts: list[set[int]] = [set() for _ in sightings]
    trees = [
        _DefectTree(
            tree=cKDTree(one.tracked.defects.xyz_site_m - link.offset_m),
            extent_max_m=float(one.tracked.defects.extent_m.max(initial=0.0)),
        )
        for one, link in zip(campaigns, links, strict=True)
    ]
    relations = []
    for chain, own in enumerate(sightings):
        for _, one in sorted(own.items()):
            if one.previous is not None:
                relation = _find_class_change(campaigns, chain, one)
                relations += [relation] if relation else []
        first, last = min(own), max(own)
        # Joined: detected before, and covered since by a defect that did not cover it then.
        if last + 1 < len(campaigns):
            other = _find_cover(campaigns, links, sightings, trees[last + 1], chain, last, last + 1)
            if other is not None:
                parts[chain].add(last + 1)
                relations.append(_describe_part(campaigns, TrackRelation.JOINED_INTO, chain, last + 1, other))
        if first > 0:
            other = _find_cover(campaigns, links, sightings, trees[first - 1], chain, first, first - 1)
            if other is not None:
                parts[chain].add(first - 1)
                relations.append(_describe_part(campaigns, TrackRelation.SPLIT_FROM, chain, first, other))
    return [frozenset(one) for one in parts], relations


def _find_class_change(campaigns: Sequence[CampaignRecords], chain: int, one: ChainDefect) -> Relation | None:
    assert one.previous is not None
    before, after = (
        CLASSES[campaigns[campaign].tracked.defects.defect_class[row]]
        for campaign, row in (one.previous, (one.campaign, one.row))
    )
    if before == after:
        return None
    return Relation(
        chain=chain,
        campaign=one.campaign,
        kind=TrackRelation.CLASS_CHANGED,
        other=None,
        detail=f"{before} in {campaigns[one.previous[0]].campaign_id}, {after} since",
    )


def _describe_part(
    campaigns: Sequence[CampaignRecords], kind: TrackRelation, chain: int, campaign: int, other: int
) -> Relation:
    name = campaigns[campaign].campaign_id
    detail = f"found as one with the other in {name}" if kind is TrackRelation.JOINED_INTO else f"found apart in {name}"
    return Relation(chain=chain, campaign=campaign, kind=kind, other=other, detail=detail)


def _find_cover(
    campaigns: Sequence[CampaignRecords],
    links: Sequence[CampaignLink],
    sightings: Sequence[dict[int, ChainDefect]],
    tree: _DefectTree,
    chain: int,
    there: int,
    elsewhere: int,
) -> int | None:
    """The chain whose defect of campaign ``elsewhere`` covers a defect that campaign ``there`` found beside it."""
    row = sightings[chain][there].row
    own = campaigns[there].tracked.defects
    centre = own.xyz_site_m[row] - links[there].offset_m[row]
    everywhere = campaigns[elsewhere].tracked.defects
    # A defect that covers this one has its centre within half of its own diagonal and of this one's.
    reach_m = (float(np.hypot(own.width_m[row], own.height_m[row])) + tree.extent_max_m) / 2 + _COVERED_DEPTH_M
    near = np.array(sorted(tree.tree.query_ball_point(centre, reach_m)), dtype=np.int64)
    other = everywhere.take(near)
    if not len(other):
        return None
    across, upward = (axis[0] for axis in compute_tangents(own.normal_site[row][None]))
    shift = other.xyz_site_m - links[elsewhere].offset_m[near] - centre
    share = np.ones(len(other))
    for axis, name in ((across, "width_m"), (upward, "height_m")):
        half, half_other = float(getattr(own, name)[row]) / 2, getattr(other, name) / 2
        place = shift @ axis
        common = np.minimum(half, place + half_other) - np.maximum(-half, place - half_other)
        share *= np.clip(common, 0, None) / max(2 * half, 1e-6)
    covers = (
        (share >= _COVERED_MIN)
        & (np.abs(shift @ own.normal_site[row]) <= _COVERED_DEPTH_M)
        & (other.defect_class == own.defect_class[row])
    )
    for candidate in np.flatnonzero(covers)[np.argsort(-share[covers])].tolist():
        cover = int(links[elsewhere].chain[near[candidate]])
        beside = sightings[cover].get(there)  # it must have been found apart where this one was
        if cover != chain and beside is not None:
            return cover
    return None
