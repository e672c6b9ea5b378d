"""Which campaigns wait, in which order, what is left out and why."""

from __future__ import annotations

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import yaml
from PIL import Image

from facadelake.registry import Portfolio, read_portfolio
from facadelake.scheduling.building_log import read_building_log, write_building_log
from facadelake.scheduling.committed import CommittedBuilding, CommittedCampaign
from facadelake.scheduling.photograph_files import CommittedPhotograph, list_photograph_files
from facadelake.scheduling.plan import PortfolioPlan, describe_recent_change, plan_portfolio

NOW = datetime(2026, 5, 1, 2, 0, tzinfo=UTC)
LARGE_MIB = 1e6


def photograph(path: Path, taken: str = "2026:04:14 10:00:00", colour: int = 1) -> Path:
    """A JPEG of 64 x 48 pixels with a capture time."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.new("L", (64, 48), colour)
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0x9003] = taken
    image.save(path, exif=exif)
    return path


def portfolio(root: Path, **changes: dict[str, Any]) -> Portfolio:
    """Buildings by id with what differs from the default."""
    (root / "model.ifc").touch()
    buildings = [
        {"id": name, "name": name, "model": "model.ifc", "photographs": f"{name}/{{campaign}}", **more}
        for name, more in changes.items()
    ]
    (root / "portfolio.yaml").write_text(yaml.safe_dump({"buildings": buildings}))
    return read_portfolio(root / "portfolio.yaml")


@pytest.fixture
def lake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, CommittedBuilding]:
    """What the lake holds, by building; tests fill it (tests/flows commits for real)."""
    held: dict[str, CommittedBuilding] = {}
    monkeypatch.setattr(
        "facadelake.scheduling.plan.read_committed_buildings",
        lambda lake, ids: {name: held.get(name, CommittedBuilding()) for name in ids},
    )
    return held


def commit(lake: dict[str, CommittedBuilding], root: Path, building: str, campaign: str, **more: Any) -> None:
    """The lake holds the campaign with the photographs as they are."""
    from facadelake.core.hashing import hash_file

    folder = root / building / campaign
    photographs = {
        name: CommittedPhotograph(bytes=record.bytes, sha256=hash_file(folder / name))
        for name, record in list_photograph_files(folder).items()
    }
    one = {"run_id": "r1", "started_at": datetime.now(UTC) + timedelta(minutes=1), "peak_mib": None, "largest_px": 3072}
    lake.setdefault(building, CommittedBuilding()).campaigns[campaign] = CommittedCampaign(
        campaign_id=campaign, captured_to=datetime(2026, 4, 14, tzinfo=UTC), photographs=photographs, **{**one, **more}
    )


def plan(root: Path, registered: Portfolio, **more: Any) -> PortfolioPlan:
    settings = {"code_sha256": "c", "now": NOW, "check_upload": lambda *_: "", "memory_mib": LARGE_MIB}
    return plan_portfolio(registered, root / "lake", **{**settings, **more})


def names(found: PortfolioPlan) -> list[str]:
    return [f"{one.building_id} {one.campaign_id}" for one in found.waiting]


def reasons(found: PortfolioPlan) -> dict[str, str]:
    return {one.kind: one.reason for one in found.left_out}


def test_priority_then_law_then_the_oldest_photographs_and_campaigns_in_order_of_history(
    tmp_path: Path, lake: dict[str, CommittedBuilding]
) -> None:
    schedule = {"cron": "0 6 1 4 *", "cycle_months": 12}
    registered = portfolio(
        tmp_path, young={}, old={}, late={"schedule": schedule}, first={"priority": "high"}, last={"priority": "low"}
    )
    for building, campaign, taken in [
        ("young", "a", "2026:03:01 10:00:00"),
        ("old", "b-is-earlier", "2026:01:01 10:00:00"),
        ("old", "a-is-later", "2026:04:01 10:00:00"),
        ("late", "2026-04", "2026:04:20 10:00:00"),
        ("first", "2026-04", "2026:04:21 10:00:00"),
        ("last", "2020-04", "2020:04:21 10:00:00"),
    ]:
        photograph(tmp_path / building / campaign / "1.jpg", taken)
    photograph(tmp_path / "late" / "2025-01" / "1.jpg", "2025:01:10 10:00:00")
    commit(lake, tmp_path, "late", "2025-01")
    held = lake["late"].campaigns
    held["2025-01"] = CommittedCampaign(**{**vars(held["2025-01"]), "captured_to": datetime(2025, 1, 10, tzinfo=UTC)})
    found = plan(tmp_path, registered)
    assert names(found) == [
        "first 2026-04", "late 2026-04", "old b-is-earlier", "old a-is-later", "young a", "last 2020-04"
    ]  # fmt: skip
    assert {one.reason for one in found.waiting} == {"new"}
    assert [one.building_id for one in found.dates if one.legal_overdue] == ["late"]


def test_late_and_replaced_photographs_make_a_campaign_wait_and_touched_ones_do_not(
    tmp_path: Path, lake: dict[str, CommittedBuilding]
) -> None:
    registered = portfolio(tmp_path, wall={})
    folder = tmp_path / "wall" / "2026-04"
    first = photograph(folder / "1.jpg")
    photograph(folder / "2.jpg")
    commit(lake, tmp_path, "wall", "2026-04", started_at=datetime(2020, 1, 1, tzinfo=UTC))  # all are newer
    assert names(plan(tmp_path, registered)) == []
    before = first.stat()
    same_size = bytearray(first.read_bytes())
    same_size[-3] ^= 1
    first.write_bytes(same_size)
    os.utime(first, ns=(before.st_atime_ns, before.st_mtime_ns))  # as rsync -a copies
    assert plan(tmp_path, registered).waiting[0].reason == "photographs: 1 changed"
    photograph(folder / "3.jpg")
    assert plan(tmp_path, registered).waiting[0].reason == "photographs: 1 added, 1 changed"


def test_equal_photographs_are_hashed_once(
    tmp_path: Path, lake: dict[str, CommittedBuilding], monkeypatch: pytest.MonkeyPatch
) -> None:
    registered = portfolio(tmp_path, wall={})
    photograph(tmp_path / "wall" / "2026-04" / "1.jpg")
    commit(lake, tmp_path, "wall", "2026-04", started_at=datetime(2020, 1, 1, tzinfo=UTC))
    hashed: list[Path] = []

    def count(path: Path) -> str:
        hashed.append(path)
        return next(iter(lake["wall"].campaigns["2026-04"].photographs.values())).sha256

    monkeypatch.setattr("facadelake.scheduling.photograph_files.hash_file", count)
    found = plan(tmp_path, registered)
    write_building_log(tmp_path / "lake", "wall", found.logs["wall"])
    plan(tmp_path, registered)
    assert len(hashed) == 1


def test_photographs_that_were_archived_do_not_empty_the_campaign(
    tmp_path: Path, lake: dict[str, CommittedBuilding]
) -> None:
    registered = portfolio(tmp_path, wall={})
    folder = tmp_path / "wall" / "2026-04"
    for number in range(4):
        photograph(folder / f"{number}.jpg")
    commit(lake, tmp_path, "wall", "2026-04")
    (folder / "0.jpg").unlink()
    assert (
        "photographs: 1 gone, of 4 in the lake; it is kept as it is"
        in reasons(plan(tmp_path, registered))["photographs_gone"]
    )
    for number in range(1, 4):
        (folder / f"{number}.jpg").rename(folder / f"other{number}.jpg")  # the next campaign under the same name
    assert "photographs: 3 added, 4 gone" in reasons(plan(tmp_path, registered))["photographs_gone"]


def test_an_upload_that_grows_is_left_out(tmp_path: Path, lake: dict[str, CommittedBuilding]) -> None:
    registered = portfolio(tmp_path, wall={})
    folder = photograph(tmp_path / "wall" / "2026-04" / "1.jpg").parent
    quiet = timedelta(minutes=30)
    said = describe_recent_change(folder, quiet=quiet, now=datetime.now(UTC))
    assert said.startswith("its folder changed at ")
    assert "UTC and is taken as complete after 30 minutes without" in said
    assert describe_recent_change(folder, quiet=quiet, now=datetime.now(UTC) + quiet) == ""
    assert reasons(plan(tmp_path, registered, check_upload=lambda *_: said)) == {"growing": said}


def test_a_refused_campaign_is_not_tried_again_until_something_changes(
    tmp_path: Path, lake: dict[str, CommittedBuilding]
) -> None:
    registered = portfolio(tmp_path, wall={"control_points": "wall/{campaign}.csv"})
    folder = photograph(tmp_path / "wall" / "2026-04" / "1.jpg").parent
    (one,) = plan(tmp_path, registered).waiting

    def fail(outcome: Any, times: int) -> None:
        log = read_building_log(tmp_path / "lake", "wall", NOW)
        fingerprint = plan(tmp_path, registered, check_upload=lambda *_: "").waiting[0].fingerprint
        for _ in range(times):
            log.record_failure(
                "2026-04", outcome=outcome, fingerprint=fingerprint, problem="too dark", peak_mib=None, at=NOW
            )
        write_building_log(tmp_path / "lake", "wall", log)

    fail("refused", 1)
    assert reasons(plan(tmp_path, registered)) == {
        "failed_before": "refused on 2026-05-01 and nothing has changed since: too dark"
    }
    assert names(plan(tmp_path, registered, code_sha256="d"))
    looser = portfolio(
        tmp_path, wall={"control_points": "wall/{campaign}.csv", "tolerances": {"placement_sigma_max_m": 2}}
    )
    assert names(plan(tmp_path, looser))
    (tmp_path / "wall" / "2026-04.csv").write_text("what the message asked for")
    assert names(plan(tmp_path, registered))
    fail("refused", 1)
    assert not names(plan(tmp_path, registered))
    photograph(folder / "2.jpg")
    assert names(plan(tmp_path, registered))
    fail("killed", 2)  # the machine may be at fault
    assert names(plan(tmp_path, registered))
    fail("killed", 1)
    assert "failed 3 times, last on 2026-05-01" in reasons(plan(tmp_path, registered))["failed_before"]
    assert one.fingerprint


def test_a_campaign_that_does_not_fit_the_machine_is_told(tmp_path: Path, lake: dict[str, CommittedBuilding]) -> None:
    registered = portfolio(tmp_path, wall={})
    photograph(tmp_path / "wall" / "2026-04" / "1.jpg")
    said = reasons(plan(tmp_path, registered, memory_mib=1024))["too_large"]
    assert "GiB (estimated for 1 photographs of up to 0.0 megapixels), and inspections may take 1.0 GiB" in said
    assert "or run 'facadelake inspect wall 2026-04', which does not look at it" in said


def test_an_empty_folder_and_a_damaged_log_are_told(tmp_path: Path, lake: dict[str, CommittedBuilding]) -> None:
    registered = portfolio(tmp_path, wall={})
    (tmp_path / "wall" / "2026-04").mkdir(parents=True)
    assert reasons(plan(tmp_path, registered)) == {
        "no_photographs": f"there are no photographs in {tmp_path / 'wall' / '2026-04'}"
    }
    path = tmp_path / "lake" / "portfolio" / "buildings" / "wall.json"
    path.parent.mkdir(parents=True)
    path.write_text("{")
    (remark,) = plan(tmp_path, registered).remarks
    assert remark.startswith(f"wall: {path} cannot be read (")
    assert remark.endswith("it is begun anew: campaigns that failed before are tried again")


def test_a_disk_that_is_not_there_and_a_campaign_that_is_not_flown_yet_are_told(
    tmp_path: Path, lake: dict[str, CommittedBuilding]
) -> None:
    registered = portfolio(tmp_path, away={}, listed={"photographs": "listed", "campaigns": ["2026-10"]})
    found = plan(tmp_path, registered)
    assert found.remarks == (
        f"away: {tmp_path / 'away'}, in which its campaigns are looked for, does not exist, so that none can wait; "
        "mount the disk, or correct 'photographs' in the portfolio",
    )
    assert "does not exist (campaigns with photographs: 2026-10)" in reasons(found)["no_photographs"]


def test_a_campaign_without_capture_times_is_of_the_date_in_its_id_and_else_counts_for_none() -> None:
    none = {"captured_to": None, "run_id": "r", "started_at": NOW, "peak_mib": None}
    held = CommittedBuilding(
        campaigns={name: CommittedCampaign(campaign_id=name, **none) for name in ("2025-10", "facade")}
    )
    captured, remarks = held.list_captured()
    assert [(one.campaign_id, one.captured_to) for one in captured] == [("2025-10", datetime(2025, 10, 1, tzinfo=UTC))]
    assert remarks == [
        "campaign 2025-10: its photographs tell no capture time; its id is its date",
        "campaign facade: its photographs tell no capture time and its id no date, so it counts for no date of "
        "inspection; rename its folder, such as to 2026-04",
    ]
