"""Keep Prefect's server and a worker running, and close the runs that a dead process left behind."""

from __future__ import annotations

import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil

from cli.prefect_server import ADDRESS_FILE, get_prefect_home, is_healthy
from facadelake.core.errors import StoreError
from facadelake.core.processes.identity import ProcessIdentity
from facadelake.registry import ServiceSettings, read_portfolio

log = logging.getLogger("facadelake.service")

IDENTITY_FILE = "service.json"
START_LIMIT_S = 180
STOP_LIMIT_S = 5.0  # for a child to end by itself after SIGTERM
_LONGEST_PAUSE_S = 60.0
_STEADY_S = 120.0  # a child that ran so long is started at once when it ends
_RECONCILE_S = 30.0


@dataclass(kw_only=True)
class _Child:
    """A process that is kept running; its output goes to a log of its own."""

    name: str
    command: Sequence[str]
    environment: Mapping[str, str]
    log: Path
    process: subprocess.Popen[bytes] | None = None
    started_at: float = 0.0
    pause_s: float = 0.0

    def start(self) -> None:
        with self.log.open("ab") as output:
            self.process = subprocess.Popen(
                self.command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=dict(self.environment),
                start_new_session=True,  # Ctrl-C reaches the supervisor alone, which ends its children in order
            )
        self.started_at = time.monotonic()

    def stop(self) -> None:
        """End the process and all that it started; what does not end within the limit is killed."""
        if self.process is None:
            return
        try:
            family = [psutil.Process(self.process.pid)]
            family += family[0].children(recursive=True)
        except psutil.NoSuchProcess:
            return
        for process in family[:1]:
            process.terminate()
        _, alive = psutil.wait_procs(family, timeout=STOP_LIMIT_S)
        for process in alive:
            try:
                process.kill()
            except psutil.NoSuchProcess:
                continue
        self.process.wait()


