"""Questions of the portfolio: what an inspection found, and what inspections cost."""

from __future__ import annotations

import json
from datetime import datetime, timedelta
from pathlib import Path

import pyarrow as pa
import pytest

from facadelake.lake.commit import commit_campaign
from facadelake.lake.questions import answer_question
from facadelake.scheduling.committed import read_committed_buildings
from facadelake.scheduling.memory_need import CampaignSize, MeasuredRun
from tests.unit.lake.small_campaign import BUILDING, START, lake_tables


def commit(lake: Path, campaign_id: str, start: datetime, seconds: dict[str, float], peaks: dict[str, int]) -> None:
    tables = lake_tables(run_id=campaign_id, campaign_id=campaign_id, inputs=campaign_id * 9, start=start)
    runs = tables["runs"]
    changed = {"stage_seconds": json.dumps(seconds), "stage_peak_mib": json.dumps(peaks)}
    for name, value in changed.items():
        runs = runs.set_column(runs.schema.get_field_index(name), runs.schema.field(name), pa.array([value]))
    tables["runs"] = runs
    commit_campaign(
        lake, building_id=BUILDING, campaign_id=campaign_id, run_id=campaign_id, tables=tables,
        inputs_sha256=campaign_id * 9,
    )  # fmt: skip


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lake")
    whole = {"ingest": 1.0, "reconstruct": 9.0}
    commit(folder, "2025-04", START, whole, {"ingest": 900, "reconstruct": 1000})
    commit(folder, "2025-10", START + timedelta(days=180), {"measure": 2.0}, {"measure": 500})  # the rest was cached
    commit(folder, "2026-04", START + timedelta(days=365), {"ingest": 1.0, "reconstruct": 19.0}, {"ingest": 1500})
    return folder


def test_costs_are_compared_with_the_runs_before_that_read_their_photographs(lake: Path) -> None:
    first, cached, last = answer_question(lake, "run_costs", {"building_id": BUILDING}).to_pylist()
    photographs = first["photos_total"]
    assert [one["stages_s"] for one in (first, cached, last)] == [10, 2, 20]
    assert first["photos_per_s"] == pytest.approx(photographs / 10, abs=5e-4)  # rounded to 0.001
    assert [one["peak_mib"] for one in (first, cached, last)] == [1000, 500, 1500]
    assert [one["photos_per_s"] is None for one in (first, cached, last)] == [False, True, False]
    assert (first["speed_ratio"], cached["speed_ratio"], last["speed_ratio"]) == (None, None, 0.5)
    assert (first["peak_ratio"], cached["peak_ratio"], last["peak_ratio"]) == (None, None, 1.5)


def test_what_a_campaign_found_is_counted(lake: Path) -> None:
    (row,) = answer_question(lake, "campaign_outcome", {"building_id": BUILDING, "campaign_id": "2026-04"}).to_pylist()
    assert row["defects_total"] == 3
    assert row["worst_defects"] <= 3 and (row["worst_severity"] is None) == (row["worst_defects"] == 0)


def test_scheduling_reads_photographs_times_and_memory_of_the_lake(lake: Path, tmp_path: Path) -> None:
    building = read_committed_buildings(lake, [BUILDING, "unknown"])[BUILDING]
    assert list(building.campaigns) == ["2025-04", "2025-10", "2026-04"]
    photographs = building.campaigns["2025-04"].photographs
    size = CampaignSize(photographs=len(photographs), largest_px=1600 * 1200)
    assert building.list_measured_runs() == [
        MeasuredRun(peak_mib=1000, size=size),
        MeasuredRun(peak_mib=1500, size=size),
    ]
    assert {one.bytes for one in photographs.values()} >= {1000}
    captured, remarks = building.list_captured()
    assert [one.campaign_id for one in captured] == ["2025-04", "2025-10", "2026-04"] and remarks == []
    assert read_committed_buildings(tmp_path / "none", [BUILDING])[BUILDING].campaigns == {}
