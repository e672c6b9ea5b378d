"""Results of expensive, deterministic stages, kept by a key of their inputs and of the code that makes them.

An entry is a folder ``root/<stage>/<key>`` with a ``manifest.json`` that records size and SHA-256 of every file. It
appears whole (made beside, renamed) and is checked whenever it is used: what a full disk, a killed machine or a hand
has changed is made anew, with a warning.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import shutil
import time
import uuid
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from facadelake.core.hashing import hash_file

log = logging.getLogger(__name__)

MANIFEST = "manifest.json"
# What an entry keeps here tells how it was made (logs, times); it is checked, but no later stage depends on it.
DIAGNOSTICS = "diagnostics"
# An entry used so lately may be in use by a run that is under way; pruning leaves it.
IN_USE_S = 86400.0


@dataclass(frozen=True, kw_only=True)
class CachedResult:
    """An entry's folder, the hash of its contents (diagnostics left out), and whether it was there before."""

    folder: Path
    content_sha256: str
    hit: bool


@dataclass(frozen=True, kw_only=True)
class CacheEntry:
    """One entry as it lies on the disk: size in bytes, last use in seconds since the epoch."""

    stage: str
    key: str
    folder: Path
    size_bytes: int
    used_at_s: float


@dataclass(frozen=True, kw_only=True)
class PruneReport:
    """What pruning removed, and what it had to leave although a limit asked for it."""

    removed: tuple[CacheEntry, ...]
    needed: tuple[CacheEntry, ...]
    in_use: tuple[CacheEntry, ...]
    leftovers: tuple[Path, ...]


def open_stage_cache(lake: Path) -> StageCache:
    """The cache of the lake in folder ``lake``; nothing is made before its first entry."""
    return StageCache(root=lake / "cache")


@dataclass(frozen=True, kw_only=True)
class StageCache:
    """The entries below ``root``."""

    root: Path

    def get_or_make(self, stage: str, key: str, make: Callable[[Path], None]) -> CachedResult:
        """The entry of ``key``, made by ``make(folder)`` where it is missing or damaged; no two processes make it."""
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
            for part in folder.parent.glob(f".{key}.*.part"):  # of a killed run: we hold the lock, nobody writes it
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
        """The recorded hash of a whole entry, which counts as used now; None where there is none or it is damaged."""
        if not folder.is_dir():
            return None
        damage = find_damage(folder)
        if damage:
            log.warning("the cached result %s is damaged (%s); it is made anew", folder, damage)
            return None
        with suppress(OSError):  # a cache on a read-only disk still answers
            os.utime(folder / MANIFEST)
        return str(_read_manifest(folder)["content_sha256"])

    def list_entries(self) -> tuple[CacheEntry, ...]:
        """All whole-looking entries (their files are not read), by stage and key."""
        return tuple(self._walk_entries())

    def _walk_entries(self) -> Iterator[CacheEntry]:
        for path in sorted(self.root.glob(f"*/*/{MANIFEST}")):
            folder = path.parent
            if folder.name.startswith("."):
                continue
            with suppress(OSError):  # removed meanwhile
                size = sum(found.stat().st_size for found in folder.rglob("*") if found.is_file())
                yield CacheEntry(
                    stage=folder.parent.name,
                    key=folder.name,
                    folder=folder,
                    size_bytes=size,
                    used_at_s=path.stat().st_mtime,
                )

    def leftovers(self) -> tuple[Path, ...]:
        """Folders that no entry is made of: of killed runs, and results without a manifest."""
        found = [path for path in self.root.glob("*/*") if path.is_dir() and not (path / MANIFEST).is_file()]
        return tuple(sorted({*found, *(path for path in self.root.glob("*/.*") if path.is_dir())}))

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
            needed: keys that stay whatever the limits say.
            older_than_s: seconds since the last use, from which an entry goes; None: no entry goes for its age.
            max_size_bytes: size that the cache may keep; None: no limit.
            dry_run: tell what would go and leave it.

        Entries that were used within the last day, or are locked by a run, stay. Folders of interrupted runs go with
        the same age, but an interrupted reconstruction that could go on only where ``older_than_s`` asks for it.
        """
        entries = sorted(self.list_entries(), key=lambda entry: entry.used_at_s)
        kept_bytes = sum(entry.size_bytes for entry in entries)
        removed, held, in_use = [], [], []
        for entry in entries:
            age_s = time.time() - entry.used_at_s
            too_old = older_than_s is not None and age_s > older_than_s
            too_much = max_size_bytes is not None and kept_bytes > max_size_bytes
            if not (too_old or too_much):
                continue
            if entry.key in needed:
                held.append(entry)
            elif age_s < IN_USE_S or not (dry_run or _remove_unlocked(entry.folder)):
                in_use.append(entry)
            else:
                removed.append(entry)
                kept_bytes -= entry.size_bytes
        leftovers = [path for path in self.leftovers() if self._is_abandoned(path, older_than_s)]
        if not dry_run:
            for path in leftovers:
                shutil.rmtree(path, ignore_errors=True)
        return PruneReport(removed=tuple(removed), needed=tuple(held), in_use=tuple(in_use), leftovers=tuple(leftovers))

    @staticmethod
    def _is_abandoned(path: Path, older_than_s: float | None) -> bool:
        age_s = time.time() - path.stat().st_mtime
        if path.name.startswith(".work-"):
            return older_than_s is not None and age_s > max(IN_USE_S, older_than_s)
        return age_s > IN_USE_S


def find_damage(folder: Path) -> str:
    """What is wrong with an entry by its manifest, '' where it is whole."""
    try:
        recorded = _read_manifest(folder)["files"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        return f"no readable {MANIFEST}: {error}"
    found = _list_files(folder)
    if found.keys() != recorded.keys():
        strange = sorted(found.keys() ^ recorded.keys())
        return f"{'added' if strange[0] in found else 'missing'}: {strange[0]}"
    for name, path in found.items():
        size, sha256 = recorded[name]
        if path.stat().st_size != size:
            return f"{name} has {path.stat().st_size} bytes, {size} were written"
        if hash_file(path) != sha256:
            return f"{name} was changed"
    return ""


def _read_manifest(folder: Path) -> dict[str, Any]:
    manifest: dict[str, Any] = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    return manifest


def _list_files(folder: Path) -> dict[str, Path]:
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file() and path != folder / MANIFEST]
    return {path.relative_to(folder).as_posix(): path for path in paths}


def _write_manifest(folder: Path, stage: str, key: str) -> str:
    files = {name: (path.stat().st_size, hash_file(path)) for name, path in _list_files(folder).items()}
    digest = hashlib.sha256()
    for name, (_, sha256) in files.items():
        if not name.startswith(f"{DIAGNOSTICS}/"):
            digest.update(f"{name}\0{sha256}\0".encode())
    manifest = {"stage": stage, "key": key, "content_sha256": digest.hexdigest(), "files": files}
    (folder / MANIFEST).write_text(json.dumps(manifest, indent=1), encoding="utf-8")
    return digest.hexdigest()


def _remove(folder: Path) -> None:
    """Under another name first, so that half of an entry never stands under its key."""
    if folder.is_dir():
        away = folder.with_name(f".{folder.name}.{uuid.uuid4().hex[:8]}.part")
        folder.rename(away)
        shutil.rmtree(away, ignore_errors=True)


def _remove_unlocked(folder: Path) -> bool:
    """Remove an entry unless a run holds its lock."""
    try:
        with FileLock(folder.parent / f".{folder.name}.lock", timeout=0):
            _remove(folder)
    except Timeout:
        return False
    return True
