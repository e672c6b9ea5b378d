"""Uploads as the ledger has them: their state, why they are in it, and the facts of their files."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum

from sqlalchemy import Connection, and_, select

from facadelake.intake.ledger import FILES, FOLDERS, SOURCES, UPLOADS, has_ledger, open_ledger
from facadelake.intake.listing import ListedFile
from facadelake.intake.photograph_facts import FileFacts
from facadelake.registry import ServiceSettings


class UploadState(StrEnum):
    """State of an upload."""

    GROWING = "growing"  # not complete
    STALLED = "stalled"  # not complete for a long time
    REFUSED = "refused"  # complete, and it contradicts something; a person has to answer
    FAILED = "failed"  # it could not be received; it is tried again
    RECEIVED = "received"  # its photographs are in their campaign's folder
    REMOVED = "removed"  # it went from the source before it was received


@dataclass(frozen=True, kw_only=True)
class Upload:
    """An upload: a folder of a building's source.

    ``since`` is when it got into its state. ``unchanged_since`` is when its latest change was observed. ``reason`` says
    what it waits for or what is wrong, and what to bring; ``remarks`` what else is to be known of its files.
    ``campaign_id`` None: not known yet. ``received_at``: of its latest photographs; None: none are received.
    """

    building_id: str
    source: str
    folder: str
    state: UploadState
    since: datetime
    unchanged_since: datetime
    reason: str
    remarks: tuple[str, ...]
    campaign_id: str | None
    photographs: int
    files: int
    bytes: int
    received_at: datetime | None
    in_source: bool


@dataclass(frozen=True, kw_only=True)
class SourceProblem:
    """A source that cannot be listed, or holds photographs outside folders."""

    building_id: str
    source: str
    problem: str


@dataclass(frozen=True, kw_only=True)
class UploadRow:
    """What the ledger keeps of an upload beside its folder: see ``facadelake.intake.ledger``."""

    state: UploadState
    state_since_s: float
    photographs: int = 0
    files: int = 0
    bytes: int = 0
    reason: str = ""
    remarks: tuple[str, ...] = ()
    campaign_id: str | None = None
    complete: str = ""
    examined: str = ""
    judged: str = ""
    received: str = ""
    received_s: float | None = None
    attempts: int = 0
    retry_quiet_s: float = 0.0
    in_source: bool = True


def load_row(connection: Connection, folder_id: int) -> UploadRow | None:
    """The row of an upload; None where there is none yet."""
    row = connection.execute(select(UPLOADS).where(UPLOADS.c.folder_id == folder_id)).mappings().one_or_none()
    if row is None:
        return None
    values = {key: row[key] for key in row if key not in ("folder_id", "told")}
    return UploadRow(
        **values
        | {"state": UploadState(values["state"]), "remarks": tuple(filter(None, values["remarks"].split("\n")))}
    )


def save_row(connection: Connection, folder_id: int, row: UploadRow) -> None:
    """Write the row of an upload."""
    values = vars(row) | {"state": row.state.value, "remarks": "\n".join(row.remarks)}
    changed = connection.execute(UPLOADS.update().where(UPLOADS.c.folder_id == folder_id).values(**values))
    if not changed.rowcount:
        connection.execute(UPLOADS.insert().values(folder_id=folder_id, **values))


def restart_waiting(connection: Connection, building_id: str) -> None:
    """Begin anew to count for how long an upload is waited for, where it is received or refused."""
    answered = select(UPLOADS.c.folder_id).where(UPLOADS.c.state.in_([UploadState.RECEIVED, UploadState.REFUSED]))
    chosen = and_(FOLDERS.c.building_id == building_id, FOLDERS.c.id.in_(answered))
    connection.execute(FOLDERS.update().where(chosen).values(waited_s=0.0))


def load_facts(connection: Connection, folder_id: int) -> dict[str, FileFacts]:
    """The facts of an upload's files by their paths."""
    rows = connection.execute(select(FILES).where(FILES.c.folder_id == folder_id))
    return {
        row.path: FileFacts(
            file=ListedFile(path=row.path, bytes=row.bytes, modified_ns=row.modified_ns),
            sha256=row.sha256,
            is_photograph=row.is_photograph,
            problem=row.problem,
            taken_at=datetime.fromisoformat(row.taken_at) if row.taken_at else None,
            lon_deg=math.nan if row.lon_deg is None else row.lon_deg,
            lat_deg=math.nan if row.lat_deg is None else row.lat_deg,
            is_received=row.is_received,
        )
        for row in rows
    }


