"""Ingest: every file of a campaign's folder as one row of table `photos`, accepted or refused with the reason."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from PIL import Image

from facadelake.errors import InputDataError
from facadelake.frames import Array
from facadelake.photo.exif import FULL_FRAME_DIAGONAL_MM, ExifMetadata, read_exif
from facadelake.photo.files import decode, find_photographs, hash_and_size
from facadelake.photo.prior import PositionPrior, position_prior
from facadelake.photo.xmp import DroneMetadata, parse_drone_metadata
from facadelake.progress import track
from facadelake.tables import table_of_rows
from schemas.vocabulary import HeightDatum, PhotoOutcome, PhotoRole, PositionSource

NOT_READ = PositionPrior(source=PositionSource.NONE, reason="the photograph was not read")
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
    prior: PositionPrior = NOT_READ

    @property
    def focal_length_35mm_mm(self) -> float:
        """35 mm equivalent by the diagonal: DJI's factory calibration before EXIF's figure; NaN if none."""
        calibrated_px = self.drone.calibrated_focal_px if self.drone else math.nan
        if calibrated_px > 0:
            return calibrated_px * FULL_FRAME_DIAGONAL_MM / math.hypot(self.width_px, self.height_px)
        return self.exif.focal_length_35mm_mm if self.exif else math.nan


def read_photo(path: Path) -> Photo:
    """Hash, decode and read one file; a file that does not decode comes back with its ``problem``."""
    try:
        sha256, size = hash_and_size(path)
    except OSError as error:
        return Photo(path=path, sha256="", bytes=0, problem=f"the file cannot be read ({error.strerror})")
    try:
        decoded = decode(path)
    except InputDataError as error:
        return Photo(path=path, sha256=sha256, bytes=size, problem=str(error))
    exif = read_exif(decoded.exif, width_px=decoded.width_px, height_px=decoded.height_px)
    drone = parse_drone_metadata(decoded.xmp)
    return Photo(
        path=path,
        sha256=sha256,
        bytes=size,
        width_px=decoded.width_px,
        height_px=decoded.height_px,
        exif=exif,
        drone=drone,
        prior=position_prior(drone, exif),
    )


def _read_all(paths: list[Path]) -> Iterator[Photo]:
    """Photographs in the order of ``paths``, a bounded number in flight."""
    with ThreadPoolExecutor(WORKERS) as pool:
        queue = iter(paths)
        waiting = [pool.submit(read_photo, path) for path in islice(queue, 2 * WORKERS)]
        while waiting:
            yield waiting.pop(0).result()
            waiting.extend(pool.submit(read_photo, path) for path in islice(queue, 1))


def _folder_role(path: Path, root: Path) -> PhotoRole | None:
    for part in path.relative_to(root).parts[:-1]:
        word = part.lower().replace("-", "").replace("_", "").replace(" ", "")
        if word in ("multiview", "closerange"):
            return PhotoRole(word)
    return None


def _roles(
    photos: list[Photo], root: Path, distance_to_model_m: Callable[[Array], Array] | None, close_range_below_m: float
) -> list[PhotoRole]:
    roles = [_folder_role(photo.path, root) for photo in photos]
    open_ones = [
        i
        for i, (photo, role) in enumerate(zip(photos, roles, strict=True))
        if role is None and photo.prior.source is not PositionSource.NONE
    ]
    if open_ones and distance_to_model_m is not None:
        lon_lat_deg = np.array([[photos[i].prior.lon_deg, photos[i].prior.lat_deg] for i in open_ones])
        for i, distance_m in zip(open_ones, distance_to_model_m(lon_lat_deg), strict=True):
            roles[i] = PhotoRole.CLOSERANGE if distance_m < close_range_below_m else PhotoRole.MULTIVIEW
    return [role or PhotoRole.MULTIVIEW for role in roles]


def _or_none(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _row(photo: Photo, root: Path, role: PhotoRole, first_of_hash: dict[str, str]) -> dict[str, Any]:
    row: dict[str, Any] = {
        "photo_id": photo.path.relative_to(root).as_posix(),
        "sha256": photo.sha256,
        "bytes": photo.bytes,
        "photo_outcome": PhotoOutcome.ACCEPTED,
        "prior_source": photo.prior.source,
        "prior_height_datum": HeightDatum.UNKNOWN,
    }
    if photo.exif is None:
        return row | {"photo_outcome": PhotoOutcome.UNREADABLE, "reason": photo.problem}
    prior, exif, drone = photo.prior, photo.exif, photo.drone
    row |= {
        "role": role,
        "image_width_px": photo.width_px,
        "image_height_px": photo.height_px,
        "camera_make": exif.make or None,
        "camera_model": exif.model or None,
        "focal_length_mm": _or_none(exif.focal_length_mm),
        "focal_length_35mm_mm": _or_none(photo.focal_length_35mm_mm),
        "taken_at": exif.taken_at,
        "prior_lon_deg": _or_none(prior.lon_deg),
        "prior_lat_deg": _or_none(prior.lat_deg),
        "prior_height_m": _or_none(prior.height_m),
        "prior_height_datum": prior.height_datum,
        "prior_yaw_deg": _or_none(drone.gimbal_yaw_deg) if drone else None,
        "prior_pitch_deg": _or_none(drone.gimbal_pitch_deg) if drone else None,
        "prior_roll_deg": _or_none(drone.gimbal_roll_deg) if drone else None,
        "rtk_flag": drone.rtk_flag if drone else None,
    }
    if prior.source is PositionSource.NONE:
        row["reason"] = f"no position prior ({prior.reason}); the photograph is used without one"
    else:
        row["prior_sigma_horizontal_m"] = prior.sigma.horizontal_m
        row["prior_sigma_vertical_m"] = prior.sigma.vertical_m
    first = first_of_hash.setdefault(photo.sha256, row["photo_id"])
    if first != row["photo_id"]:
        row |= {
            "photo_outcome": PhotoOutcome.DUPLICATE,
            "reason": f"the same bytes as {first}; one of the two is enough, remove the other",
        }
    return row


def ingest_photographs(
    root: Path, *, distance_to_model_m: Callable[[Array], Array] | None, close_range_below_m: float
) -> pa.Table:
    """Table `photos` of all files below ``root``; photo_id is the path below ``root`` with forward slashes.

    The role is that of a folder ``multiview`` or ``closerange`` on the way; else ``distance_to_model_m``, given
    lon_deg, lat_deg (n, 2), says how far (m, horizontally) each photograph stood, and nearer than
    ``close_range_below_m`` is close-range; where that is unknown too, multi-view.
    Raises InputDataError where there is no photograph or none can be used.
    """
    paths = find_photographs(root)
    if not paths:
        raise InputDataError(
            f"no photograph in {root}: jpg, jpeg, png, tif and tiff were looked for, in all sub-folders"
        )
    with warnings.catch_warnings():
        # Above 89 Mpx Pillow warns; such photographs are meant. Twice that it refuses, and so do we.
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        photos = list(track(_read_all(paths), label="Reading photographs", total=len(paths)))
    roles = _roles(photos, root, distance_to_model_m, close_range_below_m)
    first_of_hash: dict[str, str] = {}
    rows = [_row(photo, root, role, first_of_hash) for photo, role in zip(photos, roles, strict=True)]
    if not any(row["photo_outcome"] == PhotoOutcome.ACCEPTED for row in rows):
        raise InputDataError(
            f"none of the {len(rows)} photographs in {root} can be used; the first, {rows[0]['photo_id']}: "
            f"{rows[0]['reason']}"
        )
    return table_of_rows("photos", rows)
