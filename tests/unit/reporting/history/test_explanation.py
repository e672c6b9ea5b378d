from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from facadelake.core.errors import InputDataError
from facadelake.reporting.history.explanation import explain_rows, explain_track
from facadelake.reporting.history.findings import Finding
from tests.sql.small_history import commit_history
from tests.unit.reporting.history.painted_history import History

KEY = {"building_id": "wall", "campaign_id": "2026", "run_id": "2026", "track_id": "wall-0001"}


def make_history() -> History:
    history = History()
    states = {"2024": "first_seen detected", "2025": "repaired looks_repaired", "2026": "reopened detected"}
    history.add("wall-0001", states, storey="Ground <floor>")
    figures = {"fading_extent": 0.62, "fading_sigmas": 9.1, "contrast_difference": 1.1, "contrast_left": 0.08}
    history.look("wall-0001", "2025", "2024", "gone", **figures, look_cell_mm=2.5)
    history.change("wall-0001", "2026", previous_campaign="2024", years_since_previous=2.5, length_change_m=0.1,
                   length_change_sigma_m=0.04, match_probability=0.9996)  # fmt: skip
    history.rows["track_candidates"] = [
        KEY | {"defect_id": "wall-0001-in-2026", "displacement_m": 0.013, "mahalanobis_distance": 0.8,
               "log_odds": 16.2, "match_probability": 0.9996, "matched": True},
        KEY | {"defect_id": "other", "displacement_m": 0.31, "mahalanobis_distance": 3.4, "log_odds": -1.9,
               "match_probability": 0.0001, "matched": False},
    ]  # fmt: skip
    history.rows["track_reviews"] = [
        KEY | {"review_id": "r", "track_state": "reopened", "reviewer": "Ms Wall", "note": "seen on site",
               "reviewed_at": datetime(2026, 11, 2, tzinfo=UTC)}
    ]  # fmt: skip
    return history


def explain(history: History) -> dict[str, str]:
    explained = explain_rows(history.tables, "wall-0001")
    return {campaign.campaign_id: "\n".join(campaign.lines) for campaign in explained.campaigns}


def test_each_campaign_tells_what_it_rests_on() -> None:
    history = make_history()
    explained = explain_rows(history.tables, "wall-0001")
    assert [campaign.finding for campaign in explained.campaigns] == [
        Finding.FIRST_SEEN, Finding.REPAIRED, Finding.REOPENED,
    ]  # fmt: skip
    told = explain(history)
    assert "the first campaign: later ones are compared in its frame" in told["2024"]
    assert "no defect of this campaign lies near enough to be the same one" in told["2025"]
    assert "the wall is recognised, and the defect's look is not there" in told["2025"]
    assert "similarity of all within the defect's extents 0.07" in told["2025"]
    assert "of the wall around it 0.83" in told["2025"]
    assert "62 % of the defect's diagonal, 9.1 times what differs around the defect" in told["2025"]
    assert "contrast left within the extents: 8 %" in told["2025"]
    assert "cells of 2.5 mm" in told["2025"]
    # 2 cm of 2026 from the first campaign, less 1 cm of 2025: as a comparison of both tells it.
    assert "offset from those of 2025, the campaign before, by +1.0 ± 0.3 cm east" in told["2026"]
    assert "offset from those of 2024, the campaign before, by +1.0 ± 0.2 cm east" in told["2025"]
    assert "change since 2024 (40 cm) in 2.5 years, with one standard error: length +10 ± 4 cm" in told["2026"]
    assert "review of 2026-11-02 by Ms Wall: reopened: seen on site" in told["2026"]


def test_a_campaign_whose_frame_was_refused_is_none_to_compare_with() -> None:
    history = make_history()
    history.rows["frame_offsets"][1] |= {"offset_outcome": "refused", "detail": "its frame lies 0.52 m beside"}
    told = explain(history)
    assert "not tracked: its frame lies 0.52 m beside" in told["2025"]
    assert "candidates are compared without it" not in told["2025"]
    assert "offset from those of 2024, the campaign before, by +2.0 ± 0.2 cm east" in told["2026"]


