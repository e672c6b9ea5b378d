"""Looks at the places of defects in campaigns, beside those that tracking asks for."""

from __future__ import annotations

from facadelake.core.arrays import Float64x3
from facadelake.tracking import CampaignRecords, LookRequest
from schemas.vocabulary import DefectClass


def build_look_request(
    records: CampaignRecords, row: int, campaign_id: str, xyz_other_m: Float64x3 | None
) -> LookRequest:
    """A look at the place of a defect of one campaign in the photographs of another.

    Args:
        records: the campaign that detected the defect.
        row: the defect.
        campaign_id: the other campaign.
        xyz_other_m: the place (3,) in the other campaign's frame; None: the same, the frames' offset is unknown.
    """
    defects = records.tracked.defects
    xyz = defects.xyz_site_m[row]
    return LookRequest(
        seen_campaign=records.campaign_id,
        defect_id=str(defects.defect_id[row]),
        defect_class=DefectClass(records.defect_table.column("defect_class")[row].as_py()),
        campaign_id=campaign_id,
        xyz_seen_m=xyz,
        xyz_other_m=xyz if xyz_other_m is None else xyz_other_m,
        normal_site=defects.normal_site[row],
        width_m=float(defects.width_m[row]),
        height_m=float(defects.height_m[row]),
    )
