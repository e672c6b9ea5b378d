"""Results of expensive, deterministic stages, stored under a key of their inputs and of the code that computes them.

An entry is a folder ``root/<stage>/<key>`` with a ``manifest.json`` that records size and SHA-256 of every file. It
appears atomically (written to a temporary folder, then renamed) and is verified whenever it is used: an entry that was
truncated, corrupted or edited is computed again, with a warning.
"""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
import time
import uuid
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout
from pydantic import BaseModel

from facadelake.core.code_version import compute_code_version
from facadelake.core.hashing import compute_key, hash_file

log = logging.getLogger(__name__)

MANIFEST = "manifest.json"
# Subfolder of an entry for logs and times; its files are verified, but no later stage depends on them.
DIAGNOSTICS = "diagnostics"
# Bytes of the temporary folder that an entry was made with, in its diagnostics.
WORK_SIZE_FILE = "work_size_bytes.txt"
# An entry used within this time may belong to a running inspection; pruning keeps it.
IN_USE_S = 86400.0


@dataclass(frozen=True, kw_only=True)
class CachedResult:
    """An entry's folder, the hash of its contents without diagnostics, and whether it existed before (``hit``)."""

    folder: Path
    content_sha256: str
    hit: bool


@dataclass(frozen=True, kw_only=True)
class CacheEntry:
    """One entry on disk: size in bytes, last use in seconds since the epoch."""

    stage: str
    key: str
    folder: Path
    size_bytes: int
    used_at_s: float


@dataclass(frozen=True, kw_only=True)
class PruneReport:
    """Result of pruning.

    ``removed``: entries removed. ``needed`` and ``in_use``: entries beyond a limit that were kept because a version of
    the lake needs them, or because a run may use them. ``leftovers``: folders of interrupted runs that were removed.
    ``unrecorded``: results without a manifest that were removed.
    """

    removed: tuple[CacheEntry, ...]
    needed: tuple[CacheEntry, ...]
    in_use: tuple[CacheEntry, ...]
    leftovers: tuple[Path, ...]
    unrecorded: tuple[Path, ...]


def open_stage_cache(lake: Path) -> StageCache:
    """The cache of the lake in folder ``lake``; its folder is created with the first entry."""
    return StageCache(root=lake / "cache")


def compute_stage_key(stage: str, module: str, reads: Mapping[str, str | None], inputs: Mapping[str, Any]) -> str:
    """The key of a stage's result: everything that the result depends on.

    Args:
        stage: name of the stage.
        module: module whose code makes the result; its code version enters the key.
        reads: content hashes of the results of earlier stages that it reads, by name; None where there is none.
        inputs: everything else: settings and hashes of files, JSON-able.
    """
    return compute_key(
        {"stage": stage, "code": compute_code_version(module).sha256, "reads": dict(reads), "inputs": dict(inputs)}
    )


