"""Deployments on a Prefect server: those the registry asks for, the difference to those there, and its application."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from uuid import UUID

from prefect.client.orchestration import SyncPrefectClient
from prefect.client.schemas.actions import DeploymentScheduleCreate, WorkPoolCreate
from prefect.client.schemas.filters import DeploymentFilter, DeploymentFilterTags
from prefect.client.schemas.objects import ConcurrencyLimitStrategy, ConcurrencyOptions
from prefect.client.schemas.responses import DeploymentResponse
from prefect.client.schemas.schedules import CronSchedule, IntervalSchedule
from prefect.exceptions import ObjectNotFound
from prefect.flows import Flow
from prefect.utilities.callables import parameter_schema
from prefect.workers.process import ProcessWorker

from facadelake.core.checkout import CHECKOUT
from facadelake.core.errors import InputDataError
from facadelake.registry import Portfolio, Schedule, ServiceSettings
from facadelake.scheduling import find_limits
from flows.inspect_building import inspect_building
from flows.inspect_portfolio import inspect_portfolio
from flows.receive_uploads import receive_uploads

POOL = "facadelake"
# Queues of the pool, and which is served first. Intake and the closing of runs never wait for an inspection.
SERVICE_QUEUE = "service"
QUEUES = {SERVICE_QUEUE: 1, "high": 2, "normal": 3, "low": 4}
TAG = "facadelake"
_PAGE = 200  # deployments in one answer of the server


@dataclass(frozen=True, kw_only=True)
class DeploymentSpec:
    """A deployment as the registry and the service's settings ask for it.

    ``name`` with the flow's names it on Prefect's page. ``schedule``: None: by hand only. A ``Schedule`` or a number of
    seconds between two runs.
    """

    flow: Flow[..., Any]
    name: str
    queue: str
    parameters: Mapping[str, str]
    schedule: Schedule | float | None
    description: str

    @property
    def full_name(self) -> str:
        """Its name on Prefect's page."""
        return f"{self.flow.name}/{self.name}"

    @property
    def entrypoint(self) -> str:
        """The flow as Prefect imports it, from the checkout."""
        return f"{self.flow.fn.__module__}.{self.flow.fn.__name__}"


@dataclass(frozen=True, kw_only=True)
class DeploymentChange:
    """One line of a plan: ``action`` is create, change, delete or keep; ``fields``: name, before and after of each."""

    action: str
    full_name: str
    fields: tuple[tuple[str, str, str], ...] = ()


