"""Read photographs: hash, decode completely, and parse the metadata; several files in parallel."""

from __future__ import annotations

import os
import threading
import warnings
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import TextIO

from PIL import Image, UnidentifiedImageError

from facadelake.core.errors import InputDataError
from facadelake.core.hashing import hash_file
from facadelake.photos.clock import is_clock_set
from facadelake.photos.drone_xmp import DroneMetadata, parse_drone_metadata
from facadelake.photos.exif import ExifMetadata, read_exif
from facadelake.photos.files import FORMATS_BY_SUFFIX, explain_unsupported, find_photographs
from facadelake.photos.lenses.lens import NOTHING_SAID, LensMetadata, read_lens
from facadelake.photos.xmp import parse_packet

# Each thread decodes one photograph at a time, so that memory is limited to WORKERS decoded photographs.
WORKERS = max(2, min(8, os.cpu_count() or 2))


@dataclass(frozen=True, kw_only=True)
class DecodedImage:
    """Stored size and metadata blocks of a photograph that was decoded completely."""

    width_px: int
    height_px: int
    exif: Image.Exif
    xmp: bytes
    exif_damage: str = ""


@dataclass(frozen=True, kw_only=True)
class Photo:
    """One file with its hash and metadata; ``problem`` states why it cannot be read, else it is empty.

    ``metadata_warnings`` states what of its metadata is damaged or ambiguous.
    """

    path: Path
    sha256: str
    bytes: int
    problem: str = ""
    width_px: int = 0
    height_px: int = 0
    exif: ExifMetadata | None = None
    drone: DroneMetadata | None = None
    metadata_warnings: tuple[str, ...] = ()
    lens: LensMetadata = NOTHING_SAID


def decode_photograph(path: Path) -> DecodedImage:
    """Decode the photograph completely (a truncated file opens without an error) and return size and metadata blocks.

    Width and height are those of the stored pixels. The EXIF orientation is *not* applied, neither here nor by COLMAP:
    all pixel coordinates (tie points, boxes, control points) refer to the file as stored.
    Raises InputDataError where the file cannot be decoded.
    """
    unsupported = explain_unsupported(path)
    if unsupported:
        raise InputDataError(unsupported)
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
            exif, exif_damage = _get_exif(image)
    except UnidentifiedImageError as error:
        raise InputDataError("the file has no known image format; copy it again from the card") from error
    except Image.DecompressionBombError as error:
        raise InputDataError(f"the photograph is too large to be decoded safely: {error}") from error
    except (OSError, SyntaxError, ValueError) as error:
        raise InputDataError(
            f"the photograph cannot be decoded completely ({error}); copy it again from the card"
        ) from error
    return DecodedImage(
        width_px=width_px,
        height_px=height_px,
        exif=exif,
        xmp=xmp.encode("utf-8", "replace") if isinstance(xmp, str) else bytes(xmp),
        exif_damage=exif_damage,
    )


def _get_exif(image: Image.Image) -> tuple[Image.Exif, str]:
    """EXIF and, where it is so damaged that Pillow refuses it, what is wrong with it: the pixels are good."""
    try:
        return image.getexif(), ""
    except Exception as error:  # Pillow's parser of TIFF directories raises whatever damaged bytes lead to
        return Image.Exif(), f"EXIF is damaged ({error or type(error).__name__}): nothing of it is used"


class _PillowWarnings(threading.local):
    """What Pillow warns about in this thread: it skips damaged tags of EXIF with a warning."""

    messages: tuple[str, ...] = ()

    def clear(self) -> None:
        self.messages = ()

    def record(
        self,
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        """Takes the place of ``warnings.showwarning``."""
        text = str(message)
        # "had too many entries" is harmless: the first one is read.
        if Path(filename).name == "TiffImagePlugin.py" and text not in self.messages and "too many" not in text:
            self.messages = (*self.messages, text)


_PILLOW = _PillowWarnings()


def read_photo(path: Path) -> Photo:
    """Hash, decode and parse one file; a file that cannot be decoded is returned with its ``problem``."""
    try:
        sha256, size = hash_file(path), path.stat().st_size
    except OSError as error:
        return Photo(path=path, sha256="", bytes=0, problem=f"the file cannot be read ({error.strerror})")
    _PILLOW.clear()
    try:
        decoded = decode_photograph(path)
    except InputDataError as error:
        return Photo(path=path, sha256=sha256, bytes=size, problem=str(error))
    exif = read_exif(decoded.exif, width_px=decoded.width_px)
    skipped = [f"EXIF is damaged ({message}): what is damaged of it is not used" for message in _PILLOW.messages]
    xmp = parse_packet(decoded.xmp)
    drone = parse_drone_metadata(xmp)
    lens = read_lens(decoded.exif, xmp, decoded.xmp, path.name)
    return Photo(
        path=path,
        sha256=sha256,
        bytes=size,
        width_px=decoded.width_px,
        height_px=decoded.height_px,
        exif=exif,
        drone=drone,
        # What could not be read is known only after the drone's properties were asked for.
        metadata_warnings=tuple(
            filter(None, (decoded.exif_damage, *skipped, *exif.warnings, *(xmp.warnings if xmp else ())))
        ),
        lens=lens,
    )


def read_photos(paths: list[Path]) -> Iterator[Photo]:
    """Read photographs in parallel; they are returned in the order of ``paths``, a bounded number read ahead."""
    with warnings.catch_warnings(), ThreadPoolExecutor(WORKERS) as pool:
        warnings.simplefilter("always", UserWarning)
        # Pillow warns above 89 Mpx, which is a valid size here, and raises above twice that.
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        warnings.showwarning = _PILLOW.record
        remaining = iter(paths)
        submitted = [pool.submit(read_photo, path) for path in islice(remaining, 2 * WORKERS)]
        while submitted:
            yield submitted.pop(0).result()
            submitted.extend(pool.submit(read_photo, path) for path in islice(remaining, 1))


@dataclass(frozen=True, kw_only=True)
class PhotographSummary:
    """First and last capture time (None: no photograph tells one), and the pixels of the largest photograph."""

    captured_from: datetime | None
    captured_to: datetime | None
    largest_px: int


def summarise_photographs(paths: Iterable[Path]) -> PhotographSummary:
    """Summarise the headers of photographs, in milliseconds each, for planning; pixels are not decoded.

    A file that cannot be opened is left out.
    """
    times: list[datetime] = []
    largest = 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the inspection tells what is wrong with a file
        for path in paths:
            try:
                with Image.open(path) as image:
                    width, height = image.size
                    taken_at = read_exif(_get_exif(image)[0], width_px=width).taken_at
            except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):
                continue
            largest = max(largest, width * height)
            if taken_at is not None and is_clock_set(taken_at):
                times.append(taken_at)
    return PhotographSummary(
        captured_from=min(times, default=None), captured_to=max(times, default=None), largest_px=largest
    )


def find_first_capture_time(root: Path) -> datetime | None:
    """The earliest time that EXIF of the photographs below ``root`` states; None where it states none, or no clock was
    set. No pixels are decoded, so that a file that is cut off counts, too."""
    return summarise_photographs(find_photographs(root)).captured_from
