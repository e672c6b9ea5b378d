"""Columns of table ``tracks`` that say how a defect grows, and when it reaches the next limit of its rule pack."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.tracking.campaign_defects import CLASSES
from facadelake.tracking.linked import YEAR, LinkedHistory
from facadelake.tracking.next_limit import NextLimit, find_next_limits
from facadelake.tracking.size_pairs import TESTED
from facadelake.tracking.trend import HORIZON_YEARS, Trend, fit_trend, predict_limit
from schemas.vocabulary import DefectClass, TrendQuantity

_EPOCH = datetime(2000, 1, 1, tzinfo=UTC)
_UNITS = {TrendQuantity.LENGTH: "m", TrendQuantity.AREA: "m2", TrendQuantity.CRACK_WIDTH: "mm"}
_LIMITS_AT_A_TIME = 500  # defects, each with a hundred sizes


@dataclass(frozen=True, kw_only=True)
class _ChainTrend:
    quantity: TrendQuantity
    trend: Trend


def describe_trends(history: LinkedHistory, rule_file: Path) -> list[dict[str, Any]]:
    """The trend columns of each chain; ``trend_remark`` says what cannot be said, and why."""
    found = [_choose_trend(history, chain) for chain in range(len(history.sightings))]
    growing = [k for k, one in enumerate(found) if one is not None and one.trend.interval_per_year[0] > 0]
    limits = dict(zip(growing, _find_limits(history, growing, found, rule_file), strict=True)) if growing else {}
    return [_describe(one, limits.get(k), k in limits) for k, one in enumerate(found)]


def _choose_trend(history: LinkedHistory, chain: int) -> _ChainTrend | None:
    """The trend that differs from zero, else the first that there is."""
    sightings = [history.sightings[chain][k] for k in sorted(history.sightings[chain])]
    last = history.campaigns[sightings[-1].campaign].tracked.defects
    name = DefectClass(CLASSES[last.defect_class[sightings[-1].row]])
    # A crack that has spalled has its trend as a spall.
    sightings = [
        one
        for one in sightings
        if history.campaigns[one.campaign].tracked.defects.defect_class[one.row] == CLASSES.index(name)
    ]
    year = np.array([(history.campaigns[one.campaign].tracked.captured_at - _EPOCH) / YEAR for one in sightings])
    trends = []
    for quantity in TESTED[name]:
        places = [(history.campaigns[one.campaign].sizes[quantity], one.row) for one in sightings]
        known = [history.scales[key] for one in sightings if (key := (one.campaign, quantity)) in history.scales]
        scale = max(known, default=1.0)
        size = np.exp([sizes.log_size[row] for sizes, row in places])
        sigma = scale * size * np.array([sizes.sigma[row] for sizes, row in places])
        common = scale * np.array([sizes.common[row] for sizes, row in places])
        trend = fit_trend(year, size, sigma, common)
        if trend is not None:
            trends.append(_ChainTrend(quantity=quantity, trend=trend))
    return next((one for one in trends if np.prod(one.trend.interval_per_year) > 0), trends[0] if trends else None)


def _find_limits(
    history: LinkedHistory, chains: Sequence[int], found: Sequence[_ChainTrend | None], rule_file: Path
) -> list[NextLimit | None]:
    """The next limit of each of some chains, from its last detection."""
    limits: list[NextLimit | None] = [None] * len(chains)
    last = {chain: history.sightings[chain][max(history.sightings[chain])] for chain in chains}
    # All in one table: the rule pack is asked by a database of its own each time.
    order = sorted(range(len(chains)), key=lambda k: last[chains[k]].campaign)
    table = pa.concat_tables(
        history.campaigns[campaign].defect_table.take([last[chains[k]].row for k in places])
        for campaign, places in groupby(order, key=lambda k: last[chains[k]].campaign)
    )
    quantities = [one.quantity for k in order if (one := found[chains[k]]) is not None]
    for first in range(0, len(order), _LIMITS_AT_A_TIME):
        part = slice(first, first + _LIMITS_AT_A_TIME)
        next_limits = find_next_limits(table.slice(first, _LIMITS_AT_A_TIME), quantities[part], rule_file)
        for place, limit in zip(order[part], next_limits, strict=True):
            limits[place] = limit
    return limits


def _describe(one: _ChainTrend | None, limit: NextLimit | None, growing: bool) -> dict[str, Any]:
    if one is None:
        return {"trend_remark": "a trend needs three campaigns of different times that measured the defect"}
    low, high = one.trend.interval_per_year.tolist()
    columns = {
        "trend_quantity": one.quantity,
        "trend_per_year": one.trend.per_year,
        "trend_low_per_year": low,
        "trend_high_per_year": high,
        "trend_count": one.trend.campaigns,
    }
    columns = {**columns, **_describe_limit(one.trend, limit, growing)}
    remarks = (_describe_course(one), columns.get("trend_remark"))
    return {**columns, "trend_remark": "; ".join(remark for remark in remarks if remark) or None}


def _describe_course(one: _ChainTrend) -> str:
    """What is to be said where one straight line does not explain the sizes."""
    trend = one.trend
    if trend.is_line:
        return ""
    grows = trend.per_year > 0
    course = "its size does not follow a straight line"
    if grows and trend.per_year > trend.mean_per_year:
        course = "growth accelerates"
    elif trend.mean_per_year > 0 and trend.per_year < trend.mean_per_year:
        course = "growth slows down"
    unit = _UNITS[one.quantity]
    return f"{course}: {trend.per_year:.3g} {unit} a year lately, {trend.mean_per_year:.3g} {unit} a year over all"


def _describe_limit(trend: Trend, limit: NextLimit | None, growing: bool) -> dict[str, Any]:
    if not growing:
        return {"trend_remark": "no time of a next limit: the trend's interval includes no growth"}
    if limit is None:
        return {"trend_remark": "no time of a next limit: the rule pack gives no worse word for a larger size"}
    years = predict_limit(trend, limit.size)
    columns: dict[str, Any] = {"next_limit": limit.size, "next_severity": limit.severity}
    if years is None:
        return {**columns, "trend_remark": "no time of a next limit: the trend's interval includes no growth"}
    times = [_convert_year(year) for year in years.tolist()]
    if times[1] is None:
        return {**columns, "trend_remark": f"the limit is more than {HORIZON_YEARS:.0f} years away"}
    return {**columns, "next_limit_from": times[0], "next_limit_at": times[1], "next_limit_to": times[2]}


def _convert_year(year: float) -> datetime | None:
    """The day of a year since 2000; None where it is not within the horizon."""
    return _EPOCH + timedelta(days=round(year * 365.25)) if np.isfinite(year) else None
