"""The service for real: server, worker and deployments on a port of its own; runs of dead processes are closed."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest
import yaml
from prefect.client.orchestration import SyncPrefectClient
from prefect.client.schemas.objects import StateType
from prefect.states import Running

from cli.service.supervisor import find_service
from facadelake.core.checkout import CHECKOUT
from facadelake.core.errors import InputDataError
from facadelake.core.processes.identity import ProcessIdentity
from facadelake.registry import read_portfolio, read_service_settings
from facadelake.scheduling import find_limits
from flows.deployments import POOL, list_specs, plan_deployments
from flows.inspect_building import inspect_building

BUILDING = {
    "id": "tower",
    "name": "Tower",
    "model": "tower.ifc",
    "photographs": "photos/{campaign}",
    "schedule": {"cron": "0 6 1 4 *", "timezone": "Europe/Berlin"},
}


@dataclass(frozen=True)
class Service:
    """A service that runs: its settings, its log and a client of its server."""

    settings: Path
    home: Path
    client: SyncPrefectClient

    def run(self, *command: str) -> subprocess.CompletedProcess[str]:
        """A command of the command line on this service."""
        code = "from cli.main import main; main()"
        environment = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")}
        return subprocess.run(
            [sys.executable, "-c", code, *command, "--settings", str(self.settings)],
            cwd=CHECKOUT, env=environment, capture_output=True, text=True, check=False, timeout=240,
        )  # fmt: skip


def wait_for(condition: Callable[[], bool], limit_s: float = 90.0) -> None:
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.5)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    root = tmp_path_factory.mktemp("service")
    (root / "portfolio.yaml").write_text(yaml.safe_dump({"buildings": [BUILDING]}))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    settings = root / "facadelake.yaml"
    settings.write_text(yaml.safe_dump({"portfolio": "portfolio.yaml", "lake": "lake", "port": port}))
    home = root / "lake" / "prefect"
    one = Service(settings, home, SyncPrefectClient(f"http://127.0.0.1:{port}/api"))
    started = one.run("up")
    assert started.returncode == 0, started.stderr + started.stdout
    assert f"http://127.0.0.1:{port}" in started.stdout
    try:
        with one.client:
            yield one
    finally:
        stopped = one.run("down")
        assert "Stopped (process" in stopped.stdout, stopped.stderr
        assert find_service(root / "lake") is None


def test_the_deployments_are_those_of_the_registry(service: Service) -> None:
    read = read_service_settings(service.settings)
    portfolio = read_portfolio(Path(read.portfolio))
    specs = list_specs(portfolio, read, str(service.settings))
    assert plan_deployments(service.client, specs, read.lake).is_empty
    assert "0 to create, 0 to change, 0 to delete" in service.run("deploy", "--dry-run").stdout
    there = service.client.read_deployment_by_name("inspect-building/tower")
    limits = {one.name: one.concurrency_limit for one in service.client.read_work_queues(work_pool_name=POOL)}
    one_queue = find_limits(read.limits).side_by_side
    assert limits.items() >= {"service": None, "high": one_queue, "normal": one_queue, "low": one_queue}.items()
    assert there.parameters["building_id"] == "tower" and there.work_queue_name == "normal"

    mill = {**BUILDING, "id": "mill", "priority": "high"}
    moved = {**BUILDING, "schedule": {"cron": "0 7 1 4 *", "timezone": "Europe/Berlin"}}
    registry = Path(read.portfolio)
    registry.write_text(yaml.safe_dump({"buildings": [moved, mill]}))
    shown = service.run("deploy", "--dry-run").stdout
    assert "0 6 1 4 * Europe/Berlin -> 0 7 1 4 * Europe/Berlin" in shown
    assert "1 to create, 1 to change, 0 to delete" in shown
    assert service.client.read_deployment_by_name("inspect-building/tower").id == there.id
    assert "Applied" in service.run("deploy", "--yes").stdout
    assert service.client.read_deployment_by_name("inspect-building/mill").work_queue_name == "high"
    registry.write_text(yaml.safe_dump({"buildings": [BUILDING]}))
    assert "0 to create, 1 to change, 1 to delete" in service.run("deploy", "--yes").stdout
    other = list_specs(portfolio, read, str(service.settings))
    with pytest.raises(InputDataError, match=r"of the lake .*, not /another"):
        plan_deployments(service.client, other, "/another")


def test_a_schedule_switched_off_on_the_page_stays_off(service: Service) -> None:
    there = service.client.read_deployment_by_name("inspect-building/tower")
    service.client.update_deployment_schedule(there.id, there.schedules[0].id, active=False)
    assert "0 to create, 0 to change, 0 to delete" in service.run("deploy", "--yes").stdout
    assert not service.client.read_deployment_by_name("inspect-building/tower").schedules[0].active


def test_the_run_of_a_process_that_is_gone_is_closed(service: Service) -> None:
    gone = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    identity = ProcessIdentity.from_pid(gone.pid)
    parameters = {"building_id": "tower", "lake": str(service.home.parent)}
    dead, alive = (service.client.create_flow_run(inspect_building, parameters=parameters) for _ in range(2))
    for run, process in ((dead, identity), (alive, ProcessIdentity.from_this_process())):
        service.client.set_flow_run_state(run.id, Running(), force=True)
        process.write(service.home / "running" / f"{run.id}.json")
    gone.kill()
    gone.wait()
    wait_for(lambda: service.client.read_flow_run(dead.id).state_type == StateType.CRASHED)
    closed = service.client.read_flow_run(dead.id)
    assert closed.state is not None and closed.state.message == (
        f"its process {identity.pid} on {identity.host} is gone; closed by Facadelake, finished stages are in the "
        "cache and the next run continues after them"
    )
    assert service.client.read_flow_run(alive.id).state_type == StateType.RUNNING
    assert "closed: its process" in (service.home / "service.log").read_text()
    assert not (service.home / "running" / f"{dead.id}.json").exists()


def test_a_killed_server_and_a_killed_worker_are_started_again(service: Service) -> None:
    supervisor = find_service(service.home.parent)
    assert supervisor is not None
    children = {name: one for one in psutil.Process(supervisor.pid).children() for name in one.cmdline()[3:4]}
    assert children.keys() == {"server", "worker"}
    for child in children.values():
        child.send_signal(signal.SIGKILL)
    wait_for(lambda: (service.home / "service.log").read_text().count("ended with signal SIGKILL") == 2)
    wait_for(lambda: service.run("status").returncode == 0, limit_s=180)
    shown = service.run("status").stdout
    assert f"runs (process {supervisor.pid})" in shown and f"facadelake@{socket.gethostname()}" in shown


def test_a_second_service_of_the_lake_is_refused(service: Service) -> None:
    second = service.run("up", "--foreground")
    assert second.returncode == 1 and "runs already (process" in second.stderr
    assert "The service runs already" in service.run("up").stdout
