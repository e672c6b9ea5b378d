"""Memory that inspections take, and which of them start beside each other."""

from __future__ import annotations

from pathlib import Path

import pytest

from facadelake.registry import RunLimits
from facadelake.scheduling.memory_need import (
    CampaignSize,
    MeasuredRun,
    MemoryNeed,
    estimate_memory,
    find_memory_need,
    parse_peak,
)
from facadelake.scheduling.plan import WaitingCampaign
from facadelake.scheduling.side_by_side import InspectionLimits, choose_startable, find_limits

SMALL = CampaignSize(photographs=29, largest_px=1536 * 1024)


@pytest.mark.parametrize(
    ("photographs", "largest_px", "measured_mib"),
    [
        # Peaks of table runs and of docs/figures.md, on two cores.
        (23, 1280 * 960, 1637),
        (43, 1600 * 1200, 2261),
        (29, 1536 * 1024, 1452),
        (29, 3008 * 2000, 2105),
        (300, 4000 * 3000, 1800 + 950),  # adjustment beside the process
        (1000, 4000 * 3000, 5700 + 950),
    ],
)
def test_the_estimate_is_above_what_was_measured_and_below_twice_it(
    photographs: int, largest_px: int, measured_mib: float
) -> None:
    size = CampaignSize(photographs=photographs, largest_px=largest_px)
    assert measured_mib < estimate_memory(size, max_image_px=3200, threads=2) < 2 * measured_mib


def need(size: CampaignSize, runs: list[MeasuredRun], killed_at_mib: float | None = None) -> MemoryNeed:
    return find_memory_need(size, runs, max_image_px=3200, threads=2, killed_at_mib=killed_at_mib)


def test_measured_runs_count_before_the_estimate_and_a_larger_campaign_takes_more() -> None:
    runs = [MeasuredRun(peak_mib=peak, size=SMALL) for peak in (9000, 1400, 1500, 1450)]
    assert need(SMALL, runs) == MemoryNeed(mib=pytest.approx(1950), basis="measured in 3 run(s) of the building")
    larger = CampaignSize(photographs=1000, largest_px=20_000_000)
    assert need(larger, runs).mib > 1950 + 4000
    assert need(SMALL, [], killed_at_mib=4096) == MemoryNeed(mib=6144, basis="was killed at 4.0 GiB before")
    assert need(SMALL, [], killed_at_mib=100).basis == "estimated for 29 photographs of up to 1.6 megapixels"


def test_a_run_from_the_cache_measures_nothing() -> None:
    assert parse_peak('{"ingest": 950, "reconstruct": 1450}') == 1450
    assert parse_peak('{"measure": 900}') is None


def waiting(*named: tuple[str, float]) -> list[WaitingCampaign]:
    return [
        WaitingCampaign(
            building_id=building,
            campaign_id=f"{number}",
            reason="new",
            priority="normal",
            legal_overdue=False,
            captured_from=None,
            photographs=1,
            need=MemoryNeed(mib=mib, basis=""),
            fingerprint="",
        )
        for number, (building, mib) in enumerate(named)
    ]


def test_campaigns_start_within_memory_and_number_and_those_of_a_building_one_after_another() -> None:
    limits = InspectionLimits(memory_mib=10, side_by_side=3)
    one, two, three, four = waiting(("a", 4), ("a", 4), ("b", 5), ("c", 2))
    assert choose_startable([one, two, three, four], [], limits) is one
    assert choose_startable([two, three, four], [one], limits) is three  # a is busy
    assert choose_startable([two, four], [one, three], limits) is None  # no memory
    assert choose_startable([two, four], [three], limits) is two
    assert choose_startable([four], [one, two, three], InspectionLimits(memory_mib=100, side_by_side=3)) is None
    large, small = waiting(("a", 9), ("b", 1))
    assert choose_startable([large, small], [four], limits) is None  # a smaller one does not overtake


def test_limits_are_those_of_the_settings_else_of_machine_and_container(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert find_limits(RunLimits(memory_gib=3, side_by_side=5)) == InspectionLimits(memory_mib=3072, side_by_side=5)
    (tmp_path / "memory.max").write_text(f"{2 * 2**30}\n")
    (tmp_path / "memory.current").write_text(f"{2**30}\n")
    monkeypatch.setattr("facadelake.scheduling.side_by_side._CGROUP", tmp_path)
    found = find_limits(RunLimits())
    assert found.memory_mib <= 0.8 * 1024
    assert found.side_by_side >= 1