@dataclass(frozen=True, kw_only=True)
class DeploymentPlan:
    """What makes the server's deployments those of the registry."""

    changes: tuple[DeploymentChange, ...]
    specs: Mapping[str, DeploymentSpec]
    deleted: Mapping[str, Any]

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to be done."""
        return all(change.action == "keep" for change in self.changes)


def list_specs(portfolio: Portfolio, settings: ServiceSettings, settings_file: str) -> list[DeploymentSpec]:
    """The deployments of a portfolio: one of ``inspect-building`` per building, and those of the service.

    Args:
        portfolio: the buildings.
        settings: settings of the service.
        settings_file: path of their file, which the runs read again.

    Returns:
        The deployments, those of the service first.
    """
    own = {"settings": settings_file}
    service = [
        DeploymentSpec(
            flow=receive_uploads,
            name="all",
            queue=SERVICE_QUEUE,
            parameters=own,
            schedule=60 * settings.intake.every_minutes,
            description="Uploads of all buildings: what is complete is checked and becomes a campaign.",
        ),
        DeploymentSpec(
            flow=inspect_portfolio,
            name="all",
            queue="normal",
            parameters=own,
            schedule=settings.inspect,
            description="Every campaign that waits, side by side; a report of what is done, failed, due and overdue.",
        ),
    ]
    buildings = [
        DeploymentSpec(
            flow=inspect_building,
            name=building.id,
            queue=building.priority,
            parameters={"building_id": building.id, "portfolio": settings.portfolio, "lake": settings.lake},
            schedule=building.schedule,
            description=f"The latest campaign of {building.name}.",
        )
        for building in portfolio.buildings
    ]
    return [*service, *buildings]


def plan_deployments(client: SyncPrefectClient, specs: Sequence[DeploymentSpec], lake: str) -> DeploymentPlan:
    """Compare the deployments on the server with ``specs``; nothing is changed.

    Deployments of other lakes, and those that are not Facadelake's, are left alone.

    Args:
        client: client of the server.
        specs: the deployments that there should be.
        lake: the lake that they work on; deployments of this lake that are not among ``specs`` are deleted.

    Raises:
        InputDataError: a deployment of that name is there, and belongs to another lake.
    """
    held = _read_own(client)
    wanted = {spec.full_name: spec for spec in specs}
    changes = []
    for name, spec in wanted.items():
        there = held.get(name)
        if there is None:
            changes.append(DeploymentChange(action="create", full_name=name, fields=_list_new(spec)))
            continue
        if (owner := _get_lake(there)) != lake:
            raise InputDataError(
                f"the server has a deployment '{name}' of the lake {owner}, not {lake}; give each lake a server of its "
                "own (key 'port' of the settings), or remove that lake's deployments first"
            )
        fields = _list_differences(there, spec)
        changes.append(DeploymentChange(action="change" if fields else "keep", full_name=name, fields=fields))
    gone = {name: one.id for name, one in held.items() if name not in wanted and _get_lake(one) == lake}
    changes += [DeploymentChange(action="delete", full_name=name) for name in sorted(gone)]
    return DeploymentPlan(changes=tuple(changes), specs=wanted, deleted=gone)


def apply_deployments(client: SyncPrefectClient, plan: DeploymentPlan, settings: ServiceSettings) -> None:
    """Create, change and delete what the plan says, with the work pool; a deployment paused by hand stays paused."""
    create_pool(client, find_limits(settings.limits).side_by_side)
    for change in plan.changes:
        if change.action == "delete":
            client.delete_deployment(plan.deleted[change.full_name])
        elif change.action != "keep":
            _write(client, plan.specs[change.full_name], settings.lake)


def create_pool(client: SyncPrefectClient, side_by_side: int) -> None:
    """Create the work pool and its queues where they are missing; each queue of inspections runs ``side_by_side``.

    Buildings whose schedules have one date would otherwise start all at once.
    """
    try:
        client.read_work_pool(POOL)
    except ObjectNotFound:
        template = ProcessWorker.get_default_base_job_template()
        client.create_work_pool(WorkPoolCreate(name=POOL, type="process", base_job_template=template))
    there = {queue.name: queue for queue in client.read_work_queues(work_pool_name=POOL)}
    for name, priority in QUEUES.items():
        limit = None if name == SERVICE_QUEUE else side_by_side
        if name not in there:
            client.create_work_queue(name=name, priority=priority, concurrency_limit=limit, work_pool_name=POOL)
        elif there[name].concurrency_limit != limit:
            client.update_work_queue(there[name].id, concurrency_limit=limit)


def read_deployment_names(client: SyncPrefectClient) -> dict[UUID, str]:
    """The names of Facadelake's deployments on the server, flow/name, by their ids."""
    return {deployment.id: name for name, deployment in _read_own(client).items()}


def _read_own(client: SyncPrefectClient) -> dict[str, DeploymentResponse]:
    """Facadelake's deployments on the server by flow/name."""
    own = DeploymentFilter(tags=DeploymentFilterTags(all_=[TAG]))
    found: list[DeploymentResponse] = []
    while page := client.read_deployments(deployment_filter=own, limit=_PAGE, offset=len(found)):
        found += page
    flows = {flow_id: client.read_flow(flow_id).name for flow_id in {one.flow_id for one in found}}
    return {f"{flows[one.flow_id]}/{one.name}": one for one in found}


