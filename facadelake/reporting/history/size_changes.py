"""Changes of a track's size between two campaigns, summed over the campaigns between them, and sizes in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from schemas.vocabulary import CrackWidthOutcome, DefectClass, TrendQuantity

Row = Mapping[str, Any]
_COLUMNS = {
    TrendQuantity.LENGTH: ("length_change_m", "length_change_sigma_m"),
    TrendQuantity.AREA: ("area_change_m2", "area_change_sigma_m2"),
    TrendQuantity.CRACK_WIDTH: ("crack_width_change_mm", "crack_width_change_sigma_mm"),
}
_NAMES = {TrendQuantity.LENGTH: "length", TrendQuantity.AREA: "area", TrendQuantity.CRACK_WIDTH: "width"}


@dataclass(frozen=True, kw_only=True)
class TrackSizeChange:
    """Change of one quantity since the campaign ``since``, in the unit of the quantity's column, with one sigma.

    ``decisive``: it is the quantity whose change was significant.
    """

    quantity: TrendQuantity
    value: float
    sigma: float | None
    since: str
    decisive: bool

    def __str__(self) -> str:
        return f"{_NAMES[self.quantity]} {_format_change(self)}"


def sum_changes(states: Mapping[str, Row], names: Sequence[str], pair: tuple[str, str]) -> tuple[TrackSizeChange, ...]:
    """Changes from the detection in the earlier campaign, or the last one before it, to that in the later one.

    Each row of ``track_states`` has the change since the detection before. Over several campaigns they are summed, and
    so are the variances; the sum is too large then, because the detections between have their errors in two changes.

    Args:
        states: rows of ``track_states`` of the track by campaign.
        names: the building's campaigns in order.
        pair: the earlier and the later campaign.

    Returns:
        The decisive quantity first; empty where the later campaign has no detection with a change.
    """
    first = names.index(pair[0])
    steps: list[Row] = []
    row = states.get(pair[1])
    while row is not None and row["previous_campaign"] is not None:
        steps.append(row)
        if names.index(row["previous_campaign"]) <= first:
            break
        row = states.get(row["previous_campaign"])
    if not steps:
        return ()
    decisive = {step["changed_quantity"] for step in steps}
    changes = []
    for quantity, (value, sigma) in _COLUMNS.items():
        values = [step[value] for step in steps]
        sigmas = [step[sigma] for step in steps]
        if None not in values:
            changes.append(
                TrackSizeChange(
                    quantity=quantity,
                    value=math.fsum(values),
                    sigma=None if None in sigmas else math.hypot(*sigmas),
                    since=steps[-1]["previous_campaign"],
                    decisive=str(quantity) in decisive,
                )
            )
    return tuple(sorted(changes, key=lambda change: not change.decisive))


def select_main_changes(changes: Sequence[TrackSizeChange], defect_class: str) -> list[TrackSizeChange]:
    """The changes that describe a class: length and width of a crack, the area of others; decisive ones always."""
    usual = (
        {TrendQuantity.LENGTH, TrendQuantity.CRACK_WIDTH} if defect_class == DefectClass.CRACK else {TrendQuantity.AREA}
    )
    return [change for change in changes if change.decisive or change.quantity in usual]


def format_changes(changes: Sequence[TrackSizeChange], defect_class: str, earlier: str) -> str:
    """The main changes in words; a detection before the campaign ``earlier`` is named."""
    main = select_main_changes(changes, defect_class)
    text = ", ".join(str(change) for change in main)
    return f"{text} (since {main[0].since})" if main and main[0].since != earlier else text


def _format_change(change: TrackSizeChange) -> str:
    digits, unit, factor = {
        TrendQuantity.LENGTH: (0, "cm", 100.0),
        TrendQuantity.AREA: (0, "cm²", 1e4),
        TrendQuantity.CRACK_WIDTH: (1, "mm", 1.0),
    }[change.quantity]
    value = change.value * factor
    if change.sigma is None:
        return f"{value:+.{digits}f} {unit}"
    sigma = change.sigma * factor
    while 0 < sigma < 0.5 * 10**-digits:  # a sigma is never written as zero
        digits += 1
    return f"{value:+.{digits}f} ± {sigma:.{digits}f} {unit}"


def format_size(defect: Row | None) -> str:
    """Size of a row of ``defects`` in a few words; empty for none."""
    if defect is None:
        return ""
    if defect["defect_class"] != DefectClass.CRACK:
        return f"{100 * defect['width_m']:.0f} × {100 * defect['height_m']:.0f} cm"
    length = defect["length_m"]  # whose change is told, not crack_length_m
    text = f"{100 * length:.0f} cm" if length is not None else ""
    if defect["crack_width_mm"] is not None:
        return f"{text}, {defect['crack_width_mm']:.1f} mm wide".removeprefix(", ")
    limit = defect["crack_width_limit_mm"]
    if defect["crack_width_outcome"] == CrackWidthOutcome.BELOW_LIMIT and limit is not None:
        return f"{text}, < {limit:.1f} mm wide".removeprefix(", ")
    return text or f"{100 * defect['width_m']:.0f} × {100 * defect['height_m']:.0f} cm"
