"""Priors of the photographs of a campaign, derived from their metadata and checked against one another."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

from facadelake.core.arrays import Float64N, Float64Nx2
from facadelake.photos.attitude_prior import AttitudePrior, apply_dji_pitch, derive_attitude_prior, is_dji_pitch
from facadelake.photos.clock import ClockReading, check_clocks, is_clock_set, seconds_from_time
from facadelake.photos.contradictions import resolve_contradictions
from facadelake.photos.drone_xmp import DroneMetadata
from facadelake.photos.exif import ExifMetadata
from facadelake.photos.flights import LONGEST_GAP_S, Exposure, assign_flights
from facadelake.photos.hemispheres import resolve_hemispheres
from facadelake.photos.lenses.focal_prior import FocalPrior, derive_calibrated_focal, derive_focal_prior
from facadelake.photos.lenses.lens import NOTHING_SAID, LensMetadata
from facadelake.photos.lenses.zoom import ZoomReading, apply_zooms
from facadelake.photos.plausibility import TimedPrior, check_priors
from facadelake.photos.position_prior import PositionPrior, derive_position_prior
from facadelake.photos.positions_file.matching import compare_with_metadata
from schemas.vocabulary import PositionSource


@dataclass(frozen=True, kw_only=True)
class PhotoMetadata:
    """The metadata of one readable photograph; ``warnings`` states what of them is damaged or ambiguous."""

    photo_id: str
    width_px: int
    height_px: int
    exif: ExifMetadata
    drone: DroneMetadata | None
    warnings: tuple[str, ...] = ()
    lens: LensMetadata = NOTHING_SAID

    @property
    def camera(self) -> str:
        """Maker and model."""
        return f"{self.exif.make} {self.exif.model}"

    @property
    def serial(self) -> str:
        """Serial number of the drone, else of the camera; empty where neither is known."""
        return (self.drone.body if self.drone else "") or self.exif.body_serial

    @property
    def body(self) -> str:
        """The device with the GNSS receiver: drone or camera by serial number, else by maker and model."""
        return self.serial or self.camera


@dataclass(frozen=True, kw_only=True)
class PhotoPriors:
    """Priors of one photograph, serial number of its body, number of its flight (from 1) and all warnings.

    ``flight`` is None for a photograph kept out of the block that belongs to no flight of the others.
    """

    position: PositionPrior
    attitude: AttitudePrior
    focal: FocalPrior
    serial: str
    flight: int | None
    warnings: tuple[str, ...]

    @property
    def evidence(self) -> str:
        """The tags that position, height and attitude are taken from."""
        return "; ".join(part for part in (self.position.evidence, self.attitude.evidence) if part)


def derive_priors(
    photos: Sequence[PhotoMetadata],
    distance_to_model_m: Callable[[Float64Nx2], Float64N] | None = None,
    *,
    counts: PositionSource | None = None,
    from_file: Mapping[str, PositionPrior] | None = None,
) -> list[PhotoPriors]:
    """The priors of all photographs of a campaign.

    Args:
        photos: their metadata.
        distance_to_model_m: as in ``plausibility.check_priors``.
        counts: XMP or EXIF, where the portfolio says which position counts.
        from_file: positions of a file by photo_id, which count before those of the metadata; None: there is no file.

    Returns:
        The priors of each photograph.
    """
    photos = _unify_steps(photos)
    resolved = resolve_hemispheres(
        [photo.exif for photo in photos], [photo.drone for photo in photos], distance_to_model_m
    )
    photos = [
        replace(photo, exif=hemispheres.exif, warnings=(*photo.warnings, *hemispheres.warnings))
        for photo, hemispheres in zip(photos, resolved, strict=True)
    ]
    statements = resolve_contradictions(
        [photo.exif for photo in photos], [photo.drone for photo in photos], distance_to_model_m, counts
    )
    photos = [
        replace(photo, exif=stated.exif, drone=stated.drone, warnings=(*photo.warnings, *stated.warnings))
        for photo, stated in zip(photos, statements, strict=True)
    ]
    drones = _resolve_pitch_convention(photos)
    readings = [
        ClockReading(photo_id=p.photo_id, body=p.body, taken_at=p.exif.taken_at, gps_time=p.exif.gps_time)
        for p in photos
    ]
    clock_warnings = check_clocks(readings)
    flights = assign_flights([_build_exposure(photo) for photo in photos])
    timed = [
        TimedPrior(
            prior=_choose_position(photo, derive_position_prior(drone, photo.exif, counts), from_file),
            flight=flight,
            time_s=seconds_from_time(_get_time(photo)),
        )
        for photo, drone, flight in zip(photos, drones, flights, strict=True)
    ]
    positions = check_priors(timed, distance_to_model_m)
    focals = apply_zooms(
        [
            ZoomReading(
                camera=(photo.body, photo.exif.lens_model, photo.lens.image_source, photo.exif.focal_length_mm),
                size_px=(photo.width_px, photo.height_px),
                digital_zooms=photo.lens.digital_zooms,
                focal_length_35mm_mm=photo.exif.focal_length_35mm_mm,
                calibrated=derive_calibrated_focal(drone, width_px=photo.width_px, height_px=photo.height_px),
                prior=derive_focal_prior(drone, photo.exif, width_px=photo.width_px, height_px=photo.height_px),
            )
            for photo, drone in zip(photos, drones, strict=True)
        ]
    )
    out = []
    for i, photo in enumerate(photos):
        attitude = derive_attitude_prior(drones[i], photo.exif)
        warnings = (*photo.warnings, *positions[i].warnings, attitude.warning, focals[i].warning, clock_warnings[i])
        out.append(
            PhotoPriors(
                position=positions[i],
                attitude=attitude,
                focal=focals[i],
                serial=photo.serial,
                flight=flights[i],
                warnings=tuple(warning for warning in warnings if warning),
            )
        )
    return out


def _choose_position(
    photo: PhotoMetadata, by_metadata: PositionPrior, from_file: Mapping[str, PositionPrior] | None
) -> PositionPrior:
    if from_file is None:
        return by_metadata
    if photo.photo_id in from_file:
        return compare_with_metadata(from_file[photo.photo_id], by_metadata)
    used = (
        "its metadata have none"
        if by_metadata.source is PositionSource.NONE
        else f"{by_metadata.source.upper()} is used"
    )
    return replace(by_metadata, warnings=(*by_metadata.warnings, f"not in the positions file; {used}"))


def assign_to_flights(
    photos: Sequence[PhotoMetadata], others: Sequence[PhotoMetadata], flights: Sequence[int]
) -> list[int | None]:
    """The flights of ``photos`` that take no part in the block: that of the nearest in time of ``others``' same body.

    ``flights`` are those of ``others``; None where the body has no photograph within the gap that ends a flight.
    """
    timed = [(photo.body, _get_time(photo), flight) for photo, flight in zip(others, flights, strict=True)]
    found: list[int | None] = []
    for photo in photos:
        time = _get_time(photo)
        near = [
            (abs((at - time).total_seconds()), flight)
            for body, at, flight in timed
            if at is not None and time is not None and body == photo.body
        ]
        gap_s, flight = min(near, default=(math.inf, 0))
        found.append(flight if gap_s <= LONGEST_GAP_S else None)
    return found


def _get_time(photo: PhotoMetadata) -> datetime | None:
    return photo.exif.taken_at if is_clock_set(photo.exif.taken_at) else None


def _build_exposure(photo: PhotoMetadata) -> Exposure:
    drone = photo.drone
    return Exposure(
        photo_id=photo.photo_id,
        body=photo.body,
        lens=f"{photo.lens.image_source} {photo.exif.lens_model} {photo.width_px}",
        taken_at=_get_time(photo),
        flight_id=drone.flight_id if drone else "",
        take_off_height_m=drone.absolute_altitude_m - drone.relative_altitude_m if drone else math.nan,
    )


def _unify_steps(photos: Sequence[PhotoMetadata]) -> list[PhotoMetadata]:
    """Set each camera's resolutions of positions and heights to the finest found.

    Fractions may be reduced, and trailing zeros left out, in some of its photographs.
    """
    finest: dict[tuple[str, str], float] = {}
    for photo in photos:
        for name, step in _list_steps(photo).items():
            if math.isfinite(step):
                finest[photo.camera, name] = min(step, finest.get((photo.camera, name), math.inf))
    out = []
    for photo in photos:
        steps = {name: finest.get((photo.camera, name), math.nan) for name in _list_steps(photo)}
        exif = replace(photo.exif, position_step_deg=steps["exif"], altitude_step_m=steps["exif altitude"])
        drone = photo.drone and replace(
            photo.drone, position_step_deg=steps["xmp"], altitude_step_m=steps["xmp altitude"]
        )
        out.append(replace(photo, exif=exif, drone=drone))
    return out


def _list_steps(photo: PhotoMetadata) -> dict[str, float]:
    drone, exif = photo.drone, photo.exif
    return {
        "exif": exif.position_step_deg,
        "exif altitude": exif.altitude_step_m,
        "xmp": drone.position_step_deg if drone else math.nan,
        "xmp altitude": drone.altitude_step_m if drone else math.nan,
    }


def _resolve_pitch_convention(photos: Sequence[PhotoMetadata]) -> list[DroneMetadata | None]:
    """The metadata of the drones, with Camera:Pitch in the convention that all photographs of the camera imply."""
    dji_cameras = {
        camera
        for camera in {photo.camera for photo in photos}
        if is_dji_pitch(photo.drone.camera_pitch_deg for photo in photos if photo.camera == camera and photo.drone)
    }
    return [
        apply_dji_pitch(photo.drone)
        if photo.drone and photo.camera in dji_cameras and math.isfinite(photo.drone.camera_pitch_deg)
        else photo.drone
        for photo in photos
    ]
