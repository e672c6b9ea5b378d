"""How long a folder has been without a change, as we have seen it ourselves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, and_, select

from facadelake.intake.ledger import FOLDERS
from facadelake.intake.observation_time import ObservationTime


@dataclass(frozen=True, kw_only=True)
class FolderKey:
    """A folder of a building: the place that it is in, and its name there."""

    building_id: str
    place: str
    name: str


@dataclass(frozen=True, kw_only=True)
class ObservedFolder:
    """What the ledger knows of a folder after the latest observation.

    ``quiet_s``: observed time without a change. ``waited_s``: observed time since it was first seen, or since its
    upload was received.
    """

    id: int
    first_seen_s: float
    unchanged_since_s: float
    quiet_s: float
    waited_s: float


def observe_folder(connection: Connection, key: FolderKey, fingerprint: str, at: ObservationTime) -> ObservedFolder:
    """Record an observation of a folder.

    Args:
        connection: a transaction of the ledger.
        key: the folder.
        fingerprint: that of its listing.
        at: when it was listed.

    Returns:
        since when, and for how long, the listing has been the same. A change is dated to the observation that finds it.
    """
    row = connection.execute(
        select(FOLDERS).where(
            and_(FOLDERS.c.building_id == key.building_id, FOLDERS.c.place == key.place, FOLDERS.c.name == key.name)
        )
    ).one_or_none()
    moment: dict[str, Any] = {"observed_s": at.unix_s, "boot_id": at.boot_id, "boot_s": at.boot_s}
    if row is None:
        new = {"first_seen_s": at.unix_s, "unchanged_since_s": at.unix_s, "quiet_s": 0.0, "waited_s": 0.0}
        named = {"building_id": key.building_id, "place": key.place, "name": key.name, "fingerprint": fingerprint}
        folder_id = connection.scalar(FOLDERS.insert().values(**named, **new, **moment).returning(FOLDERS.c.id))
        return ObservedFolder(id=folder_id or 0, **new)
    step_s = at.measure_since(ObservationTime(unix_s=row.observed_s, boot_id=row.boot_id, boot_s=row.boot_s))
    is_same = row.fingerprint == fingerprint
    observed = ObservedFolder(
        id=row.id,
        first_seen_s=row.first_seen_s,
        unchanged_since_s=row.unchanged_since_s if is_same else at.unix_s,
        quiet_s=row.quiet_s + step_s if is_same else 0.0,
        waited_s=row.waited_s + step_s,
    )
    connection.execute(
        FOLDERS.update()
        .where(FOLDERS.c.id == row.id)
        .values(
            fingerprint=fingerprint,
            unchanged_since_s=observed.unchanged_since_s,
            quiet_s=observed.quiet_s,
            waited_s=observed.waited_s,
            **moment,
        )
    )
    return observed
