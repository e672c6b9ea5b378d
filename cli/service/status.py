"""What the service does: read from its processes and Prefect's server, and shown in the terminal."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

from cli.prefect_server import configure_prefect, find_running_server
from cli.service.supervisor import find_service
from facadelake.intake import UploadState, describe_upload, list_uploads
from facadelake.registry import ServiceSettings
from facadelake.scheduling import PORTFOLIO_FOLDER

_LISTED = 8  # runs of a kind
_PAGE = 200  # runs in one answer of the server
_NEED_A_PERSON = (UploadState.REFUSED, UploadState.FAILED, UploadState.STALLED)
_WORKER_SILENCE_MAX = timedelta(seconds=90)  # a worker reports every 30 s


@dataclass(frozen=True, kw_only=True)
class RunLine:
    """A run in the list: its name and state, and when it began, is expected, or ended."""

    name: str
    state: str
    at: datetime | None
    message: str


@dataclass(frozen=True, kw_only=True)
class ServiceStatus:
    """What the service does.

    ``workers``: name and last sign of life of each. ``address``: None: no server answers. ``uploads``: a line on their
    states, and one on each that needs a person. ``report``: that of the last inspection of the portfolio.
    """

    pid: int | None
    address: str | None
    workers: Sequence[tuple[str, datetime]] = ()
    deployments: int = 0
    running: Sequence[RunLine] = ()
    coming: Sequence[RunLine] = ()
    failed: Sequence[RunLine] = ()
    uploads: Sequence[str] = ()
    report: Path | None = None

    @property
    def is_well(self) -> bool:
        """Whether the server answers and a worker has reported lately."""
        now = datetime.now(UTC)
        return self.address is not None and any(now - seen < _WORKER_SILENCE_MAX for _, seen in self.workers)


def read_status(settings: ServiceSettings) -> ServiceStatus:
    """Ask the supervisor's file and Prefect's server."""
    lake = Path(settings.lake)
    service = find_service(lake)
    pid = service.pid if service else None
    uploads, report = _describe_uploads(settings), lake / PORTFOLIO_FOLDER / "latest.md"
    beside: dict[str, Any] = {"uploads": uploads, "report": report if report.exists() else None}
    address = os.environ.get("PREFECT_API_URL") or find_running_server(lake)
    if address is None:
        return ServiceStatus(pid=pid, address=None, **beside)
    configure_prefect(lake)
    from prefect.client.orchestration import get_client
    from prefect.client.schemas import filters
    from prefect.client.schemas.objects import StateType
    from prefect.client.schemas.sorting import FlowRunSort
    from prefect.exceptions import ObjectNotFound

    from flows.deployments import POOL, read_deployment_names

    with get_client(sync_client=True) as client:
        names = read_deployment_names(client)

        def list_runs(states: list[StateType], sort: FlowRunSort, limit: int = _LISTED) -> list[RunLine]:
            kind = filters.FlowRunFilterState(type=filters.FlowRunFilterStateType(any_=states))
            own = filters.FlowRunFilter(state=kind, deployment_id=filters.FlowRunFilterDeploymentId(is_null_=False))
            found = client.read_flow_runs(flow_run_filter=own, sort=sort, limit=limit)
            return [_make_line(run, names.get(run.deployment_id or run.id, run.name)) for run in found]

        try:
            workers = client.read_workers_for_work_pool(POOL)
        except ObjectNotFound:
            workers = []
        coming: dict[str, RunLine] = {}
        for line in list_runs([StateType.SCHEDULED], FlowRunSort.EXPECTED_START_TIME_ASC, limit=_PAGE):
            coming.setdefault(line.name, line)  # Prefect plans several runs of each ahead
        return ServiceStatus(
            pid=pid,
            address=address,
            workers=[(one.name, one.last_heartbeat_time) for one in workers if one.last_heartbeat_time],
            deployments=len(names),
            running=list_runs(
                [StateType.RUNNING, StateType.PENDING, StateType.CANCELLING], FlowRunSort.START_TIME_DESC
            ),
            coming=list(coming.values())[:_LISTED],
            failed=list_runs([StateType.FAILED, StateType.CRASHED], FlowRunSort.END_TIME_DESC),
            **beside,
        )


def _describe_uploads(settings: ServiceSettings) -> list[str]:
    uploads, problems = list_uploads(settings)
    there = [one for one in uploads if one.in_source]
    counts = ", ".join(f"{n} {state}" for state, n in Counter(str(one.state) for one in there).most_common())
    lines = [describe_upload(one) for one in there if one.state in _NEED_A_PERSON]
    return [*([counts] if counts else []), *lines, *(f"{one.building_id}: {one.problem}" for one in problems)]


def _make_line(run: Any, name: str) -> RunLine:
    message = (run.state.message or "").splitlines() if run.state else []
    return RunLine(
        name=name,
        state=run.state_name or "unknown",
        at=run.end_time or run.start_time or run.expected_start_time,
        message=message[0] if message else "",
    )


def show_status(console: Console, status: ServiceStatus) -> None:
    """Print the status."""
    table = RichTable(show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    table.add_row("service", f"runs (process {status.pid})" if status.pid else "[red]does not run[/red]; facadelake up")
    page = status.address.removesuffix("/api") if status.address else "[red]does not answer[/red]"
    table.add_row("Prefect's page", page)
    if status.address is not None:
        now = datetime.now(UTC)
        lines = [
            escape(f"{name}, reported {(now - seen).total_seconds():.0f} s ago")
            + ("" if now - seen < _WORKER_SILENCE_MAX else " [red](silent)[/red]")
            for name, seen in status.workers
        ]
        table.add_row("workers", "\n".join(lines) or "[red]none[/red]")
        table.add_row("deployments", str(status.deployments))
        for title, runs in (("running", status.running), ("next", status.coming), ("failed last", status.failed)):
            table.add_row(title, "\n".join(escape(_format_line(run)) for run in runs) or "none")
    table.add_row("uploads", "\n".join(map(escape, status.uploads)) or "none; more: facadelake intake")
    table.add_row("last report", escape(str(status.report)) if status.report else "none")
    console.print(table, highlight=False)


def _format_line(run: RunLine) -> str:
    at = f"{run.at.astimezone():%Y-%m-%d %H:%M:%S %Z} " if run.at else ""
    said = f": {run.message}" if run.message and run.state not in ("Running", "Scheduled") else ""
    return f"{at}{run.name} ({run.state}){said}"
