"""States against truth: the confusion table, false repairs, and what looks recover of the detector's misses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from facadelake.evaluation.history.comparison import HistoryComparison, JudgedState
from facadelake.evaluation.history.expected_states import PRESENT
from schemas.vocabulary import TrackState

NO_STATE = "no state"  # where no row is due, or there is none
NO_DEFECT = "no defect"  # a track of false detections, or a second one of a defect


@dataclass(frozen=True, kw_only=True)
class StateFigures:
    """States against truth.

    ``confusion``: number of rows by (true, called). ``right`` of ``total`` rows of true defects are right.
    ``repaired``: rows called so, of which ``false_repaired`` are not repaired. ``missed``: rows of defects that are
    there, imaged and known from another campaign, but not detected; ``recovered``: those of them with a state that says
    that the defect is there.
    """

    confusion: Mapping[tuple[str, str], int]
    right: int
    total: int
    repaired: int
    false_repaired: int
    missed: int
    recovered: int

    @property
    def right_share(self) -> float | None:
        """Share of the rows of true defects whose state is right."""
        return divide(self.right, self.total)

    @property
    def false_repaired_share(self) -> float | None:
        """Share of the rows called repaired that are not."""
        return divide(self.false_repaired, self.repaired)

    @property
    def recovered_share(self) -> float | None:
        """Share of the detector's misses that the second look recovers."""
        return divide(self.recovered, self.missed)

    def convert_to_json(self) -> dict[str, object]:
        """Counts, shares and the confusion table as a list of records."""
        return {
            "right": self.right,
            "total": self.total,
            "right_share": self.right_share,
            "repaired": self.repaired,
            "false_repaired": self.false_repaired,
            "false_repaired_share": self.false_repaired_share,
            "missed_by_detector": self.missed,
            "recovered_by_look": self.recovered,
            "recovered_share": self.recovered_share,
            "confusion": [
                {"true": true, "called": called, "count": count}
                for (true, called), count in sorted(self.confusion.items())
            ],
        }


def divide(part: float, whole: float) -> float | None:
    """A share; None of nothing."""
    return part / whole if whole else None


def name_true_state(judged: JudgedState) -> str:
    """The true state for a table: of an observer without error, or that no row is due."""
    if judged.true_id is None:
        return NO_DEFECT
    return str(judged.right[0]) if judged.right else NO_STATE


def name_called_state(judged: JudgedState) -> str:
    """The called state for a table."""
    return NO_STATE if judged.called is None else str(judged.called.state)


def compute_state_figures(compared: HistoryComparison) -> StateFigures:
    """Count right and wrong states.

    Where two states are right, the confusion table counts the called one of them as true.
    """
    confusion: Counter[tuple[str, str]] = Counter()
    of_true = [one for one in compared.judged if one.true_id is not None]
    for one in compared.judged:
        called = name_called_state(one)
        confusion[called if one.is_right else name_true_state(one), called] += 1
    repaired = [one for one in compared.judged if name_called_state(one) == TrackState.REPAIRED]
    missed = [one for one in of_true if not one.detected and one.right and one.right[0] in PRESENT]
    return StateFigures(
        confusion=dict(confusion),
        right=sum(one.is_right for one in of_true),
        total=len(of_true),
        repaired=len(repaired),
        false_repaired=sum(not one.is_right for one in repaired),
        missed=len(missed),
        recovered=sum(one.called is not None and one.called.state in PRESENT for one in missed),
    )
