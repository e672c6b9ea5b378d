"""Disagreements of the placement checks that the portfolio accepts, by statement, up to a limit and with a reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from facadelake.georeferencing.placement_checks import PlacementCheck
from facadelake.registry import AcceptedStatement
from schemas.vocabulary import PlacementCheckOutcome


def accept_statements(
    checks: Sequence[PlacementCheck], accepted: Sequence[AcceptedStatement]
) -> tuple[PlacementCheck, ...]:
    """The checks, with the outcome ``accepted`` where the portfolio accepts a disagreement; beyond its limit it stays.

    Either is told in the check's ``detail``, with the portfolio's reason.
    """
    return tuple(_accept(check, accepted) if check.disagrees else check for check in checks)


def _accept(check: PlacementCheck, accepted: Sequence[AcceptedStatement]) -> PlacementCheck:
    named = [one for one in accepted if one.statement == check.statement]
    within = [one for one in named if _is_within(check, one)]
    if within:
        said = f"; accepted by accept_placement ({_describe_limit(within[0])}): {within[0].reason}"
        return replace(check, outcome=PlacementCheckOutcome.ACCEPTED, detail=check.detail + said)
    if named:
        return replace(check, detail=f"{check.detail}; accept_placement accepts {_describe_limit(named[0])} only")
    return check


def _is_within(check: PlacementCheck, accepted: AcceptedStatement) -> bool:
    if check.unit == "m":
        return accepted.deviation_max_m is not None and check.deviation <= accepted.deviation_max_m
    return accepted.share_min is not None and check.deviation >= accepted.share_min


def _describe_limit(accepted: AcceptedStatement) -> str:
    if accepted.share_min is not None:
        return f"a share down to {accepted.share_min:.0%}"
    return f"up to {accepted.deviation_max_m:g} m"
