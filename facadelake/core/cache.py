"""Expensive, deterministic stages are kept by the hash of their inputs plus the version of the code that made them."""

from __future__ import annotations

import hashlib
import json
import shutil
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from filelock import FileLock

PACKAGE = Path(__file__).resolve().parents[1]


def file_hash(path: Path) -> str:
    """SHA-256 of a file's bytes, in hex."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@cache
def code_hash(*rooms: str) -> str:
    """Hash of the source of the named modules or folders of the domain (``"pose"``, ``"camera.py"``).

    It is part of every stage's key, so that changed code is never answered from the cache.
    """
    digest = hashlib.sha256()
    for room in sorted(rooms):
        top = PACKAGE / room
        files = sorted(top.rglob("*.py")) if top.is_dir() else [top]
        for path in files:
            digest.update(str(path.relative_to(PACKAGE)).encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def key_of(parts: Mapping[str, Any]) -> str:
    """A stable key of JSON-able values (hashes, settings), whatever their order."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:24]


@dataclass(frozen=True, kw_only=True)
class Cached:
    """A stage's result folder and whether it was there before."""

    folder: Path
    hit: bool


@dataclass(frozen=True, kw_only=True)
class StageCache:
    """Result folders ``root/<stage>/<key>``; a folder exists only whole (it is made beside and renamed)."""

    root: Path

    def entry(self, stage: str, key: str, make: Callable[[Path], None]) -> Cached:
        """The folder of ``key``, made by ``make(folder)`` if it is not there; two processes do not make it twice."""
        folder = self.root / stage / key
        if folder.is_dir():
            return Cached(folder=folder, hit=True)
        folder.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(folder.parent / f".{key}.lock"):
            if folder.is_dir():
                return Cached(folder=folder, hit=True)
            for left in folder.parent.glob(f".{key}.*.part"):  # of a killed run: we hold the lock, nobody writes it
                shutil.rmtree(left, ignore_errors=True)
            part = folder.parent / f".{key}.{uuid.uuid4().hex[:8]}.part"
            part.mkdir()
            try:
                make(part)
                part.rename(folder)
            finally:
                shutil.rmtree(part, ignore_errors=True)
        return Cached(folder=folder, hit=False)


def hash_of_files(paths: Sequence[Path]) -> str:
    """One hash of several files' bytes, in the order given."""
    return hashlib.sha256("".join(file_hash(path) for path in paths).encode()).hexdigest()
