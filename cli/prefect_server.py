"""Prefect's server: a running one is used, one is started for the schedules, else a temporary one per run."""

from __future__ import annotations

import os
import subprocess
import sys
import time
import urllib.request
import warnings
from pathlib import Path

from rich.console import Console

from facadelake.core.errors import StoreError
from facadelake.registry import Portfolio

START_LIMIT_S = 180


def serve_schedules(console: Console, registered: Portfolio, *, portfolio: Path, lake: Path, port: int) -> None:
    """Start the server, publish its address for ``facadelake inspect``, and run the portfolio's schedules.

    Args:
        console: where the address and the schedules are printed.
        registered: the portfolio as read.
        portfolio: path of the portfolio, for the runs.
        lake: folder of the lake.
        port: port of the server on this machine.

    Raises StoreError where the server does not start.
    """
    configure_prefect(lake)
    url = f"http://127.0.0.1:{port}/api"
    home = get_prefect_home(lake)
    with (home / "server.log").open("ab") as log:
        server = subprocess.Popen(
            [sys.executable, "-m", "prefect", "server", "start", "--host", "127.0.0.1", "--port", str(port)],
            stdout=log,
            stderr=subprocess.STDOUT,
            env={**os.environ, "PREFECT_API_URL": url},
        )
    try:
        with console.status("Starting Prefect's server"):
            _wait_until_healthy(server, url, home / "server.log")
        (home / ADDRESS_FILE).write_text(url)
        os.environ["PREFECT_API_URL"] = url
        console.print(f"Prefect's page: http://127.0.0.1:{port}   (stop with Ctrl-C; log: {home / 'server.log'})")
        _serve(console, registered, portfolio, lake)
    finally:
        (home / ADDRESS_FILE).unlink(missing_ok=True)
        server.terminate()
        server.wait(timeout=30)


def _wait_until_healthy(server: subprocess.Popen[bytes], url: str, log: Path) -> None:
    deadline = time.monotonic() + START_LIMIT_S
    while time.monotonic() < deadline:
        if server.poll() is not None:
            raise StoreError(
                f"Prefect's server exited with status {server.returncode}; if the port is in use, choose another with "
                f"--port. Log: {log}"
            )
        try:
            with urllib.request.urlopen(f"{url}/health", timeout=2) as answer:
                if answer.status == 200:
                    return
        except OSError:
            time.sleep(0.5)
    raise StoreError(f"Prefect's server did not answer within {START_LIMIT_S} s; its log is {log}")


def _serve(console: Console, registered: Portfolio, portfolio: Path, lake: Path) -> None:
    from prefect import serve
    from prefect.deployments.runner import RunnerDeployment
    from prefect.schedules import Cron

    from flows.inspect_building import inspect_building

    deployments = []
    for building in registered.buildings:
        schedule = building.schedule
        deployment = inspect_building.to_deployment(
            name=building.id,
            parameters={
                "building_id": building.id,
                "portfolio": str(portfolio.resolve()),
                "lake": str(lake.resolve()),
            },
            schedule=Cron(schedule.cron, timezone=schedule.timezone) if schedule else None,
            tags=["facadelake"],
        )
        assert isinstance(deployment, RunnerDeployment)  # a coroutine only inside a running event loop
        deployments.append(deployment)
        due = f"{schedule.cron} {schedule.timezone}" if schedule else "by hand only"
        console.print(f"  {building.id}: {due}", highlight=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Prefect's runner does not await a coroutine when it is stopped
        serve(*deployments, print_starting_message=False)


ADDRESS_FILE = "api_url"


def get_prefect_home(lake: Path) -> Path:
    """Folder of Prefect's database and settings, in the lake."""
    return lake.resolve() / "prefect"


def find_running_server(lake: Path) -> str | None:
    """Address of the server of ``facadelake serve-prefect`` for this lake, None where none answers."""
    file = get_prefect_home(lake) / ADDRESS_FILE
    if not file.is_file():
        return None
    url = file.read_text().strip()
    try:
        with urllib.request.urlopen(f"{url}/health", timeout=2) as answer:
            return url if answer.status == 200 else None
    except OSError:
        return None


def configure_prefect(lake: Path) -> None:
    """Set environment variables of Prefect that the user has not set: home in the lake, quiet console, logs."""
    home = get_prefect_home(lake)
    home.mkdir(parents=True, exist_ok=True)
    defaults = {
        "PREFECT_HOME": str(home),
        "PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL": "ERROR",
        "PREFECT_LOGGING_EXTRA_LOGGERS": "facadelake",
        "PREFECT_SERVER_LOGGING_LEVEL": "CRITICAL",
        "PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS": "180",
    }
    if "PREFECT_API_URL" not in os.environ:
        url = find_running_server(lake)
        if url:
            defaults["PREFECT_API_URL"] = url
    for name, value in defaults.items():
        os.environ.setdefault(name, value)
