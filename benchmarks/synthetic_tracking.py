"""Tracking of drawn histories by the product (``facadelake.tracking``); looks say what the recipe's rates draw."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.synthetic_history import BUILDING, ORIGIN, SyntheticHistory
from facadelake.evaluation.history import (
    HistoryComparison,
    collect_measured_defects,
    compare_histories,
    list_called_states,
)
from facadelake.tracking import (
    HistoryTables,
    KnownHistory,
    LinkedHistory,
    Look,
    LookRequest,
    build_history_tables,
    link_history,
    list_look_requests,
)
from schemas.tables import LAKE_TABLES
from schemas.vocabulary import LookVerdict

_RULES = Path(__file__).resolve().parent.parent / "data" / "severity" / "width_and_extent_v1.sql"


def track_synthetic(history: SyntheticHistory, seed: int) -> HistoryComparison:
    """Track a drawn history with drawn looks, and compare it with truth."""
    linked = link_history(history.records, history.recipe.area_m2)
    looks = draw_looks(history, list_look_requests(linked), seed)
    tables = build_tables(linked, looks).tables
    return compare_histories(
        history.campaigns,
        history.truth,
        collect_measured_defects(history.records, history.true_ids),
        list_called_states(tables["track_states"]),
    )


def build_tables(linked: LinkedHistory, looks: Sequence[Look]) -> HistoryTables:
    """The tables of a drawn history that nothing is known of before."""
    empty = {name: LAKE_TABLES[name].arrow.empty_table() for name in ("tracks", "track_states", "track_reviews")}
    known = KnownHistory(tracks=empty["tracks"], states=empty["track_states"], reviews=empty["track_reviews"])
    return build_history_tables(
        BUILDING, linked, {look.key: look for look in looks}, known, origin=ORIGIN, rule_file=_RULES
    )


def draw_looks(history: SyntheticHistory, requests: Sequence[LookRequest], seed: int) -> list[Look]:
    """What looks say, by the recipe's rates. The wall behind a false detection does not change."""
    rng = np.random.default_rng([seed, 1])
    rates, number = history.recipe.looks, {name: k for k, name in enumerate(history.campaigns)}
    looks = []
    for request in requests:
        true_id = history.true_ids[request.seen_campaign, request.defect_id]
        days = None if true_id is None else history.truth[true_id]
        day = None if days is None else days[number[request.campaign_id]]
        then = None if days is None else days[number[request.seen_campaign]]
        imaged = rng.random() < history.recipe.imaged_share if day is None else day.imaged
        draw = rng.random()
        if not imaged:
            verdict = LookVerdict.HIDDEN if draw < rates.hidden else LookVerdict.NOT_IN_VIEW
        elif day is None or then is None or (day.exists and day.width_m == then.width_m):
            verdict = _choose_verdict(draw, rates.there_same, rates.there_gone)
        elif day.exists:
            verdict = _choose_verdict(draw, rates.changed_same, rates.changed_gone)
        else:
            verdict = _choose_verdict(draw, rates.gone_same, rates.gone_gone)
        looks.append(Look(key=request.key, verdict=verdict, photo_ids=(None, None), photo_counts=(3, 3)))
    return looks


def _choose_verdict(draw: float, same: float, gone: float) -> LookVerdict:
    if draw < same:
        return LookVerdict.SAME
    return LookVerdict.GONE if draw < same + gone else LookVerdict.UNDECIDED
