"""Alignment of a block to GPS priors: by positions, and by attitudes where positions alone leave a rotation open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from facadelake.core.arrays import BoolArray, Float64Array, Float64Nx3, Float64Nx3x3
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.georeferencing.gps.priors import ATTITUDE_SIGMA_DEG, GpsPriors
from facadelake.georeferencing.similarity_fit import apply_parameters, fit_similarity
from facadelake.sfm import Reconstruction

# With less spread across the cameras' main line (in sigmas of a position), positions leave the rotation about it open.
_MIN_SPREAD_SIGMAS = 4.0
# Twelve degrees at 10 m are 2 m, about the error of GPS; a worse rotation is no placement.
_MAX_ROTATION_SIGMA_DEG = 12.0


@dataclass(frozen=True, kw_only=True, eq=False)
class GpsAlignment:
    """``site_from_sfm``, the priors used (n,), and remarks."""

    site_from_sfm: Similarity
    used: BoolArray
    remarks: tuple[str, ...]


def align_to_gps(reconstruction: Reconstruction, priors: GpsPriors) -> GpsAlignment:
    """Similarity of the block to the GPS priors.

    RANSAC over positions, then least squares with each prior's sigma per axis and the gimbal's attitudes as weak
    observations. Where the cameras are nearly collinear, the attitudes determine the rotation about their line.
    Raises GeoreferenceError for fewer than 3 priors, and for nearly collinear cameras without attitudes.
    """
    if len(priors.photo) < 3:
        raise GeoreferenceError(
            f"{len(priors.photo)} localised photographs have a GPS position with height; 3 or more are needed: "
            "give control points (gcp_list.txt), or photographs with GPS"
        )
    centres = reconstruction.centres_sfm[priors.photo]
    rotations_sfm = np.array([reconstruction.photos[i].sfm_from_cam.rotation for i in priors.photo])
    remarks: list[str] = []
    collinear = _compute_cross_spread(priors.xyz_site_m) < _MIN_SPREAD_SIGMAS * _estimate_noise(priors)
    if collinear:
        start, used = _align_by_attitude(centres, rotations_sfm, priors)
        remarks.append(
            "the cameras are nearly collinear: the rotation about their line is determined by gimbal attitudes alone"
        )
    else:
        fit = fit_similarity(centres, priors.xyz_site_m, priors.sigma_m)
        start, used = fit.target_from_source, fit.used
    site_from_sfm, rotation_sigma_deg = _refine_alignment(start, used, centres, rotations_sfm, priors)
    if rotation_sigma_deg > _MAX_ROTATION_SIGMA_DEG:
        raise GeoreferenceError(
            f"the GPS positions determine the block's rotation to {rotation_sigma_deg:.0f} deg only (limit "
            f"{_MAX_ROTATION_SIGMA_DEG:.0f} deg): the cameras are nearly collinear and have no attitude; "
            "give control points"
        )
    if not used.all():
        names = [reconstruction.photos[i].photo_id for i in priors.photo[~used]]
        remarks.append(f"GPS of {len(names)} photographs left out as gross errors: {', '.join(names[:5])}")
    if priors.datum_unknown:
        remarks.append("GPS heights have no stated datum: taken as ellipsoidal, so they may be off by the geoid height")
    return GpsAlignment(
        site_from_sfm=site_from_sfm,
        used=used,
        remarks=tuple(remarks),
    )


def _estimate_noise(priors: GpsPriors) -> float:
    """Sigma of one position relative to the others; a receiver's common bias does not rotate the block."""
    return float(np.median(priors.sigma_m[:, :2])) / 3.0


def _compute_cross_spread(xyz_m: Float64Nx3) -> float:
    """Standard deviation of positions (n, 3) along their second principal axis."""
    return float(np.linalg.svd(xyz_m - xyz_m.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(xyz_m)))


