"""Inspections side by side: each a flow run in a process of its own, a failure of one of which stops no other."""

from __future__ import annotations

import json
import logging
import os
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from uuid import UUID

from httpx import HTTPError
from prefect import Task
from prefect.client.orchestration import SyncPrefectClient, get_client
from prefect.client.schemas.filters import FlowRunFilter, FlowRunFilterId
from prefect.client.schemas.objects import State, StateType, TaskRun
from prefect.context import FlowRunContext
from prefect.exceptions import PrefectException
from prefect.states import Cancelled, Crashed
from prefect.utilities.asyncutils import run_coro_as_sync

from facadelake.core.processes.side_by_side import EndedProcess, ProcessesSideBySide
from facadelake.core.progress import report_progress
from facadelake.scheduling import CampaignOutcome, InspectionLimits, WaitingCampaign, choose_startable
from flows.campaign_process import RESULT
from flows.inspect_building import inspect_building

log = logging.getLogger("facadelake.flows")

_POLL_S = 5.0
_LAST_WORD_S = 1.5  # for the server, when all is being stopped
_MODULE = "flows.campaign_process"
_CANCELLED = (StateType.CANCELLING, StateType.CANCELLED)
_OF_THIS_RUN = "PREFECT__"  # names of variables by which Prefect controls one flow run
_OOM_COUNTER = "oom_kill "


