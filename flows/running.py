"""Which process runs a flow: noted while it runs, so that a run whose process is gone can be closed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from prefect.client.orchestration import SyncPrefectClient
from prefect.client.schemas.filters import (
    FlowRunFilter,
    FlowRunFilterId,
    FlowRunFilterState,
    FlowRunFilterStateType,
    TaskRunFilter,
    TaskRunFilterState,
    TaskRunFilterStateType,
)
from prefect.client.schemas.objects import FlowRun, State, StateType
from prefect.flows import Flow
from prefect.settings import get_current_settings
from prefect.states import Crashed

from facadelake.core.processes.identity import ProcessIdentity

PENDING_MAX = timedelta(minutes=5)  # from a worker's taking a run to the run's first word
_UNFINISHED = [StateType.RUNNING, StateType.CANCELLING, StateType.PENDING]
_PAGE = 200  # runs in one answer of the server


@dataclass(frozen=True, kw_only=True)
class ClosedRun:
    """A run that was closed because nothing runs it any more."""

    flow_run_id: str
    name: str
    reason: str


def record_process(flow: Flow[..., Any], flow_run: FlowRun, state: State) -> None:
    """Hook of a flow that begins to run."""
    ProcessIdentity.from_this_process().write(_locate_note(str(flow_run.id)))


def drop_note(flow: Flow[..., Any], flow_run: FlowRun, state: State) -> None:
    """Hook of a flow that has ended, in whichever way."""
    _locate_note(str(flow_run.id)).unlink(missing_ok=True)


# Of every flow: @flow(..., **HOOKS).
HOOKS: dict[str, Any] = {
    "on_running": [record_process],
    "on_completion": [drop_note],
    "on_failure": [drop_note],
    "on_crashed": [drop_note],
    "on_cancellation": [drop_note],
}


def close_orphans(client: SyncPrefectClient, *, now: datetime | None = None) -> list[ClosedRun]:
    """Close the runs that Prefect calls running, cancelling or pending, and that no process of this machine runs.

    A killed process, a rebooted machine and a lost server leave such runs; Prefect does not notice. Their work is not
    lost: a run of the same campaign takes the finished stages from the cache.

    Args:
        client: client of the server.
        now: the time; None: the clock's.

    Returns:
        The runs that were closed, as Crashed; cancelled ones as Cancelled. Runs of other machines are left to them.
    """
    now = now or datetime.now(UTC)
    unfinished = list(_read_unfinished(client))
    closed = []
    for run in unfinished:
        reason = _find_reason(run, now)
        if reason is None:
            continue
        text = f"{reason}; closed by Facadelake, finished stages are in the cache and the next run continues after them"
        cancelled = run.state_type == StateType.CANCELLING
        state: State[Any] = State(type=StateType.CANCELLED, message=text) if cancelled else Crashed(message=text)
        _close_tasks(client, run, text)
        client.set_flow_run_state(run.id, state, force=True)
        _locate_note(str(run.id)).unlink(missing_ok=True)
        closed.append(ClosedRun(flow_run_id=str(run.id), name=run.name, reason=reason))
    _drop_stale_notes({str(run.id) for run in unfinished})
    return closed


def _find_reason(run: FlowRun, now: datetime) -> str | None:
    """Why nothing runs this run; None where something does, or where this machine cannot tell."""
    process = ProcessIdentity.read(_locate_note(str(run.id)))
    if process is not None:
        if process.is_of_this_machine and not process.is_running():
            return f"its process {process.pid} on {process.host} is gone"
        return None
    if run.state_type == StateType.PENDING and run.state is not None and now - run.state.timestamp > PENDING_MAX:
        minutes = (now - run.state.timestamp).total_seconds() / 60
        return f"a worker took it {minutes:.0f} minutes ago and it never began"
    return None


def _read_unfinished(client: SyncPrefectClient) -> Iterable[FlowRun]:
    state = FlowRunFilterState(type=FlowRunFilterStateType(any_=_UNFINISHED))
    offset = 0
    while page := client.read_flow_runs(flow_run_filter=FlowRunFilter(state=state), limit=_PAGE, offset=offset):
        yield from page
        offset += len(page)


def _close_tasks(client: SyncPrefectClient, run: FlowRun, text: str) -> None:
    state = TaskRunFilterState(type=TaskRunFilterStateType(any_=_UNFINISHED), name=None)
    found = client.read_task_runs(
        flow_run_filter=FlowRunFilter(id=FlowRunFilterId(any_=[run.id])), task_run_filter=TaskRunFilter(state=state)
    )
    for task in found:
        client.set_task_run_state(task.id, Crashed(message=text), force=True)


def _drop_stale_notes(unfinished: set[str]) -> None:
    """Drop the notes of processes that are gone and whose run is closed already."""
    for path in _get_folder().glob("*.json"):
        process = ProcessIdentity.read(path)
        if path.stem in unfinished or process is None or not process.is_of_this_machine:
            continue
        if not process.is_running():
            path.unlink(missing_ok=True)


def _get_folder() -> Path:
    """Folder of the notes, in the home of Prefect, which the processes of a service share."""
    return get_current_settings().home / "running"


def _locate_note(flow_run_id: str) -> Path:
    return _get_folder() / f"{flow_run_id}.json"
