"""GPS priors of the localised photographs: positions, gimbal attitudes, flights and sigmas, in site."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from facadelake.core.arrays import Float64Array, Float64N, Float64Nx3, Float64Nx3x3, Float64x3, Float64x3x3, Int64Array
from facadelake.georeferencing.datum_shift import DatumShift, find_datum_shift, site_from_crs
from facadelake.georeferencing.site_frame import SiteFrame
from facadelake.sfm import Reconstruction
from schemas.vocabulary import HeightDatum, PositionSource

# A gimbal's yaw comes from a compass, off by degrees near steel and concrete; pitch and roll are better, but drift.
ATTITUDE_SIGMA_DEG = 6.0
# Geoid undulations are tens of metres (-106 to 85 on Earth, 36 to 50 in Germany).
DATUM_SIGMA_M = 50.0
_MIN_STATED_HEIGHTS = 3
# What the block's own bending adds to a position; without it an RTK sigma of 1 cm would reject good cameras.
BLOCK_SIGMA_M = 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class GpsPriors:
    """Priors of the localised photographs that have one: row k belongs to photograph ``photo[k]`` of the block.

    ``xyz_site_m`` (n, 3) and ``sigma_m`` (n, 3). ``datum_unknown``: fewer than three heights have a stated datum,
    so that all of them may be off by one common amount (tens of metres, where they are above sea level).
    ``site_from_cam_rotation`` (n, 3, 3) from the gimbal, NaN where unknown, with ``sigma_yaw_deg`` and
    ``sigma_tilt_deg`` (n,), NaN where the metadata state none. ``flight`` (n,) from 0. ``height_relative_m``
    (n,) above the take-off, NaN where unknown.
    ``unlike_heights``: photographs whose height has no stated datum while others have one; its sigma covers that.
    ``datum_shift``: from the datum of the positions to that of the model; an error that all flights share.
    """

    photo: Int64Array
    xyz_site_m: Float64Nx3
    sigma_m: Float64Nx3
    datum_unknown: bool
    site_from_cam_rotation: Float64Nx3x3
    sigma_yaw_deg: Float64N
    sigma_tilt_deg: Float64N
    flight: Int64Array
    height_relative_m: Float64N
    datum_shift: DatumShift | None = None
    unlike_heights: tuple[str, ...] = ()

    def shift_height(self, up_m: float) -> GpsPriors:
        """The same priors with ``up_m`` added to their heights."""
        return replace(self, xyz_site_m=self.xyz_site_m + np.array([0.0, 0.0, up_m]))

    @property
    def total_sigma_m(self) -> Float64Nx3:
        """One sigma (n, 3) of each position in the model's datum, with that of an unknown height datum."""
        total: Float64Array = np.maximum(np.hypot(self.sigma_m, self.datum_sigma_m), self.convention_m)
        return total

    @property
    def common_sigma_m(self) -> Float64x3:
        """One sigma (3,) of the error that all priors share: the receiver's, and that of their datums."""
        sigma: Float64Array = np.median(self.total_sigma_m, axis=0)
        return sigma

    @property
    def convention_m(self) -> float:
        """Accuracy at which the datum of the positions is taken as that of the model without a shift; 0: it is not."""
        return 0.0 if self.datum_shift is None else self.datum_shift.convention_m

    @property
    def observed_shift(self) -> DatumShift | None:
        """The shift where the positions are the control: a null transformation has its stated accuracy."""
        return None if self.datum_shift is None else self.datum_shift.include_convention()

    @property
    def observed_covariance_m2(self) -> Float64x3x3:
        """Covariance (3, 3) of the datums where the positions are the control: all flights share its error."""
        shift = self.observed_shift
        covariance = np.zeros((3, 3)) if shift is None else shift.covariance_m2.copy()
        if self.datum_unknown:
            covariance[2, 2] += DATUM_SIGMA_M**2
        return covariance

    @property
    def datum_sigma_m(self) -> Float64x3:
        """One sigma (3,) of the shift to the model's datum, and of an unknown height datum."""
        sigma = np.zeros(3) if self.datum_shift is None else self.datum_shift.sigma_m.copy()
        if self.datum_unknown:
            sigma[2] = np.hypot(sigma[2], DATUM_SIGMA_M)
        return sigma


def rotation_from_attitude(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Float64x3x3:
    """site_from_cam rotation (3, 3) of a gimbal: yaw clockwise from north, pitch above the horizon, roll clockwise.

    At zero the camera looks north, its x to the east, its y down.
    """
    level = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    attitude = Rotation.from_euler("ZXY", [-yaw_deg, pitch_deg, roll_deg], degrees=True).as_matrix()
    rotation: Float64Array = attitude @ level
    return rotation


def collect_gps_priors(reconstruction: Reconstruction, photos: pa.Table, site_frame: SiteFrame) -> GpsPriors:
    """The priors of the block's photographs from table ``photos``, in site.

    Raises GeoreferenceError where PROJ has no operation from their CRS to that of the model.
    """
    row_of = {row["photo_id"]: row for row in photos.to_pylist()}
    index: list[int] = []
    geo, sigma, rotations, attitude_sigma, flights, relative = [], [], [], [], [], []
    ellipsoidal: list[bool] = []
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
        ellipsoidal.append(row["prior_height_datum"] == HeightDatum.ELLIPSOIDAL)
    sigma_m = np.hypot(np.array(sigma).reshape(-1, 3), BLOCK_SIGMA_M)
    datum_unknown = sum(ellipsoidal) < min(_MIN_STATED_HEIGHTS, len(ellipsoidal)) or not ellipsoidal
    # Heights with a stated datum count; a few others beside them have a sigma that covers any datum.
    unlike = np.flatnonzero(~np.array(ellipsoidal, dtype=bool) & (not datum_unknown))
    sigma_m[unlike, 2] = np.hypot(sigma_m[unlike, 2], DATUM_SIGMA_M)
    attitude_sigmas = np.array(attitude_sigma).reshape(-1, 2)
    return GpsPriors(
        photo=np.array(index, dtype=np.int64),
        xyz_site_m=site_from_crs(np.array(geo).reshape(-1, 3), site_frame.gnss_crs, site_frame),
        datum_shift=find_datum_shift(site_frame.gnss_crs, site_frame),
        sigma_m=sigma_m,
        datum_unknown=datum_unknown,
        unlike_heights=tuple(reconstruction.photos[index[row]].photo_id for row in unlike),
        site_from_cam_rotation=np.array(rotations).reshape(-1, 3, 3),
        sigma_yaw_deg=attitude_sigmas[:, 0],
        sigma_tilt_deg=attitude_sigmas[:, 1],
        height_relative_m=np.array(relative, dtype=np.float64),
        flight=np.unique(np.array(flights, dtype=np.int64), return_inverse=True)[1].ravel(),
    )


def _replace_none_by_nan(value: float | None) -> float:
    return np.nan if value is None else value
