"""Read photographs: hash, decode completely, and parse the metadata; several files in parallel."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from facadelake.core.errors import InputDataError
from facadelake.core.hashing import hash_file
from facadelake.photos.drone_xmp import DroneMetadata, parse_drone_metadata
from facadelake.photos.exif import ExifMetadata, read_exif
from facadelake.photos.files import FORMATS_BY_SUFFIX, RAW_SUFFIXES

# Each thread decodes one photograph at a time, so that memory is limited to WORKERS decoded photographs.
WORKERS = max(2, min(8, os.cpu_count() or 2))


@dataclass(frozen=True, kw_only=True)
class DecodedImage:
    """Stored size and metadata blocks of a photograph that was decoded completely."""

    width_px: int
    height_px: int
    exif: Image.Exif
    xmp: bytes


@dataclass(frozen=True, kw_only=True)
class Photo:
    """One file with its hash and metadata; ``problem`` states why it cannot be read, else it is empty."""

    path: Path
    sha256: str
    bytes: int
    problem: str = ""
    width_px: int = 0
    height_px: int = 0
    exif: ExifMetadata | None = None
    drone: DroneMetadata | None = None


def decode_photograph(path: Path) -> DecodedImage:
    """Decode the photograph completely (a truncated file opens without an error) and return size and metadata blocks.

    Width and height are those of the stored pixels. The EXIF orientation is *not* applied, neither here nor by COLMAP:
    all pixel coordinates (tie points, boxes, control points) refer to the file as stored.
    Raises InputDataError where the file cannot be decoded.
    """
    if path.suffix.lower() in RAW_SUFFIXES:
        raise InputDataError("raw photographs are not supported; export this one as JPEG or TIFF")
    if path.stat().st_size == 0:
        raise InputDataError("the file is empty (0 bytes); copy it again from the camera's card")
    allowed = FORMATS_BY_SUFFIX[path.suffix.lower()]
    try:
        with Image.open(path) as image:
            found = image.format or "unknown"
            if found not in allowed:
                raise InputDataError(
                    f"the name ends in {path.suffix} but the content is {found}; such files come from a conversion "
                    "that often loses metadata: export the original again, or correct the suffix"
                )
            image.load()
            width_px, height_px = image.size
            xmp = image.info.get("xmp", b"")
            exif = image.getexif()
    except UnidentifiedImageError as error:
        raise InputDataError("the file has no known image format; copy it again from the card") from error
    except Image.DecompressionBombError as error:
        raise InputDataError(f"the photograph is too large to be decoded safely: {error}") from error
    except (OSError, SyntaxError, ValueError) as error:
        raise InputDataError(
            f"the photograph cannot be decoded completely ({error}); copy it again from the card"
        ) from error
    return DecodedImage(
        width_px=width_px, height_px=height_px, exif=exif, xmp=xmp.encode() if isinstance(xmp, str) else bytes(xmp)
    )


def read_photo(path: Path) -> Photo:
    """Hash, decode and parse one file; a file that cannot be decoded is returned with its ``problem``."""
    try:
        sha256, size = hash_file(path), path.stat().st_size
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
    """Read photographs in parallel; they are returned in the order of ``paths``, a bounded number read ahead."""
    with ThreadPoolExecutor(WORKERS) as pool:
        remaining = iter(paths)
        submitted = [pool.submit(read_photo, path) for path in islice(remaining, 2 * WORKERS)]
        while submitted:
            yield submitted.pop(0).result()
            submitted.extend(pool.submit(read_photo, path) for path in islice(remaining, 1))
