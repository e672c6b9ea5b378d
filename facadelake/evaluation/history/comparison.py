"""A building's history beside its truth: what is compared, whether it comes from a lake or was drawn."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment

from facadelake.core.arrays import Float64x3
from facadelake.evaluation.history.expected_states import list_right_states
from facadelake.evaluation.history.truth import TrueDefect
from schemas.vocabulary import StateEvidence, TrackState, TrendQuantity

DefectKey = tuple[str, str]  # campaign_id, defect_id


@dataclass(frozen=True, kw_only=True)
class MeasuredDefect:
    """A defect of a campaign: its place in site, the true defect that it shows (None: none), and its sizes."""

    xyz_site_m: Float64x3
    true_id: str | None
    sizes: Mapping[TrendQuantity, float]


@dataclass(frozen=True, kw_only=True)
class CalledState:
    """A row of ``track_states``. ``changes``: change since ``previous_campaign`` and its sigma, by quantity."""

    track_id: str
    campaign_id: str
    state: TrackState
    evidence: StateEvidence
    defect_id: str | None = None
    previous_campaign: str | None = None
    changes: Mapping[TrendQuantity, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class JudgedState:
    """A state beside the right ones (those of an observer without error first; none: it should have no state).

    ``true_id`` is None for a track that is of no true defect, or of one that has another track. ``called`` is None
    where the history has no row. ``detected``: whether the campaign has a detection of the true defect.
    """

    campaign_id: str
    true_id: str | None
    track_id: str | None
    right: tuple[TrackState, ...]
    called: CalledState | None
    detected: bool

    @property
    def is_right(self) -> bool:
        """Whether the called state is one of the right ones."""
        return (self.called.state in self.right) if self.called is not None else not self.right


@dataclass(frozen=True, kw_only=True, eq=False)
class HistoryComparison:
    """States and measured defects of a building beside truth.

    ``campaigns`` in order of capture. ``truth``: each true defect in every campaign, by its id. ``track_of``: the track
    of each true defect that has one; ``judged``: every row of either side, once. ``never_detected``: true defects that
    were there and imaged, but that no campaign detected, so that there is nothing to track.
    """

    campaigns: tuple[str, ...]
    truth: Mapping[str, Sequence[TrueDefect]]
    defects: Mapping[DefectKey, MeasuredDefect]
    called: Sequence[CalledState]
    track_of: Mapping[str, str]
    judged: Sequence[JudgedState]
    never_detected: tuple[str, ...]


def compare_histories(
    campaigns: Sequence[str],
    truth: Mapping[str, Sequence[TrueDefect]],
    defects: Mapping[DefectKey, MeasuredDefect],
    called: Sequence[CalledState],
) -> HistoryComparison:
    """Compare the states of a building's tracks with truth.

    A true defect has at most one track, and a track at most one true defect: those pairs that share most detections.

    Args:
        campaigns: the campaigns in order of capture.
        truth: each true defect in every campaign, by its id.
        defects: the defects of all campaigns.
        called: the states of all tracks.

    Returns:
        The comparison, for figures and pictures.
    """
    detected = {(key[0], one.true_id) for key, one in defects.items() if one.true_id is not None}
    track_of = _pair_tracks(called, defects)
    true_id_of = {track: true_id for true_id, track in track_of.items()}
    by_row = {(one.track_id, one.campaign_id): one for one in called}
    judged: list[JudgedState] = []
    never = []
    for true_id, history in truth.items():
        flags = [(campaign, true_id) in detected for campaign in campaigns]
        if true_id not in track_of:
            if any(one.exists and one.imaged for one in history):
                never.append(true_id)
            continue
        for campaign, right, flag in zip(campaigns, list_right_states(history, flags), flags, strict=True):
            row = by_row.get((track_of[true_id], campaign))
            if right or row is not None:
                judged.append(
                    JudgedState(
                        campaign_id=campaign,
                        true_id=true_id,
                        track_id=track_of[true_id],
                        right=right,
                        called=row,
                        detected=flag,
                    )
                )
    for row in called:
        if row.track_id not in true_id_of:
            judged.append(
                JudgedState(
                    campaign_id=row.campaign_id,
                    true_id=None,
                    track_id=row.track_id,
                    right=(),
                    called=row,
                    detected=False,
                )
            )
    return HistoryComparison(
        campaigns=tuple(campaigns),
        truth=truth,
        defects=defects,
        called=called,
        track_of=track_of,
        judged=judged,
        never_detected=tuple(never),
    )


def _pair_tracks(called: Sequence[CalledState], defects: Mapping[DefectKey, MeasuredDefect]) -> dict[str, str]:
    """The track of each true defect; of equally many shared detections, the first by name."""
    shared: Counter[tuple[str, str]] = Counter()
    for row in called:
        if row.defect_id is not None:
            measured = defects.get((row.campaign_id, row.defect_id))
            if measured is not None and measured.true_id is not None:
                shared[measured.true_id, row.track_id] += 1
    if not shared:
        return {}
    true_ids, tracks = (sorted({pair[side] for pair in shared}) for side in (0, 1))
    gain = np.zeros((len(true_ids), len(tracks)))
    for (true_id, track), count in shared.items():
        gain[true_ids.index(true_id), tracks.index(track)] = count
    rows, columns = linear_sum_assignment(gain, maximize=True)
    return {true_ids[i]: tracks[j] for i, j in zip(rows.tolist(), columns.tolist(), strict=True) if gain[i, j] > 0}
