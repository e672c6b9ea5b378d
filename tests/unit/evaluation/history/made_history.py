"""Hand-made histories: three campaigns and a few defects, with a track that is right for each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from facadelake.evaluation.history import (
    CalledState,
    HistoryComparison,
    HistoryFigures,
    MeasuredDefect,
    TrueDefect,
    compare_histories,
    compute_history_figures,
)
from schemas.vocabulary import DefectClass, StateEvidence, TrackState, TrendQuantity

CAMPAIGNS = ("2024", "2025", "2026")


def place(true_id: str, *days: str, size: Sequence[float] = (1.0, 1.0, 1.0)) -> list[TrueDefect]:
    """A defect by day: "there", "gone", "hidden" (there, not imaged) or "hidden gone"."""
    return [
        TrueDefect(
            true_id=true_id,
            campaign_id=campaign,
            defect_class=DefectClass.CRACK,
            exists="gone" not in day,
            imaged="hidden" not in day,
            width_m=3.0 * factor if "gone" not in day else 0.0,
            height_m=4.0 * factor if "gone" not in day else 0.0,
        )
        for campaign, day, factor in zip(CAMPAIGNS, days, size, strict=True)
    ]


TRUTH = {
    "D1": place("D1", "there", "there", "there"),
    "D2": place("D2", "gone", "there", "there", size=(0, 1.0, 1.4)),
    "D3": place("D3", "there", "gone", "there"),
    "D4": place("D4", "there", "hidden", "there"),
}
STATES = {
    "D1": ("first_seen", "seen", "seen"),
    "D2": (None, "new", "grown"),
    "D3": ("first_seen", "repaired", "reopened"),
    "D4": ("first_seen", "not_imaged", "seen"),
}
DETECTED = {
    (campaign, true_id)
    for true_id, history in TRUTH.items()
    for campaign, one in zip(CAMPAIGNS, history, strict=True)
    if one.exists and one.imaged
}


def detect(campaign: str, true_id: str | None, name: str = "", length_m: float = 5.5) -> MeasuredDefect:
    """A measured defect; boxes are a tenth longer than the true diagonal of 5 m."""
    return MeasuredDefect(
        xyz_site_m=np.array([float(CAMPAIGNS.index(campaign)) / 100, 0, 0]),
        true_id=true_id,
        sizes={TrendQuantity.LENGTH: length_m},
    )


def measured() -> dict[tuple[str, str], MeasuredDefect]:
    """Every defect that is there and imaged; the name of a campaign's defect is its true id."""
    return {
        (campaign, true_id): detect(campaign, true_id, length_m=7.7 if (campaign, true_id) == ("2026", "D2") else 5.5)
        for campaign, true_id in DETECTED
    }


def called() -> list[CalledState]:
    """The right states, with tracks T1 to T4."""
    rows = []
    for true_id, states in STATES.items():
        previous: str | None = None
        for campaign, state in zip(CAMPAIGNS, states, strict=True):
            if state is None:
                continue
            detected = (campaign, true_id) in DETECTED
            change = {TrendQuantity.LENGTH: (2.2 if state == "grown" else 0.1, 0.2)} if previous and detected else {}
            rows.append(
                CalledState(
                    track_id=f"T{true_id[1]}",
                    campaign_id=campaign,
                    state=TrackState(state),
                    evidence=StateEvidence.DETECTED if detected else StateEvidence.NOT_IN_VIEW,
                    defect_id=true_id if detected else None,
                    previous_campaign=previous if detected else None,
                    changes=change,
                )
            )
            previous = campaign if detected else previous
    return rows


def compare(
    rows: Sequence[CalledState] | None = None,
    defects: Mapping[tuple[str, str], MeasuredDefect] | None = None,
    truth: Mapping[str, Sequence[TrueDefect]] = TRUTH,
) -> HistoryComparison:
    return compare_histories(
        CAMPAIGNS, truth, measured() if defects is None else defects, called() if rows is None else rows
    )


def figures(
    rows: Sequence[CalledState] | None = None, defects: Mapping[tuple[str, str], MeasuredDefect] | None = None
) -> HistoryFigures:
    return compute_history_figures(compare(rows, defects))


def change(rows: Sequence[CalledState], track: str, campaign: str, **values: object) -> list[CalledState]:
    """The rows with some values of one row replaced."""
    return [
        replace(row, **values) if (row.track_id, row.campaign_id) == (track, campaign) else row  # type: ignore[arg-type]
        for row in rows
    ]
