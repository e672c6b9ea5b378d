"""IDF1 and identity switches of tracks, by motmetrics: campaigns are its frames.

Source: Ristani et al. 2016, Performance measures and a data set for multi-target, multi-camera tracking, for IDF1.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass

import motmetrics
import numpy as np

from facadelake.evaluation.history.comparison import HistoryComparison
from facadelake.evaluation.history.expected_states import PRESENT


@dataclass(frozen=True, kw_only=True)
class IdentityFigures:
    """``idf1`` with its precision and recall, and the number of identity switches; None without objects.

    ``objects``: true defects, each once in every campaign that it is counted in.
    """

    objects: int
    idf1: float | None
    precision: float | None
    recall: float | None
    switches: int

    def convert_to_json(self) -> dict[str, float | int | None]:
        """The fields as keys."""
        return asdict(self)


def measure_identity(compared: HistoryComparison) -> IdentityFigures:
    """Identity of the defects that the campaigns detected: each is one object, and its track the hypothesis.

    A false detection is an object of its own in its campaign: to give it the track of another defect is a fault.
    """
    track_of_defect = {
        (row.campaign_id, row.defect_id): row.track_id for row in compared.called if row.defect_id is not None
    }
    frames: dict[str, set[tuple[str, str | None]]] = {campaign: set() for campaign in compared.campaigns}
    for (campaign, defect_id), measured in compared.defects.items():
        name = f"true {measured.true_id}" if measured.true_id is not None else f"false {campaign} {defect_id}"
        frames[campaign].add((name, track_of_defect.get((campaign, defect_id))))
    return _measure(frames[campaign] for campaign in compared.campaigns)


def measure_identity_of_all(compared: HistoryComparison) -> IdentityFigures:
    """Identity of all true defects where they are there and imaged, against every state that says that a defect is.

    The detector's misses and false detections count, and so does what the looks recover of them.
    """
    true_id_of_track = {track: true_id for true_id, track in compared.track_of.items()}
    frames: dict[str, set[tuple[str | None, str | None]]] = {campaign: set() for campaign in compared.campaigns}
    for row in compared.called:
        if row.state in PRESENT:
            measured = compared.defects.get((row.campaign_id, row.defect_id or ""))
            true_id = true_id_of_track.get(row.track_id) if measured is None else measured.true_id
            frames[row.campaign_id].add((true_id, row.track_id))
    for number, campaign in enumerate(compared.campaigns):
        there = {
            true_id for true_id, history in compared.truth.items() if history[number].exists and history[number].imaged
        }
        frames[campaign] = {(name if name in there else None, track) for name, track in frames[campaign]}
        frames[campaign] |= {(name, None) for name in there}
    return _measure(frames[campaign] for campaign in compared.campaigns)


def _measure(frames: Iterable[Iterable[tuple[str | None, str | None]]]) -> IdentityFigures:
    """Figures of (object, hypothesis) pairs by frame; one of a pair may be missing."""
    objects, hypotheses = _Numbers(), _Numbers()
    events = motmetrics.MOTAccumulator(auto_id=True)
    for pairs in frames:
        listed = sorted(pairs, key=lambda pair: (pair[0] or "", pair[1] or ""))
        names = sorted({name for name, _ in listed if name is not None})
        tracks = sorted({track for _, track in listed if track is not None})
        distance = np.full((len(names), len(tracks)), np.nan)
        for name, track in listed:
            if name is not None and track is not None:
                distance[names.index(name), tracks.index(track)] = 0.0
        events.update(
            [objects.assign_number(name) for name in names],
            [hypotheses.assign_number(track) for track in tracks],
            distance,
        )
    wanted = ["num_objects", "idf1", "idp", "idr", "num_switches"]
    found: Mapping[str, Sequence[float]] = motmetrics.metrics.create().compute(events, metrics=wanted).to_dict("list")

    def read(name: str) -> float | None:
        value = float(found[name][0])
        return value if np.isfinite(value) else None

    return IdentityFigures(
        objects=int(found["num_objects"][0]),
        idf1=read("idf1"),
        precision=read("idp"),
        recall=read("idr"),
        switches=int(found["num_switches"][0]),
    )


class _Numbers(dict[str, int]):
    """Numbers of names: motmetrics compares ids as numbers."""

    def assign_number(self, name: str) -> int:
        return self.setdefault(name, len(self) + 1)
