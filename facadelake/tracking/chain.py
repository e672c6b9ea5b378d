"""One identity across campaigns: every campaign in order of its capture time is matched to what is known before it.

The partition is a function of the set of campaigns alone: however they arrived, they are matched in order of time, from
nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import BoolArray, Float64N, Float64Nx3, RowIndices
from facadelake.tracking.assignment import Assignment, assign_defects
from facadelake.tracking.campaign_defects import DefectArrays, TrackedCampaign, concatenate_defects
from facadelake.tracking.candidates import CandidatePairs, find_candidates
from facadelake.tracking.frame_offsets import FrameOffset, estimate_frame_offsets, expand_offsets, find_jump
from schemas.vocabulary import OffsetOutcome

_OFFSET_LEFT_M = 0.01  # one sigma of what an estimated offset leaves at a single defect


@dataclass(frozen=True, kw_only=True, eq=False)
class CandidateChains:
    """Candidates (k) of a campaign: ``chain`` and row ``defect`` with what speaks for and against each."""

    chain: RowIndices
    defect: RowIndices
    displacement_m: Float64N
    mahalanobis: Float64N
    log_odds: Float64N
    probability: Float64N
    matched: BoolArray


@dataclass(frozen=True, kw_only=True, eq=False)
class CampaignLink:
    """How the defects (n) of a campaign belong to chains.

    ``chain`` (n,): number of the chain, -1 where the campaign's frame was refused. ``probability`` (n,) of the match to
    it, NaN where the defect begins one. ``offset_m`` (n, 3): the frame's offset at each defect, which is to be
    subtracted. ``found_again``: estimated probability that a known defect is found in this campaign.
    """

    campaign_id: str
    chain: RowIndices
    probability: Float64N
    offset_m: Float64Nx3
    offsets: tuple[FrameOffset, ...]
    candidates: CandidateChains
    found_again: float


def sort_campaigns(campaigns: Sequence[TrackedCampaign]) -> list[TrackedCampaign]:
    """The campaigns in order of capture time, those of one time by id."""
    return sorted(campaigns, key=lambda c: (c.captured_at, c.campaign_id))


def link_campaigns(campaigns: Sequence[TrackedCampaign], area_m2: float) -> list[CampaignLink]:
    """Chains of the defects of a building.

    Args:
        campaigns: the campaigns, in any order.
        area_m2: area of the building's surface.

    Returns:
        One link a campaign, in order of capture time (then id).
    """
    known: DefectArrays | None = None
    sigma_m = 0.0
    links: list[CampaignLink] = []
    for campaign in sort_campaigns(campaigns):
        defects = campaign.defects
        if known is None:
            links.append(_begin(campaign))
            known, sigma_m = defects, campaign.frame_sigma_m
            continue
        between_m = float(np.hypot(sigma_m, campaign.frame_sigma_m))
        jump = find_jump(known, defects, between_m)
        if jump is not None:
            links.append(_refuse(campaign, jump))
            continue
        offsets = estimate_frame_offsets(known, defects, between_m)
        offset = expand_offsets(offsets, defects)
        pairs = find_candidates(known, defects, offset, _OFFSET_LEFT_M)
        assigned = assign_defects(pairs, len(known), len(defects), area_m2)
        chain, probability = np.full(len(defects), -1), np.full(len(defects), np.nan)
        taken = np.flatnonzero(assigned.matched)
        chain[pairs.found[taken]], probability[pairs.found[taken]] = pairs.known[taken], assigned.probability[taken]
        new = np.flatnonzero(chain < 0)
        chain[new] = len(known) + np.arange(len(new))
        known = _update_known(known, defects, offset, chain, new)
        links.append(
            CampaignLink(
                campaign_id=campaign.campaign_id,
                chain=chain,
                probability=probability,
                offset_m=offset,
                offsets=tuple(offsets),
                candidates=_list_candidates(pairs, assigned),
                found_again=assigned.found_again,
            )
        )
    return links


def _begin(campaign: TrackedCampaign) -> CampaignLink:
    """The first campaign: every defect begins a chain."""
    count = len(campaign.defects)
    first = FrameOffset(
        facade="", outcome=OffsetOutcome.FIRST, xyz_m=np.zeros(3), covariance_m2=np.zeros((3, 3)), pairs=0
    )
    return CampaignLink(
        campaign_id=campaign.campaign_id,
        chain=np.arange(count),
        probability=np.full(count, np.nan),
        offset_m=np.zeros((count, 3)),
        offsets=(first,),
        candidates=_NO_CANDIDATES,
        found_again=np.nan,
    )


def _refuse(campaign: TrackedCampaign, jump: FrameOffset) -> CampaignLink:
    """A campaign whose frame contradicts those before: no defect of it is matched."""
    count = len(campaign.defects)
    return CampaignLink(
        campaign_id=campaign.campaign_id,
        chain=np.full(count, -1),
        probability=np.full(count, np.nan),
        offset_m=np.zeros((count, 3)),
        offsets=(jump,),
        candidates=_NO_CANDIDATES,
        found_again=np.nan,
    )


def _list_candidates(pairs: CandidatePairs, assigned: Assignment) -> CandidateChains:
    return CandidateChains(
        chain=pairs.known,
        defect=pairs.found,
        displacement_m=np.linalg.norm(pairs.displacement_m, axis=1),
        mahalanobis=pairs.mahalanobis,
        log_odds=assigned.log_odds,
        probability=assigned.probability,
        matched=assigned.matched,
    )


_NO_CANDIDATES = CandidateChains(
    chain=np.zeros(0, dtype=np.int64),
    defect=np.zeros(0, dtype=np.int64),
    displacement_m=np.zeros(0),
    mahalanobis=np.zeros(0),
    log_odds=np.zeros(0),
    probability=np.zeros(0),
    matched=np.zeros(0, dtype=bool),
)


def _update_known(
    known: DefectArrays, defects: DefectArrays, offset_m: Float64Nx3, chain: RowIndices, new: RowIndices
) -> DefectArrays:
    """Known defects as seen last, in the frame of the first campaign, with the new ones at the end."""
    in_frame = DefectArrays(**{**vars(defects), "xyz_site_m": defects.xyz_site_m - offset_m})
    matched = np.flatnonzero(chain < len(known))
    updated = {}
    for name, column in vars(known).items():
        values = column.copy()
        values[chain[matched]] = getattr(in_frame, name)[matched]
        updated[name] = values
    return concatenate_defects(DefectArrays(**updated), in_frame.take(new))
