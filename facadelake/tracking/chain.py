"""One identity across campaigns: every campaign in order of its capture time is matched to what is known before it.

The partition is a function of the set of campaigns alone: however they arrived, they are matched in order of time, from
nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64N, RowIndices
from facadelake.tracking.assignment import assign_defects
from facadelake.tracking.campaign_defects import DefectArrays, TrackedCampaign, concatenate_defects
from facadelake.tracking.candidates import find_candidates
from facadelake.tracking.frame_offsets import FrameOffset, estimate_frame_offsets, expand_offsets

_OFFSET_LEFT_M = 0.01  # one sigma of what an estimated offset leaves at a single defect


@dataclass(frozen=True, kw_only=True, eq=False)
class CampaignLink:
    """How the defects (n) of a campaign belong to chains.

    ``chain`` (n,): number of the chain; ``probability`` (n,) of the match to it, NaN where the defect begins one.
    ``found_again``: estimated probability that a known defect is found in this campaign.
    """

    campaign_id: str
    chain: RowIndices
    probability: Float64N
    offsets: tuple[FrameOffset, ...]
    found_again: float


def link_campaigns(
    campaigns: Sequence[TrackedCampaign], area_m2: float, sigma_between_m: float
) -> list[CampaignLink]:
    """Chains of the defects of a building.

    Args:
        campaigns: the campaigns, in any order.
        area_m2: area of the building's surface.
        sigma_between_m: one sigma of the offset between two campaigns' frames.

    Returns:
        One link a campaign, in order of capture time (then id).
    """
    known: DefectArrays | None = None
    links: list[CampaignLink] = []
    for campaign in sorted(campaigns, key=lambda c: (c.captured_at, c.campaign_id)):
        defects = campaign.defects
        if known is None:
            chain, probability = np.arange(len(defects)), np.full(len(defects), np.nan)
            offsets: list[FrameOffset] = []
            found_again = np.nan
            known = defects
        else:
            offsets = estimate_frame_offsets(known, defects, sigma_between_m)
            offset = expand_offsets(offsets, defects)
            pairs = find_candidates(known, defects, offset, _OFFSET_LEFT_M)
            assigned = assign_defects(pairs, len(known), len(defects), area_m2)
            found_again = assigned.found_again
            chain, probability = np.full(len(defects), -1), np.full(len(defects), np.nan)
            chain[assigned.found], probability[assigned.found] = assigned.known, assigned.probability
            new = np.flatnonzero(chain < 0)
            chain[new] = len(known) + np.arange(len(new))
            known = _update_known(known, defects, offset, chain, new)
        links.append(
            CampaignLink(
                campaign_id=campaign.campaign_id,
                chain=chain,
                probability=probability,
                offsets=tuple(offsets),
                found_again=found_again,
            )
        )
    return links


def _update_known(
    known: DefectArrays, defects: DefectArrays, offset_m: np.ndarray, chain: RowIndices, new: RowIndices
) -> DefectArrays:
    """Known defects as seen last, in the frame of the first campaign, with the new ones at the end."""
    moved = {**defects.__dict__, "xyz_site_m": defects.xyz_site_m - offset_m}
    in_frame = DefectArrays(**moved)
    matched = np.flatnonzero(chain < len(known))
    updated = {}
    for name, values in known.__dict__.items():
        values = values.copy()
        values[chain[matched]] = getattr(in_frame, name)[matched]
        updated[name] = values
    return concatenate_defects(DefectArrays(**updated), in_frame.take(new))
