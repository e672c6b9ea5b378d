"""What tracking says of a building, as the records that are compared with truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pyarrow as pa

from facadelake.core.tables import list_rows
from facadelake.evaluation.history.comparison import CalledState, DefectKey, MeasuredDefect
from facadelake.tracking import CampaignRecords
from schemas.vocabulary import StateEvidence, TrackState, TrendQuantity

_CHANGES = {
    TrendQuantity.LENGTH: ("length_change_m", "length_change_sigma_m"),
    TrendQuantity.AREA: ("area_change_m2", "area_change_sigma_m2"),
    TrendQuantity.CRACK_WIDTH: ("crack_width_change_mm", "crack_width_change_sigma_mm"),
}


def list_called_states(track_states: pa.Table) -> list[CalledState]:
    """The rows of table ``track_states``."""
    return [
        CalledState(
            track_id=row["track_id"],
            campaign_id=row["campaign_id"],
            state=TrackState(row["track_state"]),
            evidence=StateEvidence(row["state_evidence"]),
            defect_id=row["defect_id"],
            previous_campaign=row["previous_campaign"],
            changes={
                quantity: (row[change], row[sigma])
                for quantity, (change, sigma) in _CHANGES.items()
                if row[change] is not None
            },
        )
        for row in list_rows(track_states)
    ]


def collect_measured_defects(
    records: Sequence[CampaignRecords], true_ids: Mapping[DefectKey, str | None]
) -> dict[DefectKey, MeasuredDefect]:
    """The defects of all campaigns.

    Args:
        records: the campaigns, in one site frame.
        true_ids: the true defect that each defect shows; None, or no entry: it shows none.
    """
    found: dict[DefectKey, MeasuredDefect] = {}
    for one in records:
        defects = one.tracked.defects
        sizes = {quantity: np.exp(size.log_size).tolist() for quantity, size in one.sizes.items()}
        for row, defect_id in enumerate(defects.defect_id.tolist()):
            key = (one.campaign_id, defect_id)
            found[key] = MeasuredDefect(
                xyz_site_m=defects.xyz_site_m[row],
                true_id=true_ids.get(key),
                sizes={quantity: values[row] for quantity, values in sizes.items() if np.isfinite(values[row])},
            )
    return found
