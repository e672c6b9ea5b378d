"""GPS priors and gimbal attitudes as observations of the adjustment, with a common error for each flight."""

from __future__ import annotations

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array
from facadelake.georeferencing.adjustment.problem import AttitudeTerms, PositionTerms
from facadelake.georeferencing.gps.alignment import ATTITUDE_SIGMA_DEG, DATUM_SIGMA_M, GpsPriors

# The part of a prior's sigma that differs from photograph to photograph, where the flight is too short to tell.
_NOISE_SHARE = 1.0 / 3.0
_MIN_NOISE_SHARE = 0.1
_MIN_PRIORS_FOR_SCATTER = 8
_MAD_TO_SIGMA = 1.4826
_YAW_NOISE_DEG = 2.0
_TILT_SIGMA_DEG = 2.0


def build_position_terms(priors: GpsPriors, used: BoolArray, xyz_start_m: Float64Array) -> PositionTerms:
    """The ``used`` priors (n,), their noise taken from how they scatter about ``xyz_start_m`` (n, 3), the cameras'
    starts, after each flight's common offset; a flight's offset has the priors' own sigma."""
    flights = int(priors.flight.max(initial=-1)) + 1
    noise = priors.sigma_m * _NOISE_SHARE
    offset = np.zeros((flights, 3))
    for flight in range(flights):
        own = used & (priors.flight == flight)
        offset[flight] = np.median(priors.sigma_m[own], axis=0) if own.any() else 1.0
        if priors.datum_unknown:
            offset[flight, 2] = np.hypot(offset[flight, 2], DATUM_SIGMA_M)
        if own.sum() >= _MIN_PRIORS_FOR_SCATTER:
            away = priors.xyz_site_m[own] - xyz_start_m[own]
            scatter = _MAD_TO_SIGMA * np.median(np.abs(away - np.median(away, axis=0)), axis=0)
            noise[own] = np.clip(scatter, _MIN_NOISE_SHARE * priors.sigma_m[own], priors.sigma_m[own])
    return PositionTerms(
        photo=priors.photo[used],
        flight=priors.flight[used],
        xyz_site_m=priors.xyz_site_m[used],
        sigma_m=noise[used],
        offset_sigma_m=offset,
    )


def build_datum_terms(
    priors: GpsPriors, used: BoolArray, xyz_start_m: Float64Array, datum_sigma_m: Float64Array
) -> PositionTerms:
    """The ``used`` priors for a block that something better than GPS has placed: their common offset to the start is
    taken out, and the block's datum is held at the start within ``datum_sigma_m`` (3,)."""
    own = build_position_terms(priors, used, xyz_start_m)
    offset = np.array(
        [
            np.median((priors.xyz_site_m - xyz_start_m)[used & (priors.flight == flight)], axis=0)
            if (used & (priors.flight == flight)).any()
            else np.zeros(3)
            for flight in range(len(own.offset_sigma_m))
        ]
    )
    return PositionTerms(
        photo=own.photo,
        flight=own.flight,
        xyz_site_m=own.xyz_site_m - offset[own.flight],
        sigma_m=own.sigma_m,
        offset_sigma_m=np.broadcast_to(datum_sigma_m, own.offset_sigma_m.shape).copy(),
    )


def build_attitude_terms(priors: GpsPriors) -> AttitudeTerms:
    """The gimbal's attitudes, where the photographs have one; compass yaw has an error common to a flight."""
    known = np.isfinite(priors.site_from_cam_rotation).all(axis=(1, 2))
    flights = int(priors.flight.max(initial=-1)) + 1
    tilt = np.where(np.isfinite(priors.sigma_tilt_deg), priors.sigma_tilt_deg, _TILT_SIGMA_DEG)
    yaw = np.where(np.isfinite(priors.sigma_yaw_deg), priors.sigma_yaw_deg, ATTITUDE_SIGMA_DEG)
    # Near the nadir yaw is unreliable in itself; elsewhere its noise is small beside what the flight has in common.
    noise = np.maximum(_YAW_NOISE_DEG, np.where(yaw > 2 * ATTITUDE_SIGMA_DEG, yaw, 0.0))
    return AttitudeTerms(
        photo=priors.photo[known],
        flight=priors.flight[known],
        site_from_cam=priors.site_from_cam_rotation[known],
        sigma_rad=np.radians(np.column_stack([tilt, tilt, noise])[known]),
        yaw_sigma_rad=np.full(flights, np.radians(ATTITUDE_SIGMA_DEG)),
    )