def test_sizes_in_an_explanation_are_those_whose_difference_is_told() -> None:
    history = make_history()
    history.resize("wall-0001", "2024", merged=False, length_m=0.45)
    history.resize("wall-0001", "2026", merged=False, length_m=0.55)  # both merged defects are 40 cm long
    told = explain(history)
    assert "it is defect wall-0001-in-2024: crack, 45 cm" in told["2024"]
    assert "it is defect wall-0001-in-2026: crack, 55 cm" in told["2026"]
    assert "change since 2024 (45 cm) in 2.5 years, with one standard error: length +10 ± 4 cm" in told["2026"]


def test_a_change_of_class_is_no_unchanged_defect_and_a_spall_is_told_by_its_area() -> None:
    history = History()
    history.add("wall-0001", {"2024": "first_seen detected", "2025": "seen detected", "2026": "seen detected"})
    for campaign, area_m2 in (("2025", 0.08), ("2026", 0.09)):
        history.resize("wall-0001", campaign, defect_class="spalling", area_m2=area_m2)
        history.change("wall-0001", campaign, defect_class="spalling")
    history.change("wall-0001", "2025", previous_campaign="2024")
    history.change("wall-0001", "2026", previous_campaign="2025", length_change_m=0.01, length_change_sigma_m=0.03,
                   area_change_m2=0.01, area_change_sigma_m2=0.004)  # fmt: skip
    told = explain(history)
    assert "detected again, as spalling and no longer as crack; their sizes are not compared" in told["2025"]
    assert "no change beyond the errors" not in told["2025"]
    assert "change since 2025 (800 cm²), with one standard error: area +100 ± 40 cm²" in told["2026"]
    assert "length" not in told["2026"]


def test_candidates_are_told_in_odds_the_taken_one_first() -> None:
    lines = [line for line in explain(make_history())["2026"].splitlines() if line.startswith("candidate")]
    assert len(lines) == 2
    assert lines[0].startswith("candidate wall-0001-in-2026 (crack, 40 cm): 1.3 cm from the expected place")
    assert "0.8 times its uncertainty" in lines[0]
    assert "more than 1,000,000 to 1 for" in lines[0]  # exp(16.2) = 10.8 million
    assert lines[0].endswith("probability above 0.999: taken")
    assert "6.7 to 1 against" in lines[1]  # exp(1.9)
    assert lines[1].endswith("probability below 0.001: not taken")


def test_a_trend_is_told_with_its_interval_and_the_next_limit() -> None:
    history = make_history()
    history.rows["tracks"][0] |= {
        "trend_quantity": "crack_width_mm", "trend_per_year": 0.2, "trend_low_per_year": 0.1,
        "trend_high_per_year": 0.3, "trend_count": 3, "next_limit": 5.0, "next_severity": "moderate",
        "next_limit_from": datetime(2028, 1, 1, tzinfo=UTC), "next_limit_at": datetime(2030, 1, 1, tzinfo=UTC),
        "next_limit_to": None,
    }  # fmt: skip
    text = "\n".join(explain_rows(history.tables, "wall-0001").lines)
    assert "trend of the crack width over 3 campaigns: +0.2 mm a year (with 95 % probability +0.1 to +0.3)" in text
    assert "'moderate' at 5 mm, most likely 2030-01-01 (not before 2028-01-01, perhaps never)" in text


def test_without_a_lake_the_error_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match="there is no lake"):
        explain_track(tmp_path, "wall-0001", as_of=None)


@pytest.mark.parametrize("given", ["tower-001", "TOWER-0001", "towr-0001", "tower-1"])
def test_an_unknown_track_is_told_with_the_likeliest_one(given: str, tmp_path: Path) -> None:
    commit_history(tmp_path)
    with pytest.raises(InputDataError) as raised:
        explain_track(tmp_path, given, as_of=None)
    assert str(raised.value).startswith(
        f"the lake {tmp_path} has no track '{given}' (did you mean 'tower-0001'?); it has tower-0001, tower-0002, "
    )
