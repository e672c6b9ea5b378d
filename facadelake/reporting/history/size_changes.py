"""Changes of a track's size between two detections, and sizes in words.

The sizes beside a change are those whose difference it is (``Detections``); the merged defects' may differ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from facadelake.tracking import SizeDifference, judge_growth
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
    """Change of one quantity between the detections in the campaigns ``since`` and ``until``, in the unit of the
    quantity's column, with one sigma.

    ``decisive``: it is the quantity whose change was significant.
    """

    quantity: TrendQuantity
    value: float
    sigma: float | None
    since: str
    until: str
    decisive: bool

    def __str__(self) -> str:
        return f"{_NAMES[self.quantity]} {_format_change(self)}"


def list_changes(
    changes: Mapping[TrendQuantity, SizeDifference], since: str, until: str
) -> tuple[TrackSizeChange, ...]:
    """Changes between the detections in two campaigns, the decisive quantity first."""
    decisive = judge_growth(changes)[1]
    found = [
        TrackSizeChange(
            quantity=quantity,
            value=change.change,
            sigma=change.sigma,
            since=since,
            until=until,
            decisive=quantity is decisive,
        )
        for quantity, change in changes.items()
    ]
    return tuple(sorted(found, key=lambda change: not change.decisive))


def read_changes(state: Row) -> tuple[TrackSizeChange, ...]:
    """Changes since the detection before, from a row of ``track_states``; the decisive quantity first."""
    if state["previous_campaign"] is None:
        return ()
    found = [
        TrackSizeChange(
            quantity=quantity,
            value=state[value],
            sigma=state[sigma],
            since=state["previous_campaign"],
            until=state["campaign_id"],
            decisive=state["changed_quantity"] == quantity,
        )
        for quantity, (value, sigma) in _COLUMNS.items()
        if state[value] is not None
    ]
    return tuple(sorted(found, key=lambda change: not change.decisive))


def select_main_changes(changes: Sequence[TrackSizeChange], defect_class: str) -> list[TrackSizeChange]:
    """The changes that describe a class: length and width of a crack, the area of others; decisive ones always."""
    usual = (
        {TrendQuantity.LENGTH, TrendQuantity.CRACK_WIDTH} if defect_class == DefectClass.CRACK else {TrendQuantity.AREA}
    )
    return [change for change in changes if change.decisive or change.quantity in usual]


def format_changes(changes: Sequence[TrackSizeChange], defect_class: str, pair: tuple[str, str]) -> str:
    """The main changes in words; detections in other campaigns than those of ``pair`` are named."""
    main = select_main_changes(changes, defect_class)
    text = ", ".join(str(change) for change in main)
    if not main:
        return text
    since, until = main[0].since, main[0].until
    told = ([f"since {since}"] if since != pair[0] else []) + ([f"until {until}"] if until != pair[1] else [])
    return f"{text} ({' '.join(told)})" if told else text


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
    """The sizes of a defect whose changes are told of its class, in a few words; empty for none.

    Args:
        defect: a defect of ``Detections``.
    """
    if defect is None:
        return ""
    if defect["defect_class"] != DefectClass.CRACK:
        return f"{1e4 * defect['area_m2']:.0f} cm²"
    length = defect["length_m"]  # whose change is told, not crack_length_m
    text = f"{100 * length:.0f} cm" if length is not None else ""
    if defect["crack_width_mm"] is not None:
        return f"{text}, {defect['crack_width_mm']:.1f} mm wide".removeprefix(", ")
    limit = defect["crack_width_limit_mm"]
    if defect["crack_width_outcome"] == CrackWidthOutcome.BELOW_LIMIT and limit is not None:
        return f"{text}, < {limit:.1f} mm wide".removeprefix(", ")
    return text or f"{100 * defect['width_m']:.0f} × {100 * defect['height_m']:.0f} cm"
