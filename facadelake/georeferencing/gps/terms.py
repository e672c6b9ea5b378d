"""GPS positions and gimbal attitudes as observations of the adjustment, with a common error for each flight."""

from __future__ import annotations

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Nx3, Float64x3
from facadelake.georeferencing.adjustment.problem import AttitudeTerms, PositionTerms
from facadelake.georeferencing.gps.priors import ATTITUDE_SIGMA_DEG, GpsPriors

# The part of a prior's sigma that differs from photograph to photograph, where a flight is too short to estimate it.
_NOISE_SHARE = 1.0 / 3.0
_MIN_NOISE_SHARE = 0.1
_MIN_PRIORS_FOR_SCATTER = 8
_MAD_TO_SIGMA = 1.4826
_YAW_NOISE_DEG = 2.0
_TILT_SIGMA_DEG = 2.0


def build_position_terms(
    priors: GpsPriors,
    used: BoolArray,
    initial_xyz_m: Float64Nx3,
    *,
    datum_sigma_m: Float64x3,
    convention_m: float = 0.0,
) -> PositionTerms:
    """The ``used`` priors (n,) as observations.

    The noise is estimated from their scatter about the initial camera centres after each flight's common offset is
    removed; the offset of a flight has the sigma of its priors and that of the datum.

    Args:
        priors: the GPS priors.
        used: those (n,) that take part.
        initial_xyz_m: initial camera centres (n, 3) of their photographs, in site.
        datum_sigma_m: one sigma (3,) of the datum of the positions beside better control; zero where the positions are
            the control, whose common error no observation determines.
        convention_m: least sigma of an offset beside better control: accuracy at which WGS 84 is taken as the model's
            datum.

    Returns:
        the observations.
    """
    flights = int(priors.flight.max(initial=-1)) + 1
    noise = priors.sigma_m * _NOISE_SHARE
    offset = np.zeros((flights, 3))
    for flight in range(flights):
        rows = used & (priors.flight == flight)
        offset[flight] = np.median(priors.sigma_m[rows], axis=0) if rows.any() else 1.0
        if rows.sum() >= _MIN_PRIORS_FOR_SCATTER:
            residual = priors.xyz_site_m[rows] - initial_xyz_m[rows]
            scatter = _MAD_TO_SIGMA * np.median(np.abs(residual - np.median(residual, axis=0)), axis=0)
            noise[rows] = np.clip(scatter, _MIN_NOISE_SHARE * priors.sigma_m[rows], priors.sigma_m[rows])
    return PositionTerms(
        photo=priors.photo[used],
        flight=priors.flight[used],
        xyz_site_m=priors.xyz_site_m[used],
        sigma_m=noise[used],
        offset_sigma_m=np.maximum(np.hypot(offset, datum_sigma_m), convention_m),
    )


def build_datum_terms(
    priors: GpsPriors, used: BoolArray, initial_xyz_m: Float64Nx3, datum_sigma_m: Float64x3
) -> PositionTerms:
    """The ``used`` priors as observations of a block whose initial placement is better than GPS.

    Args:
        priors: the GPS priors.
        used: those (n,) that take part.
        initial_xyz_m: initial camera centres (n, 3) of their photographs, in site.
        datum_sigma_m: one sigma (3,) of the initial placement: the block's datum is constrained to it.

    Returns:
        positions less each flight's median offset from the initial placement, so that they constrain the block's shape
        and its datum within ``datum_sigma_m``.
    """
    terms = build_position_terms(priors, used, initial_xyz_m, datum_sigma_m=np.zeros(3))
    offset = np.array(
        [
            np.median((priors.xyz_site_m - initial_xyz_m)[used & (priors.flight == flight)], axis=0)
            if (used & (priors.flight == flight)).any()
            else np.zeros(3)
            for flight in range(len(terms.offset_sigma_m))
        ]
    )
    return PositionTerms(
        photo=terms.photo,
        flight=terms.flight,
        xyz_site_m=terms.xyz_site_m - offset[terms.flight],
        sigma_m=terms.sigma_m,
        offset_sigma_m=np.broadcast_to(datum_sigma_m, terms.offset_sigma_m.shape).copy(),
    )


def build_attitude_terms(priors: GpsPriors) -> AttitudeTerms:
    """The gimbal attitudes as observations, where the photographs have one; a flight shares one compass error."""
    known = np.isfinite(priors.site_from_cam_rotation).all(axis=(1, 2))
    flights = int(priors.flight.max(initial=-1)) + 1
    tilt = np.where(np.isfinite(priors.sigma_tilt_deg), priors.sigma_tilt_deg, _TILT_SIGMA_DEG)
    yaw = np.where(np.isfinite(priors.sigma_yaw_deg), priors.sigma_yaw_deg, ATTITUDE_SIGMA_DEG)
    # Near the nadir yaw itself is unreliable; elsewhere its noise is small beside the error common to the flight.
    noise = np.maximum(_YAW_NOISE_DEG, np.where(yaw > 2 * ATTITUDE_SIGMA_DEG, yaw, 0.0))
    return AttitudeTerms(
        photo=priors.photo[known],
        flight=priors.flight[known],
        site_from_cam=priors.site_from_cam_rotation[known],
        sigma_rad=np.radians(np.column_stack([tilt, tilt, noise])[known]),
        yaw_sigma_rad=np.full(flights, np.radians(ATTITUDE_SIGMA_DEG)),
    )