class Supervisor:
    """The server and the worker of a lake; ``run`` returns when it is told to stop."""

    def __init__(self, settings: ServiceSettings, settings_file: Path) -> None:
        self.settings = settings
        self._file = settings_file
        self.home = get_prefect_home(Path(settings.lake))
        self.url = f"http://{settings.host}:{settings.port}/api"
        self._stopping = threading.Event()
        # Prefect reads its settings when it is imported, which the functions below do.
        os.environ.update({"PREFECT_HOME": str(self.home), "PREFECT_API_URL": self.url})
        os.environ["FACADELAKE_SETTINGS"] = str(settings_file)
        common = {**os.environ, "PREFECT_LOGGING_EXTRA_LOGGERS": "facadelake"}
        prefect = [sys.executable, "-m", "prefect"]
        host, port = settings.host, str(settings.port)
        self._server = _Child(
            name="server",
            command=[*prefect, "server", "start", "--host", host, "--port", port],
            environment=common | _get_database(settings.database),
            log=self.home / "server.log",
        )
        from flows.deployments import POOL

        self._worker = _Child(
            name="worker",
            command=[
                *prefect, "worker", "start", "--pool", POOL, "--type", "process", "--install-policy", "never",
                "--no-create-pool-if-not-found", "--name", f"{POOL}@{socket.gethostname()}",
            ],
            environment=common,
            log=self.home / "worker.log",
        )  # fmt: skip

    def run(self) -> None:
        """Start both, apply the deployments of the registry, and keep them running until SIGTERM or SIGINT.

        Raises StoreError where another service of this lake runs, or where the server does not start.
        """
        self.home.mkdir(parents=True, exist_ok=True)
        running = find_service(Path(self.settings.lake))
        if running is not None:
            raise StoreError(
                f"the service of the lake {self.settings.lake} runs already (process {running.pid}); "
                "'facadelake down' stops it"
            )
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            signal.signal(number, lambda *_: self._stopping.set())
        ProcessIdentity.from_this_process().write(self.home / IDENTITY_FILE)
        try:
            self._start()
            self._watch()
        finally:
            self._stop()

    def _start(self) -> None:
        self._server.start()
        self._wait_until_healthy()
        self._reconcile()
        self._deploy()
        self._worker.start()
        (self.home / ADDRESS_FILE).write_text(self.url)  # others take it as the sign that all is there
        log.info("Prefect's server answers at %s, a worker is started", self.url)

    def _deploy(self) -> None:
        from prefect.client.orchestration import get_client

        from flows.deployments import apply_deployments, list_specs, plan_deployments

        portfolio = read_portfolio(Path(self.settings.portfolio))
        with get_client(sync_client=True) as client:
            specs = list_specs(portfolio, self.settings, str(self._file))
            plan = plan_deployments(client, specs, self.settings.lake)
            apply_deployments(client, plan, self.settings)
        for change in plan.changes:
            if change.action != "keep":
                log.info("deployment %s: %s", change.full_name, change.action)

    def _watch(self) -> None:
        reconcile_at = time.monotonic() + _RECONCILE_S
        while not self._stopping.wait(0.5):
            for child in (self._server, self._worker):
                self._restart_if_ended(child)
            if time.monotonic() >= reconcile_at:
                self._reconcile()
                reconcile_at = time.monotonic() + _RECONCILE_S

    def _restart_if_ended(self, child: _Child) -> None:
        assert child.process is not None, "it has been started"
        code = child.process.poll()
        if code is None:
            return
        if time.monotonic() - child.started_at > _STEADY_S:
            child.pause_s = 0.0
        how = f"signal {signal.Signals(-code).name}" if code < 0 else f"status {code}"
        log.warning("%s ended with %s after %.0f s; started again in %.0f s (log: %s)", child.name, how,
                    time.monotonic() - child.started_at, child.pause_s, child.log)  # fmt: skip
        if self._stopping.wait(child.pause_s):
            return
        child.pause_s = min(max(1.0, 2 * child.pause_s), _LONGEST_PAUSE_S)
        child.start()

    def _reconcile(self) -> None:
        """Close the runs of dead processes; a server that does not answer is for the next time."""
        import httpx
        from prefect.client.orchestration import get_client

        from flows.running import close_orphans

        try:
            with get_client(sync_client=True) as client:
                for run in close_orphans(client):
                    log.warning("run '%s' closed: %s", run.name, run.reason)
        except (httpx.HTTPError, OSError) as error:
            log.warning("runs not looked through: the server does not answer (%s)", error or type(error).__name__)

    def _wait_until_healthy(self) -> None:
        deadline = time.monotonic() + START_LIMIT_S
        while time.monotonic() < deadline and not self._stopping.is_set():
            process = self._server.process
            if process is not None and process.poll() is not None:
                raise StoreError(
                    f"Prefect's server exited with status {process.returncode}; if port {self.settings.port} is in "
                    f"use, choose another (key 'port' of {self._file}). Log: {self._server.log}"
                )
            if is_healthy(self.url):
                return
            self._stopping.wait(0.5)
        if not self._stopping.is_set():
            raise StoreError(f"Prefect's server did not answer within {START_LIMIT_S} s; log: {self._server.log}")

    def _stop(self) -> None:
        self._worker.stop()
        if self._worker.process is not None:
            self._reconcile()  # the runs that the worker's end has cut off
        (self.home / ADDRESS_FILE).unlink(missing_ok=True)
        self._server.stop()
        (self.home / IDENTITY_FILE).unlink(missing_ok=True)
        log.info("stopped")


def _get_database(url: str | None) -> dict[str, str]:
    """The setting of Prefect's server for PostgreSQL, whose driver the address names."""
    if url is None:
        return {}
    return {"PREFECT_SERVER_DATABASE_CONNECTION_URL": f"postgresql+asyncpg://{url.split('://', 1)[1]}"}


def find_service(lake: Path) -> ProcessIdentity | None:
    """The supervisor that runs for this lake on this machine; None where there is none."""
    identity = ProcessIdentity.read(get_prefect_home(lake) / IDENTITY_FILE)
    if identity is None or not identity.is_of_this_machine or not identity.is_running():
        return None
    return identity


def stop_service(lake: Path, limit_s: float = 60.0) -> int | None:
    """Stop the supervisor of this lake; returns its process, None where none runs.

    Raises StoreError where it does not end within ``limit_s``.
    """
    identity = find_service(lake)
    if identity is None:
        return None
    os.kill(identity.pid, signal.SIGTERM)
    deadline = time.monotonic() + limit_s
    while identity.is_running():
        if time.monotonic() > deadline:
            raise StoreError(
                f"the service (process {identity.pid}) has not stopped within {limit_s:.0f} s; its log is "
                f"{get_prefect_home(lake) / 'service.log'}"
            )
        time.sleep(0.1)
    return identity.pid
