"""Campaigns are in order of time, not of the text of their ids, and what none of them would have found is listed."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from facadelake.core.errors import InputDataError
from facadelake.lake.commit import commit_campaign
from facadelake.lake.questions import answer_question, find_latest_campaign
from facadelake.lake.read import query
from tests.unit.lake.small_campaign import BUILDING, INPUTS, commit, lake_tables

EARLIER, LATER = "z-2025", "2025-10"
TIMES = {EARLIER: datetime(2025, 4, 1, 8, tzinfo=UTC), LATER: datetime(2025, 10, 1, 8, tzinfo=UTC)}


@pytest.fixture
def lake(tmp_path: Path) -> Path:
    for campaign, start in TIMES.items():
        commit(tmp_path, campaign_id=campaign, start=start, defects=1)
    return tmp_path


def list_order(lake: Path) -> list[tuple]:
    rows = query(lake, "SELECT * FROM campaign_order ORDER BY campaign_number").to_pylist()
    return [(r["campaign_id"], r["campaign_number"], r["campaign_before"], r["is_latest"]) for r in rows]


def test_campaigns_are_in_order_of_time_and_without_capture_times_by_the_date_of_their_id(lake: Path) -> None:
    assert list_order(lake) == [(EARLIER, 1, None, False), (LATER, 2, EARLIER, True)]
    assert find_latest_campaign(lake, BUILDING) == LATER
    assert [row["campaign_id"] for row in answer_question(lake, "campaigns").to_pylist()] == [EARLIER, LATER]
    for campaign in ("2025-07-x", "2025"):
        commit(lake, campaign_id=campaign, start=None)
    assert [row[0] for row in list_order(lake)] == ["2025", EARLIER, "2025-07-x", LATER]
    with pytest.raises(InputDataError, match="has no campaign of building 'annex'"):
        find_latest_campaign(lake, "annex")


def test_a_part_is_covered_where_one_of_the_campaigns_would_have_found_the_crack(lake: Path) -> None:
    areas = ("surface_m2", "never_imaged_m2", "never_searched_m2", "too_coarse_m2", "unknown_m2")
    (row,) = answer_question(lake, "never_covered_for_crack", {"crack_width_mm": 1.0}).to_pylist()
    assert [row[name] for name in areas] == [5.0, 1.0, 1.0, 1.0, 1.0]
    made = lake_tables(campaign_id="2026-04", run_id="run-3")
    cells = made["coverage"].to_pylist()
    cells[0] |= {"found_crack_width_mm": 5.0}  # found 0.9 mm before
    cells[3] |= {"searched_count": 1, "found_crack_width_mm": 3.0}
    cells[4] |= {"imaged_count": 1, "searched_count": 1, "found_crack_width_mm": 0.8, "coverage_outcome": "imaged"}
    coverage = made["coverage"].from_pylist(cells, schema=made["coverage"].schema)
    commit_campaign(
        lake, building_id=BUILDING, campaign_id="2026-04", run_id="run-3", tables={**made, "coverage": coverage},
        inputs_sha256=INPUTS,
    )  # fmt: skip
    (row,) = answer_question(lake, "never_covered_for_crack", {"crack_width_mm": 1.0}).to_pylist()
    assert ([row[name] for name in areas], row["campaigns"]) == ([5.0, 0.0, 0.0, 2.0, 1.0], 3)
    (fine,) = answer_question(lake, "never_covered_for_crack").to_pylist()
    assert [fine[name] for name in areas] == [5.0, 0.0, 0.0, 4.0, 1.0]
