"""The intake's ledger: what was observed of folders and uploads, and when; SQLite in the lake's folder, or PostgreSQL.

The ledger is no part of the lake. Where it is lost, uploads are compared with the photographs in place again.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import filelock
from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Connection,
    Engine,
    Float,
    ForeignKey,
    Integer,
    MetaData,
    Table,
    Text,
    UniqueConstraint,
    create_engine,
    event,
    select,
    text,
)
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.pool import NullPool

from facadelake.core.errors import StoreError
from facadelake.registry import ServiceSettings

LEDGER_FILE = "intake.sqlite"
_LOCK_FILE = "intake.lock"
_ADVISORY_LOCK = 0x0FACADE1A  # any number that others in the database do not use
_FORMAT = 1
_BUSY_TIMEOUT_S = 60

_TABLES = MetaData()
LEDGER = Table("intake_ledger", _TABLES, Column("format", Integer, primary_key=True))
# Folders that are observed: uploads (place: the building's source), campaigns in place (place: 'photographs').
FOLDERS = Table(
    "intake_folders",
    _TABLES,
    Column("id", Integer, primary_key=True),
    Column("building_id", Text, nullable=False),
    Column("place", Text, nullable=False),
    Column("name", Text, nullable=False),
    Column("fingerprint", Text, nullable=False),
    Column("first_seen_s", Float, nullable=False),  # seconds since 1970, UTC
    Column("unchanged_since_s", Float, nullable=False),
    Column("quiet_s", Float, nullable=False),  # observed without a change
    Column("waited_s", Float, nullable=False),  # observed since it was first seen, or received
    Column("observed_s", Float, nullable=False),
    Column("boot_id", Text, nullable=False),
    Column("boot_s", Float, nullable=False),
    UniqueConstraint("building_id", "place", "name"),
)
UPLOADS = Table(
    "intake_uploads",
    _TABLES,
    Column("folder_id", ForeignKey(FOLDERS.c.id), primary_key=True, autoincrement=False),
    Column("state", Text, nullable=False),
    Column("state_since_s", Float, nullable=False),
    Column("reason", Text, nullable=False, default=""),
    Column("remarks", Text, nullable=False, default=""),  # one a line
    Column("campaign_id", Text),
    Column("photographs", Integer, nullable=False),
    Column("files", Integer, nullable=False),
    Column("bytes", BigInteger, nullable=False),
    Column("complete", Text, nullable=False, default=""),  # fingerprint of the files that were found complete last
    Column("examined", Text, nullable=False, default=""),  # fingerprint that the rows of FILES are of
    Column("judged", Text, nullable=False, default=""),  # fingerprint with the marker, when refused or failed
    Column("received", Text, nullable=False, default=""),  # the same when received last
    Column("received_s", Float),
    Column("attempts", Integer, nullable=False, default=0),
    Column("retry_quiet_s", Float, nullable=False, default=0.0),
    Column("in_source", Boolean, nullable=False, default=True),
    Column("told", Text, nullable=False, default=""),  # what the last finished pass told of it
)
FILES = Table(
    "intake_files",
    _TABLES,
    Column("folder_id", ForeignKey(FOLDERS.c.id), primary_key=True, autoincrement=False),
    Column("path", Text, primary_key=True),
    Column("bytes", BigInteger, nullable=False),
    Column("modified_ns", BigInteger, nullable=False),
    Column("sha256", Text, nullable=False, index=True),
    Column("is_photograph", Boolean, nullable=False),
    Column("problem", Text, nullable=False),
    Column("taken_at", Text),  # as the camera's clock showed it
    Column("lon_deg", Float),
    Column("lat_deg", Float),
    Column("is_received", Boolean, nullable=False),
)
SOURCES = Table(
    "intake_sources",
    _TABLES,
    Column("building_id", Text, primary_key=True),
    Column("source", Text, nullable=False),
    Column("problem", Text, nullable=False),
    Column("told", Text, nullable=False, default=""),
)


class IntakeBusyError(StoreError):
    """Another process receives uploads at the moment; nothing was done."""


@dataclass(frozen=True, kw_only=True)
class Ledger:
    """An open ledger."""

    engine: Engine
    lock_file: Path | None

    @contextmanager
    def begin(self) -> Iterator[Connection]:
        """A transaction. Raises StoreError where the ledger cannot be read or written."""
        try:
            with self.engine.begin() as connection:
                yield connection
        except SQLAlchemyError as error:
            raise self._describe(error) from error

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Be the only process that receives uploads. Raises IntakeBusyError where another one does.

        The lock goes with the process that holds it, also where that is killed.
        """
        busy = "another process receives uploads at the moment; they are received once, by that one"
        if self.lock_file is not None:
            try:
                with filelock.FileLock(self.lock_file, timeout=0):
                    yield
            except filelock.Timeout as error:
                raise IntakeBusyError(f"{busy} (lock {self.lock_file})") from error
            return
        try:
            connection = self.engine.connect()
        except SQLAlchemyError as error:
            raise self._describe(error) from error
        with connection:
            if not connection.scalar(text("SELECT pg_try_advisory_lock(:key)"), {"key": _ADVISORY_LOCK}):
                raise IntakeBusyError(busy)
            connection.commit()
            try:
                yield
            finally:
                connection.invalidate()  # closes the session, and with it the lock

    def _describe(self, error: SQLAlchemyError) -> StoreError:
        where = self.engine.url.render_as_string(hide_password=True)
        reason = " ".join(str(getattr(error, "orig", None) or error).split())
        return StoreError(
            f"the intake's ledger {where} cannot be read or written ({reason}); check that the database answers and "
            "the disk has space. Where the ledger is damaged, move it away: uploads are then compared with the "
            "photographs in place, and nothing is received twice"
        )


