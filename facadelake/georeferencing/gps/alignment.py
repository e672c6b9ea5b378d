"""Alignment to GPS priors: positions, and attitudes where positions alone leave a rotation open."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from facadelake.core.arrays import BoolArray, Float64Array, Int64Array
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.georeferencing.similarity_fit import apply_parameters, fit_similarity
from facadelake.sfm import Reconstruction
from schemas.vocabulary import HeightDatum, PositionSource

# A gimbal's yaw is a compass's, off by degrees near steel and concrete; pitch and roll are better, but drift.
ATTITUDE_SIGMA_DEG = 6.0
# Geoid undulations are tens of metres (-106 to 85 on Earth, 36 to 50 in Germany).
DATUM_SIGMA_M = 50.0
# What the block's own bending adds to a position; without it an RTK sigma of 1 cm would reject good cameras.
BLOCK_SIGMA_M = 0.05
# Below this spread across the cameras' main line (in sigmas of a position), positions do not fix the turn about it.
_MIN_SPREAD_SIGMAS = 4.0
# Twelve degrees at 10 m are 2 m, what GPS is off anyway; beyond it the placement is a guess.
_MAX_ROTATION_SIGMA_DEG = 12.0


@dataclass(frozen=True, kw_only=True, eq=False)
class GpsPriors:
    """Priors of the localised photographs that have one: row k belongs to photograph ``photo[k]`` of the block.

    ``xyz_site_m`` (n, 3) and ``sigma_m`` (n, 3); ``datum_unknown`` says that no height names its datum, so that all
    of them may be off by one common amount (tens of metres, where they are above sea level);
    ``site_from_cam_rotation`` (n, 3, 3) from the gimbal, NaN where unknown, with ``sigma_yaw_deg`` and
    ``sigma_tilt_deg`` (n,), NaN where the photograph states none; ``flight`` (n,) from 0; ``height_relative_m`` (n,)
    above the take-off, NaN where unknown.
    """

    photo: Int64Array
    xyz_site_m: Float64Array
    sigma_m: Float64Array
    datum_unknown: bool
    site_from_cam_rotation: Float64Array
    sigma_yaw_deg: Float64Array
    sigma_tilt_deg: Float64Array
    flight: Int64Array
    height_relative_m: Float64Array

    def shift_height(self, up_m: float) -> GpsPriors:
        """The same priors ``up_m`` higher."""
        return replace(self, xyz_site_m=self.xyz_site_m + np.array([0.0, 0.0, up_m]))

    @property
    def common_sigma_m(self) -> Float64Array:
        """One sigma (3,) of the error that all priors share: the receiver's, and for heights the unknown datum's."""
        sigma: Float64Array = np.median(self.sigma_m, axis=0)
        if self.datum_unknown:
            sigma[2] = np.hypot(sigma[2], DATUM_SIGMA_M)
        return sigma


def rotation_from_attitude(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Float64Array:
    """site_from_cam rotation (3, 3) of a gimbal: yaw clockwise from north, pitch above the horizon, roll clockwise.

    At zero the camera looks north, its x to the east, its y down.
    """
    level = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    turn = Rotation.from_euler("ZXY", [-yaw_deg, pitch_deg, roll_deg], degrees=True).as_matrix()
    rotation: Float64Array = turn @ level
    return rotation


def collect_gps_priors(reconstruction: Reconstruction, photos: pa.Table, origin: SiteOrigin) -> GpsPriors:
    """The position and attitude priors of the block's photographs, in site."""
    row_of = {row["photo_id"]: row for row in photos.to_pylist()}
    index: list[int] = []
    geo, sigma, rotations, attitude_sigma, flights, relative = [], [], [], [], [], []
    datums = set()
    for i, photo in enumerate(reconstruction.photos):
        row = row_of.get(photo.photo_id)
        if row is None or row["prior_source"] == PositionSource.NONE or row["prior_height_m"] is None:
            continue
        index.append(i)
        geo.append([row["prior_lon_deg"], row["prior_lat_deg"], row["prior_height_m"]])
        sigma.append([*[row["prior_sigma_horizontal_m"]] * 2, row["prior_sigma_vertical_m"]])
        attitude = (row["prior_yaw_deg"], row["prior_pitch_deg"], row["prior_roll_deg"])
        known = None not in attitude
        rotations.append(rotation_from_attitude(*attitude) if known else np.full((3, 3), np.nan))
        attitude_sigma.append(
            [_replace_none_by_nan(row["prior_sigma_yaw_deg"]), _replace_none_by_nan(row["prior_sigma_tilt_deg"])]
        )
        flights.append(row["flight"] or 0)
        relative.append(_replace_none_by_nan(row["prior_height_relative_m"]))
        datums.add(row["prior_height_datum"])
    attitude_sigmas = np.array(attitude_sigma).reshape(-1, 2)
    return GpsPriors(
        photo=np.array(index, dtype=np.int64),
        xyz_site_m=origin.site_from_geo(np.array(geo).reshape(-1, 3)),
        sigma_m=np.hypot(np.array(sigma).reshape(-1, 3), BLOCK_SIGMA_M),
        datum_unknown=datums != {HeightDatum.ELLIPSOIDAL},
        site_from_cam_rotation=np.array(rotations).reshape(-1, 3, 3),
        sigma_yaw_deg=attitude_sigmas[:, 0],
        sigma_tilt_deg=attitude_sigmas[:, 1],
        height_relative_m=np.array(relative, dtype=np.float64),
        flight=np.unique(np.array(flights, dtype=np.int64), return_inverse=True)[1].ravel(),
    )


