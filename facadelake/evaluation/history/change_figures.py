"""Changes of size against truth, and the offset between campaigns at defects that did not change."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise

import numpy as np

from facadelake.core.arrays import Float64x3
from facadelake.evaluation.history.comparison import HistoryComparison, JudgedState, MeasuredDefect
from facadelake.evaluation.history.expected_states import compute_size_factor
from facadelake.evaluation.history.state_figures import divide
from facadelake.evaluation.history.truth import TrueDefect
from schemas.vocabulary import TrackState, TrendQuantity

_UNCHANGED = 1e-3  # of the logarithm of a true size
_INSIDE_SIGMAS = 2.0


@dataclass(frozen=True, kw_only=True)
class SigmaFigures:
    """Changes of one quantity: ``count``, of which ``inside`` are within two sigma of the true change."""

    count: int
    inside: int

    @property
    def share(self) -> float | None:
        """Share inside two sigma."""
        return divide(self.inside, self.count)


@dataclass(frozen=True, kw_only=True)
class CampaignOffset:
    """Positions of unchanged defects in ``campaign_id`` minus those in ``before``, m in site.

    ``east_m``, ``north_m``, ``up_m``: their median; ``offset_m`` is its length, ``distance_m`` the median of theirs.
    """

    before: str
    campaign_id: str
    count: int
    east_m: float
    north_m: float
    up_m: float
    offset_m: float
    distance_m: float


@dataclass(frozen=True, kw_only=True)
class ChangeFigures:
    """Changes between two detections of a defect against truth.

    ``unchanged``: those of the same true size, of which ``false_changes`` are called grown or shrunk. ``changed``:
    those of another, of which ``found_changes`` are called so in the right direction. ``by_quantity``: errors of the
    change.
    """

    unchanged: int
    false_changes: int
    changed: int
    found_changes: int
    by_quantity: Mapping[TrendQuantity, SigmaFigures]
    offsets: Sequence[CampaignOffset]

    @property
    def false_share(self) -> float | None:
        """Share of the unchanged that are called grown or shrunk."""
        return divide(self.false_changes, self.unchanged)

    @property
    def found_share(self) -> float | None:
        """Share of the changed that are called so."""
        return divide(self.found_changes, self.changed)

    @property
    def inside_share(self) -> float | None:
        """Share of all changes, of every quantity, inside two sigma."""
        figures = self.by_quantity.values()
        return divide(sum(one.inside for one in figures), sum(one.count for one in figures))

    def convert_to_json(self) -> dict[str, object]:
        """Counts and shares."""
        return {
            "unchanged": self.unchanged,
            "false_changes": self.false_changes,
            "false_share": self.false_share,
            "changed": self.changed,
            "found_changes": self.found_changes,
            "found_share": self.found_share,
            "inside_2sigma": self.inside_share,
            "by_quantity": {
                str(name): {"n": one.count, "inside_2sigma": one.share} for name, one in self.by_quantity.items()
            },
            "offsets": [asdict(one) for one in self.offsets],
        }


def compute_change_figures(compared: HistoryComparison) -> ChangeFigures:
    """Compare changes with the true ones.

    The true change is the size measured before, times the true factor minus one: the extents of boxes exceed a defect's
    by a factor that both campaigns share. The width of a crack is compared where the defect did not change.
    """
    unchanged = false = changed = found = 0
    errors: dict[TrendQuantity, list[float]] = defaultdict(list)
    for judged, before, measured in _list_pairs(compared):
        now = _get_true(compared, judged.true_id, judged.campaign_id)
        factor = compute_size_factor(before, now)
        called = judged.called
        if called is None or not math.isfinite(factor):
            continue
        if abs(math.log(factor)) <= _UNCHANGED:
            unchanged += 1
            false += called.state in (TrackState.GROWN, TrackState.SHRUNK)
        else:
            changed += 1
            found += called.state == (TrackState.GROWN if factor > 1 else TrackState.SHRUNK)
        factors = {
            TrendQuantity.LENGTH: factor,
            TrendQuantity.AREA: now.width_m * now.height_m / (before.width_m * before.height_m),
            TrendQuantity.CRACK_WIDTH: 1.0 if abs(math.log(factor)) <= _UNCHANGED else math.nan,
        }
        for quantity, (change, sigma) in called.changes.items():
            true_change = measured.sizes.get(quantity, math.nan) * (factors[quantity] - 1)
            if math.isfinite(true_change):
                errors[quantity].append((change - true_change) / sigma)
    return ChangeFigures(
        unchanged=unchanged,
        false_changes=false,
        changed=changed,
        found_changes=found,
        by_quantity={
            quantity: SigmaFigures(
                count=len(errors[quantity]), inside=sum(abs(one) <= _INSIDE_SIGMAS for one in errors[quantity])
            )
            for quantity in TrendQuantity
            if errors[quantity]
        },
        offsets=_measure_offsets(compared),
    )


def _list_pairs(compared: HistoryComparison) -> Iterator[tuple[JudgedState, TrueDefect, MeasuredDefect]]:
    """Detected states with the true and the measured defect of the campaign that they are compared with; both
    detections show the true defect of the track."""
    defect_of = {(row.track_id, row.campaign_id): row.defect_id for row in compared.called}
    for judged in compared.judged:
        called = judged.called
        if judged.true_id is None or called is None or called.previous_campaign is None or called.defect_id is None:
            continue
        earlier = called.previous_campaign
        before = compared.defects.get((earlier, defect_of.get((called.track_id, earlier)) or ""))
        now = compared.defects.get((judged.campaign_id, called.defect_id))
        if before is not None and now is not None and before.true_id == now.true_id == judged.true_id:
            yield judged, _get_true(compared, judged.true_id, earlier), before


def _get_true(compared: HistoryComparison, true_id: str | None, campaign: str) -> TrueDefect:
    return compared.truth[true_id or ""][compared.campaigns.index(campaign)]


def _measure_offsets(compared: HistoryComparison) -> list[CampaignOffset]:
    """Offsets between each campaign and the one that detected a defect before, by true identity."""
    place: dict[str, dict[str, Float64x3]] = defaultdict(dict)
    for (campaign, _), measured in compared.defects.items():
        if measured.true_id is not None:
            place[measured.true_id].setdefault(campaign, measured.xyz_site_m)
    differences: dict[tuple[str, str], list[Float64x3]] = defaultdict(list)
    for true_id, places in place.items():
        detected = [campaign for campaign in compared.campaigns if campaign in places]
        for earlier, later in pairwise(detected):
            factor = compute_size_factor(*(_get_true(compared, true_id, campaign) for campaign in (earlier, later)))
            if math.isfinite(factor) and abs(math.log(factor)) <= _UNCHANGED:
                differences[earlier, later].append(places[later] - places[earlier])
    offsets = []
    for (earlier, later), listed in sorted(differences.items()):
        stacked = np.stack(listed)
        east, north, up = np.median(stacked, axis=0).tolist()
        offsets.append(
            CampaignOffset(
                before=earlier,
                campaign_id=later,
                count=len(listed),
                east_m=east,
                north_m=north,
                up_m=up,
                offset_m=math.hypot(east, north, up),
                distance_m=float(np.median(np.linalg.norm(stacked, axis=1))),
            )
        )
    return offsets