def has_ledger(settings: ServiceSettings) -> bool:
    """Whether there may be a ledger: one in a database is made when it is opened."""
    return settings.database is not None or (Path(settings.lake) / LEDGER_FILE).is_file()


def open_ledger(settings: ServiceSettings) -> Ledger:
    """Open the ledger of the settings' database, else that in the lake's folder; it is made where there is none.

    Raises StoreError where it cannot be opened, or is of another version of Facadelake.
    """
    if settings.database is not None:
        address = settings.database.replace("postgres://", "postgresql://", 1)
        ledger = Ledger(
            engine=create_engine(address.replace("postgresql://", "postgresql+pg8000://", 1), poolclass=NullPool),
            lock_file=None,
        )
    else:
        folder = Path(settings.lake).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        ledger = Ledger(
            engine=_connect_sqlite(folder / LEDGER_FILE),
            lock_file=folder / _LOCK_FILE,
        )
    with ledger.begin() as connection:
        if settings.database is not None:  # two processes that make the tables at once
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _ADVISORY_LOCK + 1})
        _TABLES.create_all(connection)
        found = connection.scalar(select(LEDGER.c.format))
        if found is None:
            connection.execute(LEDGER.insert().values(format=_FORMAT))
    if found not in (None, _FORMAT):
        raise StoreError(
            f"the intake's ledger {ledger.engine.url.render_as_string(hide_password=True)} has format {found}, this "
            f"Facadelake reads {_FORMAT}; move it away: uploads are then compared with the photographs in place"
        )
    return ledger


def _connect_sqlite(path: Path) -> Engine:
    """An engine whose transactions take the write lock at their begin: two that read and then write wait in turn."""
    engine = create_engine(f"sqlite:///{path}", connect_args={"timeout": _BUSY_TIMEOUT_S}, poolclass=NullPool)

    @event.listens_for(engine, "connect")
    def _leave_transactions_to_us(connection: Any, _record: object) -> None:
        connection.isolation_level = None

    @event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        connection.exec_driver_sql("BEGIN IMMEDIATE")

    return engine