def _replace_none_by_nan(value: float | None) -> float:
    return np.nan if value is None else value


@dataclass(frozen=True, kw_only=True, eq=False)
class GpsAlignment:
    """``site_from_sfm``, which priors it rests on (n,), residuals ``prior - camera centre`` (n, 3) and remarks."""

    site_from_sfm: Similarity
    used: BoolArray
    residual_m: Float64Array
    remarks: tuple[str, ...]


def align_to_gps(reconstruction: Reconstruction, priors: GpsPriors) -> GpsAlignment:
    """Similarity of the block to the GPS priors.

    RANSAC over positions, then least squares with each prior's sigma per axis and the gimbal's attitudes as weak
    observations. Where the cameras stand near one line, the attitudes carry the turn about it; without attitudes
    that is refused (GeoreferenceError), as is too few priors.
    """
    if len(priors.photo) < 3:
        raise GeoreferenceError(
            f"{len(priors.photo)} localised photographs have a GPS position with height; 3 or more are needed: "
            "give control points (gcp_list.txt), or photographs with GPS"
        )
    centres = reconstruction.centres_sfm[priors.photo]
    rotations_sfm = np.array([reconstruction.photos[i].sfm_from_cam.rotation for i in priors.photo])
    remarks: list[str] = []
    near_line = _compute_cross_spread(priors.xyz_site_m) < _MIN_SPREAD_SIGMAS * _estimate_noise(priors)
    if near_line:
        start, used = _align_by_attitude(centres, rotations_sfm, priors)
        remarks.append("the cameras stand near one line: the turn about it rests on the gimbal's attitudes")
    else:
        fit = fit_similarity(centres, priors.xyz_site_m, priors.sigma_m)
        start, used = fit.target_from_source, fit.used
    adjusted, rotation_sigma_deg = _refine_alignment(start, used, centres, rotations_sfm, priors)
    if rotation_sigma_deg > _MAX_ROTATION_SIGMA_DEG:
        raise GeoreferenceError(
            f"the GPS positions leave the block's rotation open by {rotation_sigma_deg:.0f} deg (limit "
            f"{_MAX_ROTATION_SIGMA_DEG:.0f}): the cameras stand near one line and have no attitude; "
            "give control points"
        )
    if not used.all():
        names = [reconstruction.photos[i].photo_id for i in priors.photo[~used]]
        remarks.append(f"GPS of {len(names)} photographs left out as gross errors: {', '.join(names[:5])}")
    if priors.datum_unknown:
        remarks.append("GPS heights do not name their datum: taken as ellipsoidal, so heights may be off by the geoid")
    return GpsAlignment(
        site_from_sfm=adjusted,
        used=used,
        residual_m=priors.xyz_site_m - adjusted.apply(centres),
        remarks=tuple(remarks),
    )


def _estimate_noise(priors: GpsPriors) -> float:
    """Sigma of one position relative to the others; a receiver's common bias does not turn the block."""
    return float(np.median(priors.sigma_m[:, :2])) / 3.0


def _compute_cross_spread(xyz_m: Float64Array) -> float:
    """Standard deviation of positions across their main line, in the best other direction."""
    return float(np.linalg.svd(xyz_m - xyz_m.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(xyz_m)))


