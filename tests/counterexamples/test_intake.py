"""``facadelake intake`` lists uploads and what to bring; ``receive`` makes a pass, as the flow does."""

from __future__ import annotations

import logging
import time
from pathlib import Path

import pytest
import yaml
from prefect.exceptions import ObjectNotFound

from facadelake.intake import UploadState
from facadelake.intake.ledger import open_ledger
from facadelake.registry import read_service_settings
from flows.receive_uploads import receive_uploads
from tests.counterexamples.command_line import facadelake
from tests.unit.photos.small_photographs import photograph

QUIET_MINUTES = 0.01


@pytest.fixture
def service(tmp_path: Path) -> Path:
    """The settings of a service whose building has two uploads: one is right, one is of another year."""
    building = {
        "id": "mill",
        "name": "Mill",
        "model": "mill.ifc",
        "photographs": "photographs/{campaign}",
        "intake": {"source": "uploads", "quiet_minutes": QUIET_MINUTES},
    }
    (tmp_path / "portfolio.yaml").write_text(yaml.safe_dump({"buildings": [building]}))
    settings = tmp_path / "facadelake.yaml"
    settings.write_text(yaml.safe_dump({"portfolio": "portfolio.yaml", "lake": "lake"}))
    for folder, taken in (("2026-04", "2026:04:14 10:00:05"), ("2025-04", "2026:04:14 10:00:06")):
        (tmp_path / "uploads" / folder).mkdir(parents=True)
        for seed in range(2):
            picture = photograph(48.94, 8.4, seed=seed + 10 * (folder == "2026-04"), taken=taken)
            (tmp_path / "uploads" / folder / f"{seed}.JPG").write_bytes(picture)
    return settings


def test_uploads_are_listed_and_received_by_hand(service: Path) -> None:
    empty = facadelake("intake", "--settings", service)
    assert empty.returncode == 0 and "no uploads; a building with 'intake: {source: ...}'" in empty.stdout
    first = facadelake("intake", "receive", "--settings", service)
    assert first.returncode == 0, first.stderr
    time.sleep(QUIET_MINUTES * 60)
    second = facadelake("intake", "receive", "--settings", service)
    assert second.returncode == 1  # one is refused
    listed = facadelake("intake", "--settings", service)
    rows = {line.split("│")[2].strip(): line for line in listed.stdout.splitlines() if line.startswith("│")}
    assert "received" in rows["2026-04"] and "refused" in rows["2025-04"]
    (told,) = [line for line in listed.stdout.splitlines() if line.startswith("mill 2025-04: 2 of 2")]
    assert told.startswith("mill 2025-04: 2 of 2 photographs were taken on 2026-04-14, which is not 2025-04")
    assert told.endswith("write 'accept: [dates]' into campaign.yaml")
    assert [path.name for path in sorted((service.parent / "photographs").iterdir())] == ["2026-04"]


def test_the_flow_logs_what_is_new_once_and_has_it_inspected(
    service: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[str, str]] = []

    def ask(name: str, *, idempotency_key: str, **_: object) -> None:
        asked.append((name, idempotency_key))
        raise ObjectNotFound(Exception("a server without deployments"))

    monkeypatch.setattr("flows.receive_uploads.run_deployment", ask)
    caplog.set_level(logging.INFO, logger="facadelake.flows")
    receive_uploads.fn(str(service))
    assert sum("is growing" in record.message for record in caplog.records) == 2
    caplog.clear()
    time.sleep(QUIET_MINUTES * 60)
    report = receive_uploads.fn(str(service))
    assert report is not None
    assert {one.folder: one.state for one in report.news} == {
        "2026-04": UploadState.RECEIVED,
        "2025-04": UploadState.REFUSED,
    }
    assert [name for name, _ in asked] == ["inspect-portfolio/all"]
    assert caplog.records.pop().message == (
        "no deployment 'inspect-portfolio/all' on this server: what was received waits for the next inspection"
    )
    levels = {record.levelname: record.message for record in caplog.records}
    assert levels["INFO"].startswith("mill: upload '2026-04' is received as campaign 2026-04 (2 photographs, 0.0 MB)")
    assert levels["WARNING"].startswith("mill: upload '2025-04' is refused (2 photographs, 0.0 MB): 2 of 2 photographs")
    caplog.clear()
    receive_uploads.fn(str(service))
    assert [record.message for record in caplog.records] == []
    assert len(asked) == 1


def test_the_flow_leaves_a_pass_to_the_process_that_makes_it(service: Path) -> None:
    with open_ledger(read_service_settings(service)).hold():
        assert receive_uploads.fn(str(service)) is None
        busy = facadelake("intake", "receive", "--settings", service)
    assert busy.returncode == 1
    assert "another process receives uploads at the moment; they are received once, by that one" in busy.stderr


def test_help_teaches() -> None:
    told = facadelake("intake", "--help").stdout
    assert all(state in told for state in ("growing", "received", "refused", "failed", "stalled"))
    assert (
        "campaign.yaml" in told
        and "Example: facadelake intake receive" in facadelake("intake", "receive", "--help").stdout
    )
