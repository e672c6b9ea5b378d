"""The settings of the service: one file ``facadelake.yaml`` for what runs unattended."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import AfterValidator, Field, ValidationError

from facadelake.core.errors import InputDataError
from facadelake.registry.portfolio import resolve_location
from facadelake.registry.settings import Schedule, StrictModel

SETTINGS_FILE = "facadelake.yaml"


def _check_database(url: str) -> str:
    if not url.startswith(("postgresql://", "postgres://")):
        raise ValueError("not a PostgreSQL database; give postgresql://user:password@host:5432/name, or leave it out")
    return url


class IntakeLimits(StrictModel):
    """How uploads are observed: how often, when they are complete without a marker, and when they are told of."""

    every_minutes: Annotated[float, Field(gt=0, le=1440)] = 5
    quiet_minutes: Annotated[float, Field(gt=0, le=14400)] = 30
    stalled_days: Annotated[float, Field(gt=0, le=366)] = 3


class RunLimits(StrictModel):
    """Limits of the inspections on this machine; None: those of the machine.

    ``memory_gib``: all together. ``side_by_side``: how many at once at most.
    """

    memory_gib: Annotated[float, Field(gt=0)] | None = None
    side_by_side: Annotated[int, Field(ge=1, le=64)] | None = None


class NotifySetting(StrictModel):
    """Who is told of what: addresses in Apprise's notation, such as mailto:// or json://host/path."""

    to: tuple[Annotated[str, Field(min_length=3)], ...] = ()
    on: tuple[Literal["failed", "worst_grade", "growth", "overdue", "intake"], ...] = (
        "failed", "worst_grade", "growth", "overdue", "intake",
    )  # fmt: skip


class ServiceSettings(StrictModel):
    """What the service runs, where, and within which limits.

    ``database``: PostgreSQL of Prefect and of the intake's ledger; None: SQLite files in the lake's folder. The lake's
    catalog is a SQLite file either way.
    ``port``: of Prefect's page. ``inspect``: when all that waits is inspected.
    """

    portfolio: str = "data/portfolio.yaml"
    lake: str = "lake"
    database: Annotated[str, AfterValidator(_check_database)] | None = None
    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=1, le=65535)] = 4200
    inspect: Schedule = Schedule(cron="0 2 * * *")
    intake: IntakeLimits = IntakeLimits()
    limits: RunLimits = RunLimits()
    notify: NotifySetting = NotifySetting()


def read_service_settings(path: Path) -> ServiceSettings:
    """Read the settings; paths are relative to the file. A file that does not exist means the defaults.

    Raises InputDataError that lists all mistakes with key, value and what is allowed.
    """
    content: object = {}
    if path.exists():
        try:
            content = yaml.safe_load(path.read_text(encoding="utf-8")) or {}
        except (OSError, yaml.YAMLError, UnicodeDecodeError) as error:
            raise InputDataError(f"{path}: not readable as YAML: {' '.join(str(error).split())}") from error
    if not isinstance(content, dict):
        raise InputDataError(
            f"{path} is {type(content).__name__}; a mapping with {', '.join(ServiceSettings.model_fields)}"
        )
    try:
        settings = ServiceSettings.model_validate(content)
    except ValidationError as error:
        mistakes = [
            f"{'.'.join(map(str, one['loc']))}: {one['msg'].removeprefix('Value error, ')}" for one in error.errors()
        ]
        raise InputDataError(f"{path} has mistakes:\n  " + "\n  ".join(mistakes)) from error
    located = {name: resolve_location(getattr(settings, name), path) for name in ("portfolio", "lake")}
    return settings.model_copy(update=located)