def _align_by_attitude(
    centres: Float64Nx3, rotations_sfm: Float64Nx3x3, priors: GpsPriors
) -> tuple[Similarity, BoolArray]:
    """Similarity with the mean rotation of the attitudes, and the priors (n,) that agree with it."""
    known = np.isfinite(priors.site_from_cam_rotation).all(axis=(1, 2))
    if known.sum() < 2:
        raise GeoreferenceError(
            "the cameras are nearly collinear and have no gimbal attitude, so the rotation about their line is "
            "undetermined; give control points (gcp_list.txt), or photographs from another height or side"
        )
    rotations = Rotation.from_matrix(priors.site_from_cam_rotation[known] @ rotations_sfm[known].transpose(0, 2, 1))
    rotation = rotations.mean().as_matrix()
    mean_site, mean_sfm = np.median(priors.xyz_site_m, axis=0), np.median(centres, axis=0)
    rotated = (centres - mean_sfm) @ rotation.T
    radius = np.linalg.norm(rotated, axis=1)
    ratio = np.linalg.norm(priors.xyz_site_m - mean_site, axis=1)[radius > 0] / radius[radius > 0]
    scale = float(np.median(ratio))
    start = Similarity(rotation=rotation, translation=mean_site - scale * rotation @ mean_sfm, scale=scale)
    distance = np.abs((priors.xyz_site_m - start.apply(centres)) / priors.sigma_m).max(axis=1)
    return start, distance < 3.5


def _refine_alignment(
    start: Similarity, used: BoolArray, centres: Float64Nx3, rotations_sfm: Float64Nx3x3, priors: GpsPriors
) -> tuple[Similarity, float]:
    """Least squares on positions and attitudes.

    Args:
        start: initial similarity.
        used: priors (n,) that take part.
        centres: camera centres (n, 3) in sfm.
        rotations_sfm: sfm_from_cam rotations (n, 3, 3).
        priors: the priors, in the same order.

    Returns:
        the similarity, and the largest one-sigma of its rotation in degrees.
    """
    pivot = start.apply(centres[used]).mean(axis=0)
    known = used & np.isfinite(priors.site_from_cam_rotation).all(axis=(1, 2))
    # One attitude error is common to a flight (compass, mounting), so n photographs weigh no more than one.
    weight = 1.0 / (np.radians(ATTITUDE_SIGMA_DEG) * np.sqrt(max(int(known.sum()), 1)))
    noise = priors.sigma_m[used] / 3.0

    def compute_residuals(step: Float64Array) -> Float64Array:
        similarity = apply_parameters(start, pivot, step)
        position = ((similarity.apply(centres[used]) - priors.xyz_site_m[used]) / noise).ravel()
        rotation = similarity.rotation @ rotations_sfm[known]
        angle = Rotation.from_matrix(rotation @ priors.site_from_cam_rotation[known].transpose(0, 2, 1)).as_rotvec()
        return np.concatenate([position, weight * angle.ravel()])

    fit = least_squares(compute_residuals, np.zeros(7), x_scale="jac", loss="soft_l1", f_scale=3.0)
    information = fit.jac.T @ fit.jac
    variance = np.linalg.pinv(information[3:6, 3:6] - _compute_eliminated_information(information), hermitian=True)
    weakest = np.linalg.eigvalsh(information[3:6, 3:6] - _compute_eliminated_information(information))[0]
    sigma = np.sqrt(np.linalg.eigvalsh(variance)[-1]) if weakest > 1e-9 else np.inf
    return apply_parameters(start, pivot, fit.x), float(np.degrees(sigma))


def _compute_eliminated_information(information: Float64Array) -> Float64Array:
    """What eliminating translation and scale subtracts from the rotation's information (3, 3): Schur complement."""
    others = [0, 1, 2, 6]
    cross = information[3:6][:, others]
    subtracted: Float64Array = cross @ np.linalg.pinv(information[np.ix_(others, others)], hermitian=True) @ cross.T
    return subtracted


def check_against_gps(site_from_sfm: Similarity, centres_sfm: Float64Nx3, priors: GpsPriors, *, by: str) -> None:
    """Check a placement by other control against GPS: it may shift the block as a whole, not rotate or scale it.

    Args:
        site_from_sfm: the placement.
        centres_sfm: camera centres (n, 3) of the priors' photographs.
        priors: the GPS priors.
        by: what placed the block, for the message.

    Raises:
        GeoreferenceError: the median photograph is off by more than a sigma after the common shift is removed; a few
            photographs with wrong GPS do not matter.
    """
    if len(priors.photo) < 3:
        return
    residual = priors.xyz_site_m - site_from_sfm.apply(centres_sfm)
    normalised = np.abs(residual - np.median(residual, axis=0)) / priors.sigma_m
    median = float(np.median(normalised.max(axis=1)))
    if median > 1.0:
        raise GeoreferenceError(
            f"placed by {by}, the block is rotated or scaled against its GPS positions: the median photograph is "
            f"{median:.1f} sigmas off (limit 1); check the control points or the model, "
            "or the photographs' GPS (latitude and longitude swapped?)"
        )
