"""The portfolio as a user runs it: one campaign of bad input, one whose process is killed, the others are inspected."""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from http.server import HTTPServer
from pathlib import Path

import psutil
import pytest
import yaml

from facadelake.lake.read import read_table
from tests.flows.conftest import CAMPAIGN, SmallPortfolio
from tests.flows.test_notify import Receiver

pytestmark = pytest.mark.slow

CLI = [sys.executable, "-c", "from cli.main import main; main()", "inspect-portfolio"]
BUILDINGS = ("empty", "good", "killed", "other")


@dataclass(frozen=True, kw_only=True)
class FourBuildings:
    """A portfolio of four buildings of the same photographs; those of ``empty`` have no bytes."""

    root: Path
    lake: Path
    messages: list[dict[str, str]]

    def start(self, *more: str) -> subprocess.Popen[str]:
        place = ("--portfolio", str(self.root / "portfolio.yaml"), "--lake", str(self.lake))
        return subprocess.Popen(
            [*CLI, *place, "--settings", str(self.root / "facadelake.yaml"), *more],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=dict(os.environ),
        )  # fmt: skip

    def find_process(self, building: str, process: subprocess.Popen[str]) -> psutil.Process:
        """The process that inspects the building, once it has begun its work."""
        begin = time.monotonic()
        while time.monotonic() - begin < 900:
            for child in psutil.Process(process.pid).children():
                with suppress(psutil.Error):  # one that has just ended
                    if f"/{building}/" in " ".join(child.cmdline()[-1:]):
                        time.sleep(3)  # it has begun its work
                        return child
            time.sleep(0.2)
        raise AssertionError(f"{building} was not started")

    def list_flow_runs(self) -> dict[str, set[str]]:
        """The states of Prefect's flow runs by name."""
        found: dict[str, set[str]] = {}
        with closing(sqlite3.connect(self.lake / "prefect" / "prefect.db")) as database:
            for name, state in database.execute("SELECT name, state_type FROM flow_run"):
                found.setdefault(name, set()).add(state)
        return found


@pytest.fixture(scope="module")
def four(small: SmallPortfolio, tmp_path_factory: pytest.TempPathFactory) -> Iterator[FourBuildings]:
    root = tmp_path_factory.mktemp("four")
    campaign = small.images.parent
    for name in BUILDINGS:
        shutil.copytree(campaign / "images", root / name / CAMPAIGN, ignore=shutil.ignore_patterns("broken*", "twice*"))
    for photograph in (root / "empty").rglob("*.JPG"):
        photograph.write_bytes(b"")
    buildings = [
        {
            "id": name,
            "name": name,
            "model": str(small.registry.parent / "building" / "demo.ifc"),
            "photographs": f"{name}/{{campaign}}",
            "control_points": str(campaign / "gcp_list.txt"),
            "detector": {"kind": "coco", "file": str(campaign / "detections.coco.json")},
            "schedule": {"cron": "0 6 1 4,10 *"},
        }
        for name in BUILDINGS
    ]
    (root / "portfolio.yaml").write_text(yaml.safe_dump({"buildings": buildings}))
    lake = root / "lake"
    if (small.lake / "cache").is_dir():  # the same photographs: their stages need not be made again
        shutil.copytree(small.lake / "cache", lake / "cache", copy_function=os.link)
    messages: list[dict[str, str]] = []
    with HTTPServer(("127.0.0.1", 0), type("Handler", (Receiver,), {"received": messages})) as server:
        settings = {
            "limits": {"side_by_side": 2, "memory_gib": 16},
            "intake": {"quiet_minutes": 0.0001},
            "notify": {"to": [f"json://127.0.0.1:{server.server_port}/hook"]},
        }
        (root / "facadelake.yaml").write_text(yaml.safe_dump(settings))
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield FourBuildings(root=root, lake=lake, messages=messages)
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def first_run(four: FourBuildings) -> str:
    """The output of the inspection during which the process of ``killed`` is killed."""
    begin = time.monotonic()
    while four.start("--dry-run").communicate()[0].count("│ new") < len(BUILDINGS):  # until the uploads are settled
        assert time.monotonic() - begin < 120
    process = four.start()
    four.find_process("killed", process).send_signal(signal.SIGKILL)
    output, _ = process.communicate(timeout=1500)
    assert process.returncode == 1, output
    return " ".join(output.split())


def test_one_failure_and_one_killed_process_stop_no_other(four: FourBuildings, first_run: str) -> None:
    for said in (
        "2 inspected, 2 failed",
        "**empty 2026-04** (refused): none of the 32 photographs in",
        "**killed 2026-04** (killed): its process was killed by signal SIGKILL",
        "| good | 2026-04-14 |",
    ):
        assert said in first_run
    assert "Traceback" not in first_run
    assert read_table(four.lake, "campaigns").column("building_id").to_pylist() == ["good", "other"]
    report = (four.lake / "portfolio" / "latest.md").read_text()
    assert "| good | 2026-04 |" in report and "| other | 2026-04 |" in report
    assert "first_seen" in report


def test_no_flow_run_is_left_running_and_each_is_below_that_of_the_portfolio(
    four: FourBuildings, first_run: str
) -> None:
    runs = four.list_flow_runs()
    assert {f"{name} {CAMPAIGN}": runs[f"{name} {CAMPAIGN}"] for name in BUILDINGS} == {
        f"empty {CAMPAIGN}": {"FAILED"},
        f"good {CAMPAIGN}": {"COMPLETED"},
        f"killed {CAMPAIGN}": {"CRASHED"},
        f"other {CAMPAIGN}": {"COMPLETED"},
    }
    with closing(sqlite3.connect(four.lake / "prefect" / "prefect.db")) as database:
        (below,) = database.execute("SELECT count(*) FROM flow_run WHERE parent_task_run_id IS NOT NULL").fetchone()
        keys = {key for (key,) in database.execute("SELECT DISTINCT key FROM artifact")}
    assert below == len(BUILDINGS)
    assert {"portfolio-report", "portfolio-dates", f"good-{CAMPAIGN}-defects"} <= keys


def test_the_message_arrived(four: FourBuildings, first_run: str) -> None:
    (message,) = four.messages
    assert "FAILED empty 2026-04: none of the 32 photographs" in message["message"]
    assert "FAILED killed 2026-04: its process was killed by signal SIGKILL" in message["message"]
    assert "WORST GRADE good 2026-04:" in message["message"]


def test_what_was_refused_is_not_tried_again_and_what_was_killed_is(four: FourBuildings, first_run: str) -> None:
    output = " ".join(four.start("--dry-run").communicate()[0].split())
    assert "nothing has changed since: none of the 32" in output.replace("│ │ │ │ ", "")
    waiting = output.split("Left out")[0]
    assert "killed" in waiting and "empty" not in waiting and "good" not in waiting


def test_a_stop_ends_the_children_within_five_seconds_and_says_what_was_not_done(
    four: FourBuildings, first_run: str
) -> None:
    process = four.start()
    child = four.find_process("killed", process)
    begin = time.monotonic()
    process.send_signal(signal.SIGINT)
    psutil.wait_procs([child], timeout=10)
    assert not child.is_running() or child.status() == psutil.STATUS_ZOMBIE
    assert time.monotonic() - begin < 5
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 130, output
    assert "## Not done" in output and "- killed 2026-04" in output
    assert "Traceback" not in output
    assert "RUNNING" not in four.list_flow_runs()[f"killed {CAMPAIGN}"]