@dataclass(kw_only=True)
class CampaignRuns:
    """The inspections of a plan; ``outcomes`` grows as they end.

    ``record`` is called with each outcome, before the next inspection is started.
    """

    portfolio: str
    lake: Path
    folder: Path
    limits: InspectionLimits
    record: Callable[[WaitingCampaign, CampaignOutcome], CampaignOutcome]
    outcomes: list[CampaignOutcome] = field(default_factory=list)
    _flow_runs: dict[str, UUID] = field(default_factory=dict)

    def run_all(self, campaigns: Sequence[WaitingCampaign]) -> None:
        """Run the inspections; an interrupt ends those that run and is raised again."""
        waiting, running = list(campaigns), dict[str, WaitingCampaign]()
        killed_before = _count_oom_kills()
        with (
            get_client(sync_client=True) as client,
            ProcessesSideBySide() as processes,
            report_progress("Campaigns", len(campaigns)) as bar,
        ):
            try:
                while waiting or running:
                    while one := choose_startable(waiting, list(running.values()), self.limits):
                        waiting.remove(one)
                        running[_name(one)] = one
                        self._start(client, processes, one)
                        log.info("%s: started (%d waiting)", _name(one), len(waiting))
                    ended = processes.wait(_POLL_S)
                    if not ended:
                        ended = processes.end(self._list_cancelled(client, list(running)))
                    for process in ended:
                        one = running.pop(process.name)
                        outcome = self._close(client, one, process, _count_oom_kills() > killed_before)
                        self.outcomes.append(self.record(one, outcome))
                        bar.advance()
                    killed_before = _count_oom_kills()
            except BaseException:
                processes.end(processes.list_running())
                self._cancel([self._flow_runs[name] for name in running])
                raise

    def _start(self, client: SyncPrefectClient, processes: ProcessesSideBySide, one: WaitingCampaign) -> None:
        parameters = {
            "building_id": one.building_id,
            "campaign_id": one.campaign_id,
            "portfolio": self.portfolio,
            "lake": str(self.lake),
        }
        flow_run_id = _create_flow_run(client, parameters, name=_name(one))
        self._flow_runs[_name(one)] = flow_run_id
        job = {"flow_run_id": str(flow_run_id), "parameters": parameters}
        processes.start(_name(one), _MODULE, job, self._locate_job(one), environment=make_environment(client))

    def _locate_job(self, one: WaitingCampaign) -> Path:
        return self.folder / one.building_id / one.campaign_id

    def _list_cancelled(self, client: SyncPrefectClient, names: list[str]) -> list[str]:
        """The running inspections that a person is cancelling on Prefect's page."""
        if not names:
            return []
        ids = [self._flow_runs[name] for name in names]
        try:
            runs = client.read_flow_runs(flow_run_filter=FlowRunFilter(id=FlowRunFilterId(any_=ids)))
        except (PrefectException, HTTPError) as error:
            log.warning("Prefect's server does not answer: %s", error)
            return []
        ending = {run.id for run in runs if run.state_type in _CANCELLED}
        return [name for name in names if self._flow_runs[name] in ending]

    def _close(
        self, client: SyncPrefectClient, one: WaitingCampaign, process: EndedProcess, out_of_memory: bool
    ) -> CampaignOutcome:
        """What became of an inspection whose process has ended; a run whose process crashed is closed."""
        folder = self._locate_job(one)
        flow_run_id = self._flow_runs[process.name]
        try:
            result: dict[str, Any] = json.loads((folder / RESULT).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            result = self._close_flow_run(client, flow_run_id, process, out_of_memory)
        outcome = CampaignOutcome(
            building_id=one.building_id,
            campaign_id=one.campaign_id,
            outcome=result["outcome"],
            problem=result.get("problem", ""),
            version=result.get("version"),
            photographs=one.photographs,
            seconds=process.seconds,
            peak_mib=process.peak_mib,
            need_mib=one.need.mib,
            warnings=tuple(result.get("warnings", ())),
            log=str(folder / "worker.log"),
        )
        if outcome.is_done:
            log.info("%s: %s, version %s", process.name, outcome.outcome, outcome.version)
        else:
            log.error("%s: %s: %s", process.name, outcome.outcome, outcome.problem)
        return outcome

    def _close_flow_run(
        self, client: SyncPrefectClient, flow_run_id: UUID, process: EndedProcess, out_of_memory: bool
    ) -> dict[str, Any]:
        problem = f"its process {process.problem or 'ended without a result'}"
        if process.killed and out_of_memory:
            problem += (
                f" when it took {process.peak_mib / 1024:.1f} GiB: the kernel ended processes for lack of memory "
                "meanwhile; it is tried again with more memory to itself"
            )
        try:
            run = client.read_flow_run(flow_run_id)
            if run.state_type in _CANCELLED:
                client.set_flow_run_state(flow_run_id, Cancelled(message="its process was ended"), force=True)
                return {"outcome": "failed", "problem": "cancelled on Prefect's page"}
            if run.state is None or not run.state.is_final():
                client.set_flow_run_state(flow_run_id, Crashed(message=problem), force=True)
        except (PrefectException, HTTPError) as error:
            log.warning("the flow run of %s is not closed: Prefect's server does not answer: %s", process.name, error)
        return {"outcome": "killed" if process.killed else "failed", "problem": problem}

    def _cancel(self, flow_run_ids: Sequence[UUID]) -> None:
        """Close flow runs that were stopped; the server may be stopping, too, so this waits for it shortly."""

        def close() -> None:
            with get_client(sync_client=True) as client:
                for flow_run_id in flow_run_ids:
                    stopped: State[Any] = Cancelled(message="the inspection of the portfolio was stopped")
                    client.set_flow_run_state(flow_run_id, stopped, force=True)

        thread = threading.Thread(target=close, daemon=True)
        thread.start()
        thread.join(_LAST_WORD_S)


def make_environment(client: SyncPrefectClient) -> dict[str, str]:
    """The environment of an inspection: the server of this run, and nothing of what a worker told this run alone.

    Where this process has started a temporary server, the children use the same one.
    """
    shared = {name: value for name, value in os.environ.items() if not name.startswith(_OF_THIS_RUN)}
    return shared | {"PREFECT_API_URL": str(client.api_url).rstrip("/")}


def _name(one: WaitingCampaign) -> str:
    return f"{one.building_id} {one.campaign_id}"


def _create_flow_run(client: SyncPrefectClient, parameters: dict[str, Any], *, name: str) -> UUID:
    """A flow run of ``inspect_building`` below the present one, as Prefect makes those of nested flows."""
    task = Task(fn=inspect_building.fn, name=inspect_building.name, version=inspect_building.version)
    task._is_subflow_tracking_task = True  # type: ignore[attr-defined]
    parent: TaskRun | None = run_coro_as_sync(
        task.create_run(flow_run_context=FlowRunContext.get(), parameters=parameters)
    )
    assert parent is not None  # None is of coroutines that were cancelled
    return client.create_flow_run(
        inspect_building, name=name, parameters=parameters, tags=["facadelake"], parent_task_run_id=parent.id
    ).id


def _count_oom_kills() -> int:
    """Processes that the kernel has ended for lack of memory since the machine's start; 0 where it does not tell."""
    try:
        lines = Path("/proc/vmstat").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0
    return sum(int(line.split()[1]) for line in lines if line.startswith(_OOM_COUNTER))