@dataclass(frozen=True, kw_only=True)
class StageCache:
    """The entries below ``root``."""

    root: Path

    def get_or_make(self, stage: str, key: str, make: Callable[[Path], None]) -> CachedResult:
        """The entry of ``key``; ``make(folder)`` computes it where it is missing or damaged.

        A lock ensures that no two processes compute it at the same time.
        """
        folder = self.root / stage / key
        content = self._verify(folder)
        if content is not None:
            return CachedResult(folder=folder, content_sha256=content, hit=True)
        folder.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(folder.parent / f".{key}.lock"):
            content = self._verify(folder)
            if content is not None:
                return CachedResult(folder=folder, content_sha256=content, hit=True)
            _remove(folder)
            for part in folder.parent.glob(f".{key}.*.part"):  # of a killed run: the lock is held, no process writes it
                shutil.rmtree(part, ignore_errors=True)
            part = folder.parent / f".{key}.{uuid.uuid4().hex[:8]}.part"
            part.mkdir()
            try:
                make(part)
                content = _write_manifest(part, stage, key)
                part.rename(folder)
            finally:
                shutil.rmtree(part, ignore_errors=True)
        return CachedResult(folder=folder, content_sha256=content, hit=False)

    def _verify(self, folder: Path) -> str | None:
        """The recorded hash of an intact entry, whose last use becomes now; None where it is missing or damaged."""
        if not os.path.lexists(folder):
            return None
        damage = find_damage(folder)
        if damage:
            log.warning("the cached result %s is damaged (%s); it is computed again", folder, damage)
            return None
        with suppress(OSError):  # a cache on a read-only disk can still be read
            os.utime(folder / MANIFEST)
        return _read_manifest(folder).content_sha256

    def list_entries(self) -> tuple[CacheEntry, ...]:
        """All entries that have a manifest, by stage and key; their files are not verified."""
        return tuple(self._walk_entries())

    def _walk_entries(self) -> Iterator[CacheEntry]:
        for path in sorted(self.root.glob(f"*/*/{MANIFEST}")):
            folder = path.parent
            if folder.name.startswith("."):
                continue
            with suppress(OSError):  # removed by another process
                size = compute_size_bytes(folder)
                yield CacheEntry(
                    stage=folder.parent.name,
                    key=folder.name,
                    folder=folder,
                    size_bytes=size,
                    used_at_s=path.stat().st_mtime,
                )

    def find_leftovers(self) -> tuple[Path, ...]:
        """Folders that interrupted runs left."""
        return tuple(sorted(path for path in self.root.glob("*/.*") if path.is_dir()))

    def find_unrecorded(self) -> tuple[Path, ...]:
        """Results without a manifest: an earlier Facadelake stored them, or the manifest was removed. Never used."""
        found = (path for path in self.root.glob("*/[!.]*") if path.is_dir() and not (path / MANIFEST).is_file())
        return tuple(sorted(found))

    def prune(
        self,
        *,
        needed: Collection[str],
        older_than_s: float | None = None,
        max_size_bytes: int | None = None,
        dry_run: bool = False,
    ) -> PruneReport:
        """Remove entries not used for ``older_than_s``, and the longest unused until ``max_size_bytes`` is kept.

        Args:
            needed: keys that are kept whatever the limits are.
            older_than_s: age in seconds since the last use beyond which an entry is removed; None: no limit.
            max_size_bytes: size of the cache in bytes beyond which entries are removed; None: no limit.
            dry_run: report what would be removed, and remove nothing.

        Returns:
            What was removed, and what was kept although a limit applied. Entries that were used within the last day, or
            are locked by a run, are kept. Results without a manifest and folders of interrupted runs are removed after
            a day, but an interrupted reconstruction that can be resumed only where ``older_than_s`` is given.
        """
        entries = sorted(self.list_entries(), key=lambda entry: entry.used_at_s)
        kept_bytes = sum(entry.size_bytes for entry in entries)
        removed, needed_entries, in_use = [], [], []
        for entry in entries:
            age_s = time.time() - entry.used_at_s
            too_old = older_than_s is not None and age_s > older_than_s
            too_much = max_size_bytes is not None and kept_bytes > max_size_bytes
            if not (too_old or too_much):
                continue
            if entry.key in needed:
                needed_entries.append(entry)
            elif age_s < IN_USE_S or not (dry_run or _remove_unlocked(entry.folder)):
                in_use.append(entry)
            else:
                removed.append(entry)
                kept_bytes -= entry.size_bytes
        leftovers = [path for path in self.find_leftovers() if self._is_abandoned(path, older_than_s)]
        unrecorded = [path for path in self.find_unrecorded() if self._is_abandoned(path, older_than_s)]
        if not dry_run:
            for path in [*leftovers, *unrecorded]:
                shutil.rmtree(path, ignore_errors=True)
        return PruneReport(
            removed=tuple(removed),
            needed=tuple(needed_entries),
            in_use=tuple(in_use),
            leftovers=tuple(leftovers),
            unrecorded=tuple(unrecorded),
        )

    @staticmethod
    def _is_abandoned(path: Path, older_than_s: float | None) -> bool:
        age_s = time.time() - path.stat().st_mtime
        if path.name.startswith(".work-"):
            return older_than_s is not None and age_s > max(IN_USE_S, older_than_s)
        return age_s > IN_USE_S


