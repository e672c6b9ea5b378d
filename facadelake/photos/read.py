"""One file: hashed, decoded to its end, and its metadata blocks read; many of them, a bounded number in flight."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from facadelake.core.errors import InputDataError
from facadelake.photos.drone_xmp import DroneMetadata, parse_drone_metadata
from facadelake.photos.exif import ExifMetadata, read_exif
from facadelake.photos.files import decode_photograph, hash_and_size

# One photograph is decoded at a time in each thread, so memory stays below WORKERS decoded photographs.
WORKERS = max(2, min(8, os.cpu_count() or 2))


@dataclass(frozen=True, kw_only=True)
class Photo:
    """One file: what it is, what it says of itself, and why it was refused (``problem``, else empty)."""

    path: Path
    sha256: str
    bytes: int
    problem: str = ""
    width_px: int = 0
    height_px: int = 0
    exif: ExifMetadata | None = None
    drone: DroneMetadata | None = None


def read_photo(path: Path) -> Photo:
    """Hash, decode and read one file; a file that does not decode comes back with its ``problem``."""
    try:
        sha256, size = hash_and_size(path)
    except OSError as error:
        return Photo(path=path, sha256="", bytes=0, problem=f"the file cannot be read ({error.strerror})")
    try:
        decoded = decode_photograph(path)
    except InputDataError as error:
        return Photo(path=path, sha256=sha256, bytes=size, problem=str(error))
    return Photo(
        path=path,
        sha256=sha256,
        bytes=size,
        width_px=decoded.width_px,
        height_px=decoded.height_px,
        exif=read_exif(decoded.exif, width_px=decoded.width_px),
        drone=parse_drone_metadata(decoded.xmp),
    )


def read_photos(paths: list[Path]) -> Iterator[Photo]:
    """Photographs in the order of ``paths``, a bounded number in flight."""
    with ThreadPoolExecutor(WORKERS) as pool:
        queue = iter(paths)
        waiting = [pool.submit(read_photo, path) for path in islice(queue, 2 * WORKERS)]
        while waiting:
            yield waiting.pop(0).result()
            waiting.extend(pool.submit(read_photo, path) for path in islice(queue, 1))