def _write(client: SyncPrefectClient, spec: DeploymentSpec, lake: str) -> None:
    """Create the deployment, or replace what differs: the server takes a second one of the name as its new version."""
    schedules = [] if spec.schedule is None else [DeploymentScheduleCreate(schedule=_make_schedule(spec.schedule))]
    client.create_deployment(
        flow_id=client.create_flow_from_name(spec.flow.name),
        name=spec.name,
        description=spec.description,
        parameters=dict(spec.parameters),
        schedules=schedules,
        tags=_list_tags(spec, lake),
        entrypoint=spec.entrypoint,
        path=str(CHECKOUT),
        pull_steps=[{"prefect.deployments.steps.set_working_directory": {"directory": str(CHECKOUT)}}],
        work_pool_name=POOL,
        work_queue_name=spec.queue,
        concurrency_limit=1,  # two runs of one building would do the same work twice
        concurrency_options=ConcurrencyOptions(collision_strategy=ConcurrencyLimitStrategy.ENQUEUE),
        parameter_openapi_schema=parameter_schema(spec.flow).model_dump_for_openapi(),
        enforce_parameter_schema=True,
    )


def _list_tags(spec: DeploymentSpec, lake: str) -> list[str]:
    building = [f"building:{spec.name}"] if "building_id" in spec.parameters else []
    return [TAG, f"lake:{lake}", *building]


def _get_lake(deployment: DeploymentResponse) -> str | None:
    return next((tag.removeprefix("lake:") for tag in deployment.tags or () if tag.startswith("lake:")), None)


def _make_schedule(schedule: Schedule | float) -> CronSchedule | IntervalSchedule:
    if isinstance(schedule, Schedule):
        return CronSchedule(cron=schedule.cron, timezone=schedule.timezone)
    return IntervalSchedule.model_validate({"interval": schedule})


def _describe_spec(spec: DeploymentSpec) -> dict[str, str]:
    """What a plan shows and compares of a wanted deployment."""
    if spec.schedule is None:
        schedule = "by hand"
    elif isinstance(spec.schedule, Schedule):
        schedule = f"{spec.schedule.cron} {spec.schedule.timezone}"
    else:
        schedule = f"every {spec.schedule:g} s"
    return {
        "schedule": schedule,
        "queue": spec.queue,
        **{f"parameter {name}": value for name, value in sorted(spec.parameters.items())},
        "entrypoint": spec.entrypoint,
        "checkout": str(CHECKOUT),
    }


def _describe_held(deployment: DeploymentResponse) -> dict[str, str]:
    """The same of a deployment on the server."""
    texts = []
    for held in deployment.schedules or ():
        schedule = held.schedule
        if isinstance(schedule, CronSchedule):
            texts.append(f"{schedule.cron} {schedule.timezone or 'UTC'}")
        elif isinstance(schedule, IntervalSchedule):
            texts.append(f"every {schedule.interval.total_seconds():g} s")
        else:
            texts.append(str(schedule))
        if not held.active:
            texts[-1] += " (switched off)"
    return {
        "schedule": "; ".join(texts) or "by hand",
        "queue": deployment.work_queue_name or "none",
        **{f"parameter {name}": str(value) for name, value in sorted(deployment.parameters.items())},
        "entrypoint": deployment.entrypoint or "none",
        "checkout": deployment.path or "none",
    }


def _list_new(spec: DeploymentSpec) -> tuple[tuple[str, str, str], ...]:
    return tuple((name, "", value) for name, value in _describe_spec(spec).items() if name in ("schedule", "queue"))


def _list_differences(there: DeploymentResponse, spec: DeploymentSpec) -> tuple[tuple[str, str, str], ...]:
    before, after = _describe_held(there), _describe_spec(spec)
    if before["schedule"].endswith(" (switched off)") and before["schedule"].startswith(after["schedule"]):
        before["schedule"] = after["schedule"]  # somebody switched it off on Prefect's page; that is kept
    names = dict.fromkeys([*before, *after])
    return tuple((n, before.get(n, ""), after.get(n, "")) for n in names if before.get(n) != after.get(n))
