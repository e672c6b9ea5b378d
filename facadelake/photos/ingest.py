"""Ingest the photographs of a campaign: one row of table `photos` for each file, with its outcome."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64N, Float64Nx2
from facadelake.core.errors import InputDataError
from facadelake.core.progress import track
from facadelake.core.tables import Row, table_from_rows
from facadelake.photos.clock import is_clock_set
from facadelake.photos.exif import FULL_FRAME_DIAGONAL_MM
from facadelake.photos.files import explain_unused_masks, find_photographs
from facadelake.photos.picture_kinds import KeptOut, find_kept_out
from facadelake.photos.positions_file.matching import match_positions
from facadelake.photos.positions_file.table import PositionFile
from facadelake.photos.priors import PhotoMetadata, PhotoPriors, assign_to_flights, derive_priors
from facadelake.photos.read import Photo, read_photos
from facadelake.photos.utc_offset import resolve_utc_offsets
from schemas.vocabulary import HeightDatum, PhotoOutcome, PhotoRole, PositionSource


def _role_from_folder(photo_id: str) -> PhotoRole | None:
    for part in photo_id.split("/")[:-1]:
        name = part.lower().replace("-", "").replace("_", "").replace(" ", "")
        if name in ("multiview", "closerange"):
            return PhotoRole(name)
    return None


def _assign_roles(
    photo_ids: Sequence[str],
    priors: Mapping[str, PhotoPriors],
    distance_to_model_m: Callable[[Float64Nx2], Float64N] | None,
    close_range_below_m: float,
) -> list[PhotoRole]:
    roles = [_role_from_folder(photo_id) for photo_id in photo_ids]
    undecided = [
        i
        for i, (photo_id, role) in enumerate(zip(photo_ids, roles, strict=True))
        if role is None and photo_id in priors
        if priors[photo_id].position.source is not PositionSource.NONE
    ]
    if undecided and distance_to_model_m is not None:
        positions = [priors[photo_ids[i]].position for i in undecided]
        lon_lat_deg = np.array([[position.lon_deg, position.lat_deg] for position in positions])
        for i, distance_m in zip(undecided, distance_to_model_m(lon_lat_deg), strict=True):
            roles[i] = PhotoRole.CLOSERANGE if distance_m < close_range_below_m else PhotoRole.MULTIVIEW
    return [role or PhotoRole.MULTIVIEW for role in roles]


@dataclass(frozen=True, kw_only=True)
class _Campaign:
    """Priors by photo_id of the readable photographs, originals of duplicates, photographs kept out of the block."""

    priors: Mapping[str, PhotoPriors]
    original_of: Mapping[str, str]
    kept_out: Mapping[str, KeptOut]


def _derive_priors(
    photos: dict[str, Photo],
    distance_to_model_m: Callable[[Float64Nx2], Float64N] | None,
    positions: PositionSource | PositionFile | None,
    used_kinds: Collection[PhotoOutcome],
) -> _Campaign:
    """The priors of the readable photographs.

    A duplicate has the priors of its original. Duplicates and photographs kept out of the block take no part in the
    checks between photographs, nor in where flights begin and end.
    """
    first_of_hash: dict[str, str] = {}
    original_of: dict[str, str] = {}
    readable: list[PhotoMetadata] = []
    for photo_id, photo in photos.items():
        if photo.exif is None:
            continue
        first = first_of_hash.setdefault(photo.sha256, photo_id)
        if first != photo_id:
            original_of[photo_id] = first
            continue
        readable.append(
            PhotoMetadata(
                photo_id=photo_id,
                width_px=photo.width_px,
                height_px=photo.height_px,
                exif=photo.exif,
                drone=photo.drone,
                warnings=photo.metadata_warnings,
                lens=photo.lens,
            )
        )
    kept_out = find_kept_out(readable, used_kinds)
    used = [photo for photo in readable if photo.photo_id not in kept_out]
    others = [photo for photo in readable if photo.photo_id in kept_out]
    from_file = None
    if isinstance(positions, PositionFile):
        from_file = match_positions(positions, [photo_id for photo_id, photo in photos.items() if photo.exif]).by_photo
    counts = None if isinstance(positions, PositionFile) else positions
    derived = derive_priors(used, distance_to_model_m, counts=counts, from_file=from_file)
    flights = assign_to_flights(others, used, [prior.flight or 0 for prior in derived])
    priors = {photo.photo_id: prior for photo, prior in zip(used, derived, strict=True)}
    priors |= {
        photo.photo_id: replace(prior, flight=flight)
        for photo, prior, flight in zip(
            others, derive_priors(others, counts=counts, from_file=from_file), flights, strict=True
        )
    }
    return _Campaign(
        priors=priors | {duplicate: priors[first] for duplicate, first in original_of.items()},
        original_of=original_of,
        kept_out=kept_out,
    )


def _finite_or_none(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _build_row(photo_id: str, photo: Photo, role: PhotoRole, priors: PhotoPriors | None) -> Row:
    row: Row = {
        "photo_id": photo_id,
        "sha256": photo.sha256,
        "bytes": photo.bytes,
        "photo_outcome": PhotoOutcome.ACCEPTED,
        "prior_source": PositionSource.NONE,
        "prior_height_datum": HeightDatum.UNKNOWN,
    }
    if photo.exif is None or priors is None:
        return row | {"photo_outcome": PhotoOutcome.UNREADABLE, "reason": photo.problem}
    exif, drone = photo.exif, photo.drone
    position, attitude, focal = priors.position, priors.attitude, priors.focal
    diagonal_px = math.hypot(photo.width_px, photo.height_px)
    located = position.source is not PositionSource.NONE
    return row | {
        "role": role,
        "reason": None if located else f"no position prior ({position.reason}); the photograph is used without one",
        "image_width_px": photo.width_px,
        "image_height_px": photo.height_px,
        "exif_orientation": exif.orientation,
        "camera_make": exif.make or None,
        "camera_model": exif.model or None,
        "camera_serial": priors.serial or None,
        "lens_model": exif.lens_model or None,
        "image_source": photo.lens.image_source or None,
        "digital_zoom": photo.lens.digital_zoom,
        "exif_focal_length_35mm_mm": _finite_or_none(exif.focal_length_35mm_mm),
        "focal_length_mm": _finite_or_none(exif.focal_length_mm),
        "focal_length_35mm_mm": _finite_or_none(focal.px * FULL_FRAME_DIAGONAL_MM / diagonal_px),
        "taken_at": exif.taken_at if is_clock_set(exif.taken_at) else None,
        "utc_offset": exif.utc_offset,
        "prior_source": position.source,
        "prior_lon_deg": _finite_or_none(position.lon_deg),
        "prior_lat_deg": _finite_or_none(position.lat_deg),
        "prior_height_m": _finite_or_none(position.height_m),
        "prior_height_datum": position.height_datum,
        "prior_height_relative_m": _finite_or_none(drone.relative_altitude_m) if drone else None,
        "prior_sigma_horizontal_m": position.sigma.horizontal_m if located else None,
        "prior_sigma_vertical_m": position.sigma.vertical_m if located else None,
        "prior_yaw_deg": _finite_or_none(attitude.yaw_deg),
        "prior_pitch_deg": _finite_or_none(attitude.pitch_deg),
        "prior_roll_deg": _finite_or_none(attitude.roll_deg),
        "prior_sigma_yaw_deg": _finite_or_none(attitude.sigma_yaw_deg),
        "prior_sigma_tilt_deg": _finite_or_none(attitude.sigma_tilt_deg),
        "prior_evidence": priors.evidence or None,
        "prior_focal_px": _finite_or_none(focal.px),
        "prior_sigma_focal_px": _finite_or_none(focal.sigma_px),
        "prior_focal_evidence": focal.evidence or None,
        "prior_calibration": focal.calibration or None,
        "prior_warnings": "; ".join(priors.warnings) or None,
        "flight": priors.flight,
        "rtk_flag": drone.rtk_flag if drone else None,
    }


def _drop_map_datum(photo: Photo) -> Photo:
    return replace(photo, exif=replace(photo.exif, map_datum="")) if photo.exif else photo


def ingest_photographs(
    root: Path,
    *,
    distance_to_model_m: Callable[[Float64Nx2], Float64N] | None,
    close_range_below_m: float,
    positions: PositionSource | PositionFile | None = None,
    used_kinds: Collection[PhotoOutcome] = (),
    gnss_crs: str | None = None,
) -> pa.Table:
    """Table `photos` of all files below ``root``.

    The photo_id is the path below ``root`` with forward slashes. The role is given by a folder ``multiview`` or
    ``closerange`` of that path, else by the distance to the building; without a distance it is multi-view.

    Args:
        root: folder of the photographs.
        distance_to_model_m: horizontal distance (n,) in metres of positions (n, 2: lon_deg, lat_deg) to the building;
            None where it is unknown.
        close_range_below_m: photographs nearer than this are close-range, metres.
        positions: which positions count: those of XMP, of EXIF or of a file; None: XMP, else EXIF.
        used_kinds: kinds of photographs to use that are kept out of the block by default.
        gnss_crs: CRS of the positions by the portfolio, which counts before EXIF GPSMapDatum; None: not named.

    Returns:
        One row for each file, also for those that cannot be read, are kept out of the block, and for duplicates.

    Raises:
        InputDataError: there is no photograph, or none can be used.
    """
    paths = find_photographs(root)
    if not paths:
        raise InputDataError(
            f"no photograph in {root} or its sub-folders; photographs are jpg, jpeg, png, tif and tiff files"
        )
    photos = {
        photo.path.relative_to(root).as_posix(): photo
        for photo in track(read_photos(paths), label="Reading photographs", total=len(paths))
    }
    for path, reason in explain_unused_masks(root).items():
        photo = photos[path.relative_to(root).as_posix()]
        photos[path.relative_to(root).as_posix()] = replace(photo, metadata_warnings=(*photo.metadata_warnings, reason))
    photos = resolve_utc_offsets(photos)
    if gnss_crs is not None:
        photos = {photo_id: _drop_map_datum(photo) for photo_id, photo in photos.items()}
    campaign = _derive_priors(photos, distance_to_model_m, positions, used_kinds)
    roles = _assign_roles(list(photos), campaign.priors, distance_to_model_m, close_range_below_m)
    rows = [
        _build_row(photo_id, photo, role, campaign.priors.get(photo_id))
        for (photo_id, photo), role in zip(photos.items(), roles, strict=True)
    ]
    for row in rows:
        if row["photo_id"] in campaign.kept_out:
            kept_out = campaign.kept_out[row["photo_id"]]
            row["photo_outcome"], row["reason"] = kept_out.outcome, kept_out.reason
        if row["photo_id"] in campaign.original_of:
            first = campaign.original_of[row["photo_id"]]
            row["photo_outcome"] = PhotoOutcome.DUPLICATE
            row["reason"] = f"same content as {first}; remove one of the two"
    if not any(row["photo_outcome"] == PhotoOutcome.ACCEPTED for row in rows):
        raise InputDataError(
            f"none of the {len(rows)} photographs in {root} can be used; the first, {rows[0]['photo_id']}: "
            f"{rows[0]['reason']}"
        )
    return table_from_rows("photos", rows)
