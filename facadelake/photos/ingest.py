"""Ingest: every file of a campaign's folder as one row of table `photos`, accepted or refused with the reason."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from PIL import Image

from facadelake.core.arrays import Float64Array
from facadelake.core.errors import InputDataError
from facadelake.core.progress import track
from facadelake.core.tables import table_from_rows
from facadelake.photos.clock import is_clock_set
from facadelake.photos.exif import FULL_FRAME_DIAGONAL_MM
from facadelake.photos.files import find_photographs
from facadelake.photos.priors import PhotoMetadata, PhotoPriors, derive_priors
from facadelake.photos.read import Photo, read_photos
from schemas.vocabulary import HeightDatum, PhotoOutcome, PhotoRole, PositionSource


def _role_from_folder(photo_id: str) -> PhotoRole | None:
    for part in photo_id.split("/")[:-1]:
        word = part.lower().replace("-", "").replace("_", "").replace(" ", "")
        if word in ("multiview", "closerange"):
            return PhotoRole(word)
    return None


def _assign_roles(
    photo_ids: Sequence[str],
    statements: dict[str, PhotoPriors],
    distance_to_model_m: Callable[[Float64Array], Float64Array] | None,
    close_range_below_m: float,
) -> list[PhotoRole]:
    roles = [_role_from_folder(photo_id) for photo_id in photo_ids]
    open_ones = [
        i
        for i, (photo_id, role) in enumerate(zip(photo_ids, roles, strict=True))
        if role is None and photo_id in statements
        if statements[photo_id].position.source is not PositionSource.NONE
    ]
    if open_ones and distance_to_model_m is not None:
        priors = [statements[photo_ids[i]].position for i in open_ones]
        lon_lat_deg = np.array([[prior.lon_deg, prior.lat_deg] for prior in priors])
        for i, distance_m in zip(open_ones, distance_to_model_m(lon_lat_deg), strict=True):
            roles[i] = PhotoRole.CLOSERANGE if distance_m < close_range_below_m else PhotoRole.MULTIVIEW
    return [role or PhotoRole.MULTIVIEW for role in roles]


def _derive_priors(
    photos: dict[str, Photo], distance_to_model_m: Callable[[Float64Array], Float64Array] | None
) -> tuple[dict[str, PhotoPriors], dict[str, str]]:
    """What the readable photographs say; a file of the same bytes as another says the same, and no more."""
    first_of_hash: dict[str, str] = {}
    twin_of: dict[str, str] = {}
    readable: list[PhotoMetadata] = []
    for photo_id, photo in photos.items():
        if photo.exif is None:
            continue
        first = first_of_hash.setdefault(photo.sha256, photo_id)
        if first != photo_id:
            twin_of[photo_id] = first
            continue
        readable.append(
            PhotoMetadata(
                photo_id=photo_id,
                width_px=photo.width_px,
                height_px=photo.height_px,
                exif=photo.exif,
                drone=photo.drone,
            )
        )
    said = {one.photo_id: s for one, s in zip(readable, derive_priors(readable, distance_to_model_m), strict=True)}
    return said | {twin: said[first] for twin, first in twin_of.items()}, twin_of


def _none_unless_finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _build_row(photo_id: str, photo: Photo, role: PhotoRole, said: PhotoPriors | None) -> dict[str, Any]:
    row: dict[str, Any] = {
        "photo_id": photo_id,
        "sha256": photo.sha256,
        "bytes": photo.bytes,
        "photo_outcome": PhotoOutcome.ACCEPTED,
        "prior_source": PositionSource.NONE,
        "prior_height_datum": HeightDatum.UNKNOWN,
    }
    if photo.exif is None or said is None:
        return row | {"photo_outcome": PhotoOutcome.UNREADABLE, "reason": photo.problem}
    exif, drone = photo.exif, photo.drone
    position, attitude, focal = said.position, said.attitude, said.focal
    diagonal_px = math.hypot(photo.width_px, photo.height_px)
    located = position.source is not PositionSource.NONE
    return row | {
        "role": role,
        "reason": None if located else f"no position prior ({position.reason}); the photograph is used without one",
        "image_width_px": photo.width_px,
        "image_height_px": photo.height_px,
        "camera_make": exif.make or None,
        "camera_model": exif.model or None,
        "camera_serial": said.serial or None,
        "lens_model": exif.lens_model or None,
        "focal_length_mm": _none_unless_finite(exif.focal_length_mm),
        "focal_length_35mm_mm": _none_unless_finite(focal.px * FULL_FRAME_DIAGONAL_MM / diagonal_px),
        "taken_at": exif.taken_at if is_clock_set(exif.taken_at) else None,
        "prior_source": position.source,
        "prior_lon_deg": _none_unless_finite(position.lon_deg),
        "prior_lat_deg": _none_unless_finite(position.lat_deg),
        "prior_height_m": _none_unless_finite(position.height_m),
        "prior_height_datum": position.height_datum,
        "prior_height_relative_m": _none_unless_finite(drone.relative_altitude_m) if drone else None,
        "prior_sigma_horizontal_m": position.sigma.horizontal_m if located else None,
        "prior_sigma_vertical_m": position.sigma.vertical_m if located else None,
        "prior_yaw_deg": _none_unless_finite(attitude.yaw_deg),
        "prior_pitch_deg": _none_unless_finite(attitude.pitch_deg),
        "prior_roll_deg": _none_unless_finite(attitude.roll_deg),
        "prior_sigma_yaw_deg": _none_unless_finite(attitude.sigma_yaw_deg),
        "prior_sigma_tilt_deg": _none_unless_finite(attitude.sigma_tilt_deg),
        "prior_evidence": said.evidence or None,
        "prior_focal_px": _none_unless_finite(focal.px),
        "prior_sigma_focal_px": _none_unless_finite(focal.sigma_px),
        "prior_focal_evidence": focal.evidence or None,
        "prior_calibration": focal.calibration or None,
        "prior_warnings": "; ".join(said.warnings) or None,
        "flight": said.flight,
        "rtk_flag": drone.rtk_flag if drone else None,
    }


def ingest_photographs(
    root: Path, *, distance_to_model_m: Callable[[Float64Array], Float64Array] | None, close_range_below_m: float
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
        photos = {
            photo.path.relative_to(root).as_posix(): photo
            for photo in track(read_photos(paths), label="Reading photographs", total=len(paths))
        }
    said, twin_of = _derive_priors(photos, distance_to_model_m)
    roles = _assign_roles(list(photos), said, distance_to_model_m, close_range_below_m)
    rows = [
        _build_row(photo_id, photo, role, said.get(photo_id))
        for (photo_id, photo), role in zip(photos.items(), roles, strict=True)
    ]
    for row in rows:
        if row["photo_id"] in twin_of:
            first = twin_of[row["photo_id"]]
            row["photo_outcome"] = PhotoOutcome.DUPLICATE
            row["reason"] = f"the same bytes as {first}; one of the two is enough, remove the other"
    if not any(row["photo_outcome"] == PhotoOutcome.ACCEPTED for row in rows):
        raise InputDataError(
            f"none of the {len(rows)} photographs in {root} can be used; the first, {rows[0]['photo_id']}: "
            f"{rows[0]['reason']}"
        )
    return table_from_rows("photos", rows)
