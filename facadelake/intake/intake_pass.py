"""A pass of the intake: every source is listed, what is complete is received, and what is new is told."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from sqlalchemy import Connection, and_, select

from facadelake.core.errors import FacadelakeError, InputDataError
from facadelake.intake.campaigns_in_place import observe_in_ledger
from facadelake.intake.file_kinds import FileKind, classify_file
from facadelake.intake.ledger import FOLDERS, SOURCES, UPLOADS, Ledger, open_ledger
from facadelake.intake.listing import compute_fingerprint
from facadelake.intake.observation_time import ObservationTime, read_clock
from facadelake.intake.observed_folders import FolderKey, ObservedFolder, observe_folder
from facadelake.intake.receive import Surroundings
from facadelake.intake.source import UploadSource, open_source
from facadelake.intake.staging import list_staging, name_staging
from facadelake.intake.upload import (
    SourceProblem,
    Upload,
    UploadState,
    read_source_problems,
    read_uploads,
    restart_waiting,
    take_news,
)
from facadelake.intake.visit import UploadVisit, record_unreadable, visit_upload
from facadelake.registry import Building, ServiceSettings

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class IntakeReport:
    """A pass: all uploads, and what is new since the last pass that ended.

    ``news`` are uploads that are new, or whose state, reason or remarks changed; ``problems`` are those of sources,
    ``new_problems`` of them what is new.
    """

    uploads: tuple[Upload, ...]
    news: tuple[Upload, ...]
    problems: tuple[SourceProblem, ...]
    new_problems: tuple[SourceProblem, ...]


def receive_complete_uploads(
    buildings: Sequence[Building],
    settings: ServiceSettings,
    clock: Callable[[], ObservationTime] = read_clock,
    open_location: Callable[[str], UploadSource] = open_source,
) -> IntakeReport:
    """Observe all sources once, receive what is complete, and say what is new.

    A problem of one upload or source stops no other. The campaigns in place are observed, too, so that
    ``observe_campaign`` knows how long they have been without a change.

    Args:
        buildings: those of the portfolio.
        settings: of the service: lake or database, limits.
        clock: what tells the time.
        open_location: what opens the location of a source.

    Returns:
        the uploads, and what is new.

    Raises:
        IntakeBusyError: another process receives uploads at the moment.
        StoreError: the ledger cannot be read or written.
    """
    ledger = open_ledger(settings)
    with ledger.hold():
        now = datetime.fromtimestamp(clock().unix_s, tz=UTC).replace(tzinfo=None)
        around = Surroundings(ledger=ledger, lake=Path(settings.lake), buildings=tuple(buildings), now=now)
        _forget_left(ledger, buildings)
        for building in buildings:
            if building.intake is not None:
                problem = _receive_of_building(building, settings, around, clock, open_location)
                _save_problem(ledger, building, problem)
            _observe_campaigns(building, settings, ledger, clock())
        with ledger.begin() as connection:
            news, new_problems = take_news(connection)
            uploads = read_uploads(connection)
            _remove_leftovers(buildings, uploads)
            return IntakeReport(
                uploads=uploads,
                news=news,
                problems=read_source_problems(connection),
                new_problems=new_problems,
            )


def _observe_campaigns(building: Building, settings: ServiceSettings, ledger: Ledger, at: ObservationTime) -> None:
    with ledger.begin() as connection:
        for campaign_id in building.list_campaigns():
            try:
                observe_in_ledger(building, campaign_id, settings, connection, at)
            except InputDataError as error:  # listed in the portfolio, and not there yet
                log.debug("%s %s: %s", building.id, campaign_id, error)


def _receive_of_building(
    building: Building,
    settings: ServiceSettings,
    around: Surroundings,
    clock: Callable[[], ObservationTime],
    open_location: Callable[[str], UploadSource],
) -> str:
    """Receive the complete uploads of a building; the problem of its source, or empty."""
    assert building.intake is not None
    try:
        source = open_location(building.intake.source)
        listing = source.list_uploads()
    except (FacadelakeError, OSError, ValueError) as error:
        return str(error)
    at = clock()
    observed: dict[str, ObservedFolder] = {}
    with around.ledger.begin() as connection:
        restart_waiting(connection, building.id)
        for folder, files in listing.uploads.items():
            key = FolderKey(building_id=building.id, place=source.location, name=folder)
            observed[folder] = observe_folder(connection, key, compute_fingerprint(files), at)
        for folder, problem in listing.unreadable.items():
            key = FolderKey(building_id=building.id, place=source.location, name=folder)
            observed[folder] = observe_folder(connection, key, "", at)
            record_unreadable(connection, observed[folder].id, problem, at)
        _mark_removed(connection, building.id, source.location, set(observed), at)
    for folder, files in listing.uploads.items():
        visit = UploadVisit(
            building=building, source=source, folder=folder, files=files, observed=observed[folder], at=at
        )
        visit_upload(visit, settings, around)
    loose = [file.path for file in listing.loose if classify_file(file) is FileKind.PHOTOGRAPH]
    if loose:
        return (
            f"photographs are in the source {source.location} itself ({len(loose)}, such as {loose[0]}); put them into "
            "a folder, one for each campaign"
        )
    return ""


def _mark_removed(
    connection: Connection, building_id: str, source: str, present: Collection[str], at: ObservationTime
) -> None:
    """Record which uploads are in the source no more; what was received of them stays."""
    rows = connection.execute(
        select(FOLDERS.c.id, FOLDERS.c.name, UPLOADS.c.received)
        .join_from(FOLDERS, UPLOADS)
        .where(and_(FOLDERS.c.building_id == building_id, FOLDERS.c.place == source, UPLOADS.c.in_source))
    )
    for row in rows:
        if row.name in present:
            continue
        values: dict[str, object] = {"in_source": False}
        if not row.received:
            reason = "its folder went from the source before it was received"
            values |= {"state": UploadState.REMOVED.value, "reason": reason, "state_since_s": at.unix_s}
        connection.execute(UPLOADS.update().where(UPLOADS.c.folder_id == row.id).values(**values))


def _forget_left(ledger: Ledger, buildings: Sequence[Building]) -> None:
    """Uploads of sources that the portfolio names no more are in no source, and those sources have no problem."""
    sources = {building.id: building.intake.source for building in buildings if building.intake is not None}
    with ledger.begin() as connection:
        rows = connection.execute(
            select(FOLDERS.c.id, FOLDERS.c.building_id, FOLDERS.c.place).join_from(FOLDERS, UPLOADS)
        )
        for row in rows.all():
            if sources.get(row.building_id) != row.place:
                connection.execute(UPLOADS.update().where(UPLOADS.c.folder_id == row.id).values(in_source=False))
        connection.execute(SOURCES.delete().where(SOURCES.c.building_id.not_in(list(sources))))


def _remove_leftovers(buildings: Sequence[Building], uploads: Sequence[Upload]) -> None:
    """Remove copies of uploads that went from their source, or from the portfolio, before they were received."""
    kept = {name_staging(one.source, one.folder) for one in uploads if one.in_source}
    for parent in {building.locate_campaigns() for building in buildings if building.intake is not None}:
        for folder in list_staging(parent):
            if not any(folder.name.startswith(name) for name in kept):
                shutil.rmtree(folder, ignore_errors=True)


def _save_problem(ledger: Ledger, building: Building, problem: str) -> None:
    assert building.intake is not None
    values = {"source": building.intake.source, "problem": problem}
    with ledger.begin() as connection:
        changed = connection.execute(SOURCES.update().where(SOURCES.c.building_id == building.id).values(**values))
        if not changed.rowcount:
            connection.execute(SOURCES.insert().values(building_id=building.id, **values))
