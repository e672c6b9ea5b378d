"""Whether an upload is complete: its marker is there, or nothing in it has changed for the quiet time."""

from __future__ import annotations

from dataclasses import dataclass

from facadelake.intake.answer import MarkerState, UploadAnswer
from facadelake.intake.observed_folders import ObservedFolder

# Once a person has put the marker, or answered, two passes at least so far apart have to see the same.
SETTLING_S = 60.0
_DAY_S = 86400.0


@dataclass(frozen=True, kw_only=True)
class Completeness:
    """Whether an upload is complete, or stalled; ``reason`` says what it waits for, else it is empty."""

    is_complete: bool
    is_stalled: bool = False
    reason: str = ""


def judge_quiet(
    observed: ObservedFolder, marker: MarkerState, *, quiet_s: float, stalled_days: float, is_answered: bool
) -> Completeness:
    """Whether nothing has changed for long enough, and the marker is there, before anything is read.

    Args:
        observed: what was observed of the upload's folder.
        marker: its marker.
        quiet_s: the quiet time of uploads without a marker.
        stalled_days: after which an upload that is not complete is told.
        is_answered: whether nothing but the answer of a person is new since it was examined.

    Returns:
        the judgement.
    """
    days = f"{stalled_days:g} days"
    if marker.missing:
        is_stalled = observed.quiet_s >= stalled_days * _DAY_S
        waits = f"its marker '{marker.missing}' is not there{marker.hint}"
        remedy = f", and nothing has changed for {days}: put a file '{marker.missing}' into it once it is whole"
        return Completeness(is_complete=False, is_stalled=is_stalled, reason=waits + (remedy if is_stalled else ""))
    needed_s = min(SETTLING_S, quiet_s) if marker.is_required or is_answered else quiet_s
    if observed.quiet_s >= needed_s:
        return Completeness(is_complete=True)
    waits = f"nothing has changed for {observed.quiet_s / 60:.0f} of {needed_s / 60:g} minutes"
    if observed.waited_s < stalled_days * _DAY_S:
        return Completeness(is_complete=False, reason=waits)
    return Completeness(
        is_complete=False,
        is_stalled=True,
        reason=f"it has not been without a change for {needed_s / 60:g} minutes in {days}: a program goes on writing "
        "into it; stop that, or move the photographs into a new folder",
    )


def judge_number(
    observed: ObservedFolder, answer: UploadAnswer, *, photographs: int, answer_file: str, stalled_days: float
) -> Completeness:
    """Whether there are as many photographs as a person said.

    Args:
        observed: what was observed of the upload's folder.
        answer: what the person said.
        photographs: the number of photographs.
        answer_file: where he said it.
        stalled_days: after which an upload that is not complete is told.

    Returns:
        the judgement.
    """
    if answer.photographs is None or photographs >= answer.photographs:
        return Completeness(is_complete=True)
    is_stalled = observed.quiet_s >= stalled_days * _DAY_S
    reason = f"{photographs} of the {answer.photographs} photographs that its {answer_file} says are there"
    if is_stalled:
        reason += f", and nothing has changed for {stalled_days:g} days: upload the rest, or correct the number"
    return Completeness(is_complete=False, is_stalled=is_stalled, reason=reason)
