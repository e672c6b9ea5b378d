"""The states that an observer without error gives a true defect: the rule that truth of every layout is judged by.

- A defect is known by its first detection. Looks back can tell that it was there in the campaigns before, but not what
  was before a campaign that imaged its place without it: until that campaign there is no state.
- The first campaign after it that imaged the defect: ``new`` where there is such an earlier campaign; else
  ``first_seen``.
- Later, a place that is not imaged is ``not_imaged``, whatever is there; imaged without the defect it is ``repaired``,
  in the campaign that finds it gone and in each later one as long as it stays gone.
- Imaged and there it is ``reopened`` where the last campaign that imaged it found it gone. Else ``grown`` or
  ``shrunk`` where its size is another than in the last campaign that *detected* it, as a change is defined between two
  detections; and ``seen`` where it is the same. A change of class is no change of state.
- A change of size cannot be told without two detections: where the campaign has none, or none is before it, ``seen`` is
  right beside ``grown`` and ``shrunk``.

``not_found`` is never right: it is what is said of a defect that is there, imaged, and was not found.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from facadelake.core.errors import InputDataError
from facadelake.evaluation.history.truth import TrueDefect
from schemas.vocabulary import TrackState

# States of a defect that is there and imaged.
PRESENT = frozenset(
    {
        TrackState.NEW,
        TrackState.FIRST_SEEN,
        TrackState.SEEN,
        TrackState.GROWN,
        TrackState.SHRUNK,
        TrackState.REOPENED,
    }
)
_SIZE_TOLERANCE = 1e-3  # of the logarithm of a true size


def list_right_states(history: Sequence[TrueDefect], detected: Sequence[bool]) -> list[tuple[TrackState, ...]]:
    """The right states of one defect in each campaign; empty where it is to have none.

    Args:
        history: the defect in every campaign, in order of capture.
        detected: whether the campaign has a detection of it.

    Returns:
        By campaign the states that are right, that of an observer without error first.
    """
    states: list[tuple[TrackState, ...]] = []
    compared: TrueDefect | None = None  # with which a size is compared
    detected_before = False
    imaged_before: TrueDefect | None = None
    begun, begin = False, _find_begin(history, detected)
    for number, (defect, is_detected) in enumerate(zip(history, detected, strict=True)):
        there = defect.exists and defect.imaged and number >= begin
        right: tuple[TrackState, ...]
        if not begun:
            right = () if not there else (TrackState.FIRST_SEEN if imaged_before is None else TrackState.NEW,)
        elif not defect.imaged:
            right = (TrackState.NOT_IMAGED,)
        elif not defect.exists:
            right = (TrackState.REPAIRED,)
        elif imaged_before is not None and not imaged_before.exists:
            right = (TrackState.REOPENED,)
        else:
            right = _judge_size(compared, defect, is_measured=is_detected and detected_before)
        states.append(right)
        begun = begun or there
        if there and (is_detected or not detected_before):
            compared = defect
            detected_before = is_detected
        if defect.imaged:
            imaged_before = defect
    return states


def check_stated_states(history: Sequence[TrueDefect]) -> None:
    """Check the states that truth states of one defect against this module's rule, where all campaigns detect it.

    Raises InputDataError where they differ: then one of the columns of truth is wrong.
    """
    derived = list_right_states(history, [True] * len(history))
    for defect, right in zip(history, derived, strict=True):
        if defect.stated is not None and defect.stated not in right:
            raise InputDataError(
                f"truth states '{defect.stated}' of {defect.true_id} in {defect.campaign_id}, but by its other columns "
                f"(exists, imaged, size, in all campaigns until then) it is {right[0] if right else 'no state'}; "
                "correct one of them"
            )


def compute_size_factor(before: TrueDefect, after: TrueDefect) -> float:
    """Factor of the true length (diagonal) between two campaigns; NaN where it exists in one alone."""
    if not (before.exists and after.exists):
        return math.nan
    return math.hypot(after.width_m, after.height_m) / math.hypot(before.width_m, before.height_m)


def _find_begin(history: Sequence[TrueDefect], detected: Sequence[bool]) -> int:
    """The campaign after the last one before the first detection that imaged the place without the defect."""
    known = [one.exists and one.imaged and is_detected for one, is_detected in zip(history, detected, strict=True)]
    first = known.index(True) if True in known else len(history)
    gone = [number for number in range(first) if history[number].imaged and not history[number].exists]
    return gone[-1] + 1 if gone else 0


def _judge_size(compared: TrueDefect | None, now: TrueDefect, *, is_measured: bool) -> tuple[TrackState, ...]:
    change = 0.0 if compared is None else math.log(compute_size_factor(compared, now))
    if abs(change) <= _SIZE_TOLERANCE:
        return (TrackState.SEEN,)
    changed = TrackState.GROWN if change > 0 else TrackState.SHRUNK
    return (changed,) if is_measured else (changed, TrackState.SEEN)
