"""SHA-256 hashes of files and of settings."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any


def hash_file(path: Path) -> str:
    """SHA-256 of the content of a file, as hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def hash_files(paths: Sequence[Path]) -> str:
    """One SHA-256 over the contents of several files, in the given order."""
    return hashlib.sha256("".join(hash_file(path) for path in paths).encode()).hexdigest()


def compute_key(parts: Mapping[str, Any]) -> str:
    """A key of 24 hexadecimal digits of values that JSON can represent (hashes, settings), whatever their order."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:24]
