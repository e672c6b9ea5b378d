"""Photographs in place against those of a campaign in the lake, and files whose change allows another attempt.

Names and sizes are compared first. A file of the same size may have another content only where it was written after the
run began; the time that tells this is that of the last change of the file's record (ctime), which copying programs
cannot set back as they do with modification times. Such files are hashed.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from facadelake.core.hashing import compute_key, hash_file
from facadelake.photos import find_photographs
from facadelake.registry import CAMPAIGN, Building, CocoDetectorSetting


@dataclass(frozen=True, kw_only=True)
class FileRecord:
    """What the file system says of a file; times in nanoseconds since 1970."""

    bytes: int
    modified_ns: int
    changed_ns: int


@dataclass(frozen=True, kw_only=True)
class CommittedPhotograph:
    """A photograph of a campaign in the lake."""

    bytes: int
    sha256: str


@dataclass(frozen=True, kw_only=True)
class PhotographChanges:
    """Photographs that a folder has more, less, or with another content than the campaign in the lake."""

    added: tuple[str, ...] = ()
    gone: tuple[str, ...] = ()
    changed: tuple[str, ...] = ()

    def describe(self) -> str:
        """Such as ``2 photographs added, 1 changed``; empty where there are none."""
        counts = [(len(self.added), "added"), (len(self.changed), "changed"), (len(self.gone), "gone")]
        said = [f"{count} {word}" for count, word in counts if count]
        return f"photographs: {', '.join(said)}" if said else ""


def list_photograph_files(folder: Path) -> dict[str, FileRecord]:
    """The photographs in ``folder`` by their photo_id."""
    return _record_files(find_photographs(folder), folder)


def compute_listing(files: Mapping[str, FileRecord]) -> str:
    """A hash over the names and records of files."""
    return compute_key({name: [one.bytes, one.modified_ns, one.changed_ns] for name, one in files.items()})


def find_last_change(folder: Path) -> datetime:
    """When anything below ``folder`` was last written, or put there."""
    latest = folder.stat().st_mtime_ns
    for path in folder.rglob("*"):
        try:
            record = path.stat()
        except OSError:
            continue  # gone since it was listed
        latest = max(latest, record.st_ctime_ns, record.st_mtime_ns if path.is_dir() else 0)
    return datetime.fromtimestamp(latest / 1e9, UTC)


def compare_photographs(
    folder: Path,
    files: Mapping[str, FileRecord],
    committed: Mapping[str, CommittedPhotograph],
    *,
    run_started_at: datetime,
    compared_before: bool,
) -> PhotographChanges:
    """Compare the photographs in place with those of the campaign in the lake.

    Args:
        folder: the photographs' folder.
        files: what is in it.
        committed: the photographs of the campaign in the lake.
        run_started_at: start of the run that committed it.
        compared_before: whether these files, by their records, were found equal before.

    Returns:
        What differs.
    """
    changed = []
    since_ns = run_started_at.timestamp() * 1e9
    for name in sorted(files.keys() & committed.keys()):
        here, there = files[name], committed[name]
        if not there.sha256:  # the run could not read it
            differs = os.access(folder / name, os.R_OK)
        elif here.bytes != there.bytes:
            differs = True
        elif here.changed_ns < since_ns or compared_before:
            differs = False
        else:
            differs = hash_file(folder / name) != there.sha256
        if differs:
            changed.append(name)
    return PhotographChanges(
        added=tuple(sorted(files.keys() - committed.keys())),
        gone=tuple(sorted(committed.keys() - files.keys())),
        changed=tuple(changed),
    )


def compute_fingerprint(building: Building, campaign_id: str, *, code_sha256: str, committed: Mapping[str, str]) -> str:
    """A hash of all that an inspection is made of: files, settings, code, and the building's other campaigns.

    Args:
        building: the building.
        campaign_id: the campaign.
        code_sha256: the code's version.
        committed: run ids of the building's campaigns in the lake, which can place this one.

    Returns:
        The hash; files enter by name, size and times, so that touching one is enough to have the campaign tried again.
    """
    photographs = building.locate_photographs(campaign_id)
    templates = [
        building.model, building.crs.offset_file, building.control_points, building.poses,
        building.positions.file if building.positions else None,
    ]  # fmt: skip
    detector = building.detector
    templates += [detector.file] if isinstance(detector, CocoDetectorSetting) else [detector.model, detector.card]
    named = [Path(text.replace(CAMPAIGN, campaign_id)) for text in templates if text]
    files = {str(path): path for top in (photographs, *named) for path in _walk_files(top)}
    settings = building.model_dump(mode="json", exclude={"schedule", "priority", "intake", "name"})
    listing = {name: _record(path) for name, path in sorted(files.items())}
    return compute_key(
        {
            "files": {name: [one.bytes, one.modified_ns, one.changed_ns] for name, one in listing.items() if one},
            "settings": settings,
            "code": code_sha256,
            "campaigns": {name: run for name, run in committed.items() if name != campaign_id},
        }
    )


def _walk_files(top: Path) -> Iterable[Path]:
    return (path for path in top.rglob("*") if path.is_file()) if top.is_dir() else [top] if top.is_file() else []


def _record_files(paths: Iterable[Path], folder: Path) -> dict[str, FileRecord]:
    records = {path.relative_to(folder).as_posix(): _record(path) for path in paths}
    return {name: record for name, record in records.items() if record}


def _record(path: Path) -> FileRecord | None:
    try:
        found = path.stat()
    except OSError:
        return None  # gone since it was listed
    return FileRecord(bytes=found.st_size, modified_ns=found.st_mtime_ns, changed_ns=found.st_ctime_ns)