def _align_by_attitude(
    centres: Float64Array, rotations_sfm: Float64Array, priors: GpsPriors
) -> tuple[Similarity, BoolArray]:
    known = np.isfinite(priors.site_from_cam_rotation).all(axis=(1, 2))
    if known.sum() < 2:
        raise GeoreferenceError(
            "the cameras stand near one line and carry no gimbal attitude, so the turn about that line is open; "
            "give control points (gcp_list.txt), or photographs from another height or side"
        )
    turns = Rotation.from_matrix(priors.site_from_cam_rotation[known] @ rotations_sfm[known].transpose(0, 2, 1))
    rotation = turns.mean().as_matrix()
    mean_site, mean_sfm = np.median(priors.xyz_site_m, axis=0), np.median(centres, axis=0)
    turned = (centres - mean_sfm) @ rotation.T
    wide = np.linalg.norm(turned, axis=1)
    ratio = np.linalg.norm(priors.xyz_site_m - mean_site, axis=1)[wide > 0] / wide[wide > 0]
    scale = float(np.median(ratio))
    start = Similarity(rotation=rotation, translation=mean_site - scale * rotation @ mean_sfm, scale=scale)
    distance = np.abs((priors.xyz_site_m - start.apply(centres)) / priors.sigma_m).max(axis=1)
    return start, distance < 3.5


def _refine_alignment(
    start: Similarity, used: BoolArray, centres: Float64Array, rotations_sfm: Float64Array, priors: GpsPriors
) -> tuple[Similarity, float]:
    """Least squares from ``start``; also the largest one-sigma of its rotation, in degrees."""
    pivot = start.apply(centres[used]).mean(axis=0)
    known = used & np.isfinite(priors.site_from_cam_rotation).all(axis=(1, 2))
    # One attitude error is common to a flight (compass, mounting), so n photographs weigh no more than one.
    weight = 1.0 / (np.radians(ATTITUDE_SIGMA_DEG) * np.sqrt(max(int(known.sum()), 1)))
    noise = priors.sigma_m[used] / 3.0

    def residuals(step: Float64Array) -> Float64Array:
        now = apply_parameters(start, pivot, step)
        position = ((now.apply(centres[used]) - priors.xyz_site_m[used]) / noise).ravel()
        turn = now.rotation @ rotations_sfm[known]
        angle = Rotation.from_matrix(turn @ priors.site_from_cam_rotation[known].transpose(0, 2, 1)).as_rotvec()
        return np.concatenate([position, weight * angle.ravel()])

    fit = least_squares(residuals, np.zeros(7), x_scale="jac", loss="soft_l1", f_scale=3.0)
    information = fit.jac.T @ fit.jac
    variance = np.linalg.pinv(information[3:6, 3:6] - _compute_eliminated_information(information), hermitian=True)
    weakest = np.linalg.eigvalsh(information[3:6, 3:6] - _compute_eliminated_information(information))[0]
    sigma = np.sqrt(np.linalg.eigvalsh(variance)[-1]) if weakest > 1e-9 else np.inf
    return apply_parameters(start, pivot, fit.x), float(np.degrees(sigma))


def _compute_eliminated_information(information: Float64Array) -> Float64Array:
    """What translation and scale take from the rotation's information (Schur complement)."""
    others = [0, 1, 2, 6]
    cross = information[3:6][:, others]
    taken: Float64Array = cross @ np.linalg.pinv(information[np.ix_(others, others)], hermitian=True) @ cross.T
    return taken


def check_against_gps(site_from_sfm: Similarity, centres_sfm: Float64Array, priors: GpsPriors, *, by: str) -> None:
    """A placement ``by`` something else may shift the block against GPS as a whole, not turn or stretch it against GPS.

    ``centres_sfm`` (n, 3) belong to ``priors``. Raises GeoreferenceError where the median photograph is off by more
    than a sigma after the common shift is taken out; a few photographs with wrong GPS do not matter.
    """
    if len(priors.photo) < 3:
        return
    left = priors.xyz_site_m - site_from_sfm.apply(centres_sfm)
    left = np.abs(left - np.median(left, axis=0)) / priors.sigma_m
    worst = float(np.median(left.max(axis=1)))
    if worst > 1.0:
        raise GeoreferenceError(
            f"placed by {by}, the block is turned or stretched against its GPS positions: the median photograph is "
            f"{worst:.1f} sigmas off (limit 1); check the control points or the model, "
            "or the photographs' GPS (latitude and longitude swapped?)"
        )