def save_facts(connection: Connection, folder_id: int, facts: Iterable[FileFacts]) -> None:
    """Write the facts of files, in place of those of the same paths."""
    rows = [
        {
            "folder_id": folder_id,
            "path": one.file.path,
            "bytes": one.file.bytes,
            "modified_ns": one.file.modified_ns,
            "sha256": one.sha256,
            "is_photograph": one.is_photograph,
            "problem": one.problem,
            "taken_at": one.taken_at.isoformat() if one.taken_at else None,
            "lon_deg": one.lon_deg if one.has_position else None,
            "lat_deg": one.lat_deg if one.has_position else None,
            "is_received": one.is_received,
        }
        for one in facts
    ]
    for row in rows:
        connection.execute(FILES.delete().where(and_(FILES.c.folder_id == folder_id, FILES.c.path == row["path"])))
    if rows:
        connection.execute(FILES.insert(), rows)


def read_uploads(connection: Connection) -> tuple[Upload, ...]:
    """All uploads of the ledger, by building and folder."""
    joined = select(FOLDERS, UPLOADS).join_from(FOLDERS, UPLOADS).order_by(FOLDERS.c.building_id, FOLDERS.c.name)
    return tuple(
        Upload(
            building_id=row["building_id"],
            source=row["place"],
            folder=row["name"],
            state=UploadState(row["state"]),
            since=_time_from_unix(row["state_since_s"]),
            unchanged_since=_time_from_unix(row["unchanged_since_s"]),
            reason=row["reason"],
            remarks=tuple(filter(None, row["remarks"].split("\n"))),
            campaign_id=row["campaign_id"],
            photographs=row["photographs"],
            files=row["files"],
            bytes=row["bytes"],
            received_at=None if row["received_s"] is None else _time_from_unix(row["received_s"]),
            in_source=row["in_source"],
        )
        for row in connection.execute(joined).mappings()
    )


def read_source_problems(connection: Connection) -> tuple[SourceProblem, ...]:
    """What is wrong with sources, by building."""
    rows = connection.execute(select(SOURCES).where(SOURCES.c.problem != "").order_by(SOURCES.c.building_id))
    return tuple(SourceProblem(building_id=row.building_id, source=row.source, problem=row.problem) for row in rows)


def take_news(connection: Connection) -> tuple[tuple[Upload, ...], tuple[SourceProblem, ...]]:
    """Uploads and problems of sources of which there is something new to tell, which they are then no more.

    How long an upload has been waited for is no news.
    """
    told_of = {
        (row.building_id, row.place, row.name): row
        for row in connection.execute(
            select(
                FOLDERS.c.building_id, FOLDERS.c.place, FOLDERS.c.name, UPLOADS.c.folder_id, UPLOADS.c.told
            ).join_from(FOLDERS, UPLOADS)
        )
    }
    news = []
    for upload in read_uploads(connection):
        row, text = told_of[upload.building_id, upload.source, upload.folder], _describe_news(upload)
        if row.told != text:
            news.append(upload)
            connection.execute(UPLOADS.update().where(UPLOADS.c.folder_id == row.folder_id).values(told=text))
    untold = connection.execute(select(SOURCES).where(SOURCES.c.problem != SOURCES.c.told)).all()
    for source in untold:
        connection.execute(
            SOURCES.update().where(SOURCES.c.building_id == source.building_id).values(told=source.problem)
        )
    names = {source.building_id for source in untold}
    return tuple(news), tuple(one for one in read_source_problems(connection) if one.building_id in names)


def _describe_news(upload: Upload) -> str:
    if upload.state is UploadState.GROWING:
        return upload.state
    return "\n".join([upload.state, upload.reason, *upload.remarks, str(upload.campaign_id), str(upload.received_at)])


def find_states(connection: Connection, building_id: str, campaign_id: str) -> dict[str, UploadState]:
    """The states of the uploads that were received as a campaign, by their folders."""
    rows = connection.execute(
        select(FOLDERS.c.name, UPLOADS.c.state)
        .join_from(FOLDERS, UPLOADS)
        .where(
            and_(FOLDERS.c.building_id == building_id, UPLOADS.c.campaign_id == campaign_id, UPLOADS.c.received != "")
        )
    )
    return {row.name: UploadState(row.state) for row in rows}


def list_uploads(settings: ServiceSettings) -> tuple[tuple[Upload, ...], tuple[SourceProblem, ...]]:
    """All uploads and all problems of sources, as of the last pass; none where there was no pass yet.

    Raises StoreError where the ledger cannot be read.
    """
    if not has_ledger(settings):
        return (), ()
    with open_ledger(settings).begin() as connection:
        return read_uploads(connection), read_source_problems(connection)


def describe_upload(upload: Upload) -> str:
    """One line on an upload, for a log or a message."""
    size = f"{upload.photographs} photographs, {upload.bytes / 1e6:,.1f} MB"
    campaign = f" as campaign {upload.campaign_id}" if upload.campaign_id and upload.received_at else ""
    line = f"{upload.building_id}: upload '{upload.folder}' is {upload.state}{campaign} ({size})"
    told = "; ".join(filter(None, (upload.reason, *upload.remarks)))
    return f"{line}: {told}" if told else line


def _time_from_unix(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, tz=UTC)