def compute_size_bytes(folder: Path) -> int:
    """Bytes of all files below a folder."""
    return sum(found.stat().st_size for found in folder.rglob("*") if found.is_file())


class _Manifest(BaseModel, frozen=True, strict=True, extra="forbid"):
    """What is recorded of an entry: its place, and size and SHA-256 of every file by its path."""

    stage: str
    key: str
    content_sha256: str
    files: dict[str, tuple[int, str]]

    def compute_content_sha256(self) -> str:
        """The hash of the files' paths and contents, without diagnostics."""
        digest = hashlib.sha256()
        for name, (_, sha256) in sorted(self.files.items()):
            if not name.startswith(f"{DIAGNOSTICS}/"):
                digest.update(f"{name}\0{sha256}\0".encode())
        return digest.hexdigest()


def find_damage(folder: Path) -> str:
    """How an entry differs from its manifest, or the manifest from its place; empty where it is intact."""
    try:
        recorded = _read_manifest(folder)
    except (OSError, ValueError) as error:
        return f"no readable {MANIFEST}: {error}"
    if (recorded.stage, recorded.key) != (folder.parent.name, folder.name):
        return f"it is the result {recorded.stage}/{recorded.key}"
    if recorded.content_sha256 != recorded.compute_content_sha256():
        return f"the content_sha256 of {MANIFEST} is not that of its files"
    found = _list_files(folder)
    if found.keys() != recorded.files.keys():
        differing = sorted(found.keys() ^ recorded.files.keys())
        return f"{'added' if differing[0] in found else 'missing'}: {differing[0]}"
    for name, path in found.items():
        size, sha256 = recorded.files[name]
        if path.stat().st_size != size:
            return f"{name} has {path.stat().st_size} bytes, {size} were written"
        if hash_file(path) != sha256:
            return f"{name} was changed"
    return ""


def _read_manifest(folder: Path) -> _Manifest:
    """The manifest of an entry; raises ValueError where its structure is wrong."""
    return _Manifest.model_validate_json((folder / MANIFEST).read_bytes())


def _list_files(folder: Path) -> dict[str, Path]:
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file() and path != folder / MANIFEST]
    return {path.relative_to(folder).as_posix(): path for path in paths}


def _write_manifest(folder: Path, stage: str, key: str) -> str:
    files = {name: (path.stat().st_size, hash_file(path)) for name, path in _list_files(folder).items()}
    manifest = _Manifest(stage=stage, key=key, content_sha256="", files=files)
    manifest = manifest.model_copy(update={"content_sha256": manifest.compute_content_sha256()})
    (folder / MANIFEST).write_text(manifest.model_dump_json(indent=1), encoding="utf-8")
    return manifest.content_sha256


def _remove(folder: Path) -> None:
    """Remove an entry; it is renamed first, so that a partly removed entry never has a key's name."""
    if folder.is_symlink() or folder.is_file():
        folder.unlink()
    elif folder.is_dir():
        renamed = folder.with_name(f".{folder.name}.{uuid.uuid4().hex[:8]}.part")
        folder.rename(renamed)
        shutil.rmtree(renamed, ignore_errors=True)


def _remove_unlocked(folder: Path) -> bool:
    """Remove an entry unless a run holds its lock; returns whether it was removed."""
    try:
        with FileLock(folder.parent / f".{folder.name}.lock", timeout=0):
            _remove(folder)
    except Timeout:
        return False
    return True
