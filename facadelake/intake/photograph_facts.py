"""What the checks of an upload need to know of its files: content, capture time and position."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from facadelake.core.errors import StoreError
from facadelake.core.hashing import hash_file
from facadelake.intake.listing import ListedFile
from facadelake.photos import Photo, find_masks, find_photographs, is_clock_set, read_photos


@dataclass(frozen=True, kw_only=True)
class FileFacts:
    """Facts of one file of an upload.

    ``problem``: why a photograph cannot be read; it is received, and a row of table ``photos`` then says so.
    ``taken_at`` is what the camera's clock showed; None where it is unknown, or the clock was not set. ``lon_deg`` and
    ``lat_deg`` (WGS 84) are NaN where the photograph states none.
    """

    file: ListedFile
    sha256: str
    is_photograph: bool
    problem: str = ""
    taken_at: datetime | None = None
    lon_deg: float = math.nan
    lat_deg: float = math.nan
    is_received: bool = False

    @property
    def has_position(self) -> bool:
        """Whether the photograph states a position."""
        return math.isfinite(self.lon_deg) and math.isfinite(self.lat_deg)


def collect_facts(folder: Path, files: Sequence[ListedFile], sha256_of: Mapping[str, str]) -> list[FileFacts]:
    """The facts of files that were copied.

    Args:
        folder: the folder that they were copied to.
        files: the files.
        sha256_of: hashes of what was read at the source, by the files' paths.

    Returns:
        facts in the order of ``files``.

    Raises:
        StoreError: a copy differs from what was read.
    """
    masks = set(find_masks(folder).values())
    pictures = [path for path in find_photographs(folder) if path not in masks]
    photos = {photo.path: photo for photo in read_photos(pictures)}
    facts = []
    for file in files:
        path = folder / file.path
        photo = photos.get(path)
        sha256 = photo.sha256 if photo is not None else hash_file(path)
        if sha256 != sha256_of[file.path]:
            raise StoreError(
                f"the copy of {file.path} in {folder} has SHA-256 {sha256[:12]}, and {sha256_of[file.path][:12]} was "
                "read from the source; check the disk: it is copied again"
            )
        facts.append(_describe_photo(file, photo, sha256))
    return facts


def _describe_photo(file: ListedFile, photo: Photo | None, sha256: str) -> FileFacts:
    if photo is None:
        return FileFacts(file=file, sha256=sha256, is_photograph=False)
    lon_deg, lat_deg = _choose_position(photo)
    return FileFacts(
        file=file,
        sha256=sha256,
        is_photograph=True,
        problem=photo.problem,
        taken_at=_find_local_time(photo),
        lon_deg=lon_deg,
        lat_deg=lat_deg,
    )


def _find_local_time(photo: Photo) -> datetime | None:
    if photo.exif is None or photo.exif.taken_at is None or not is_clock_set(photo.exif.taken_at):
        return None
    shown = photo.exif.taken_at + timedelta(seconds=photo.exif.utc_offset_s or 0.0)
    return shown.replace(tzinfo=None, microsecond=0)


def _choose_position(photo: Photo) -> tuple[float, float]:
    """Longitude and latitude by XMP, else by EXIF: to metres, which is enough to tell buildings apart."""
    stated = [(one.lon_deg, one.lat_deg) for one in (photo.drone, photo.exif) if one is not None]
    for lon_deg, lat_deg in stated:
        is_possible = abs(lon_deg) <= 180 and abs(lat_deg) <= 90
        if is_possible and (abs(lon_deg) > 1e-6 or abs(lat_deg) > 1e-6):  # (0, 0) is how some write no fix
            return lon_deg, lat_deg
    return math.nan, math.nan
