"""Trend columns of tracks: days are days, and growth that is no line says so."""

from __future__ import annotations

from benchmarks.synthetic_history import HistoryRecipe, draw_history
from benchmarks.synthetic_tracking import build_tables, draw_looks
from facadelake.tracking import link_history, list_look_requests

GROWING = HistoryRecipe(
    defects=40, campaigns=4, recall=1.0, false_share=0.0, repaired_share=0.0, grown_share=0.5, growth=1.6,
    box_sigma=0.02, other_class_share=0.0,
)  # fmt: skip


def test_days_are_days_and_words_say_how_growth_goes() -> None:
    history = draw_history(GROWING, 0)
    linked = link_history(history.records, GROWING.area_m2)
    tracks = build_tables(linked, draw_looks(history, list_look_requests(linked), 0)).tables["tracks"].to_pylist()
    days = [track[f"next_limit_{name}"] for track in tracks for name in ("from", "at", "to")]
    known = [day for day in days if day is not None]
    assert known and all((day.hour, day.minute, day.second, day.microsecond) == (0, 0, 0, 0) for day in known)
    remarks = [track["trend_remark"] or "" for track in tracks]
    accelerated = [one for one in remarks if one.startswith("growth accelerates: ")]
    assert accelerated and all(" a year lately, " in one and " a year over all" in one for one in accelerated)
    assert any(one.startswith("growth slows down: ") for one in remarks)
    for track in tracks:
        if (track["trend_remark"] or "").startswith("growth accelerates"):
            assert track["trend_low_per_year"] < track["trend_per_year"] < track["trend_high_per_year"]
