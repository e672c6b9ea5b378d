"""The input of the bundle adjustment: the block with its initial values, and every observation with its sigma.

Unknowns are the exterior orientation of the photographs, the lenses, the object points (tie points and marked points,
three coordinates each, eliminated from the normal equations), and a few nuisance parameters: the deviation of each wall
from the model, and the common error of each flight's GPS and compass.
"""

from __future__ import annotations

from dataclasses import dataclass

from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Float64Nx2, Float64Nx3, Float64Nx3x3, RowIndices
from facadelake.core.camera import Camera


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """Initial values of the photographs.

    ``centre_site_m`` (n, 3), ``site_from_cam`` rotations (n, 3, 3), ``cameras`` (c), and ``camera_of_photo`` (n,): the
    row of the camera that took each photograph.
    """

    cameras: tuple[Camera, ...]
    camera_of_photo: RowIndices
    centre_site_m: Float64Nx3
    site_from_cam: Float64Nx3x3


@dataclass(frozen=True, kw_only=True, eq=False)
class ImagePoints:
    """Image points: photograph ``photo[k]`` shows object point ``point[k]`` at ``xy_img[k]``.

    ``photo`` (k,), ``point`` (k,), ``xy_img`` (k, 2) in pixels. ``whitening`` (k, 2, 2): its product with the residual
    in pixels has unit variance. ``is_tie_point`` (k,): the residual belongs to a tie point, whose sigma is estimated.
    """

    photo: RowIndices
    point: RowIndices
    xy_img: Float64Nx2
    whitening: Float64Array
    is_tie_point: BoolArray


@dataclass(frozen=True, kw_only=True, eq=False)
class PointPriors:
    """Object points with coordinates from a survey or an earlier campaign.

    ``point`` (k,), ``xyz_m`` (k, 3) in site, ``information`` (k, 3, 3) in 1/m2 (singular where a direction is unknown),
    ``loss_scale`` (k,): scale of the Cauchy loss in sigmas, beyond which a prior is down-weighted.
    """

    point: RowIndices
    xyz_m: Float64Nx3
    information: Float64Nx3x3
    loss_scale: Float64N

    def take(self, which: BoolArray) -> PointPriors:
        """The priors selected by ``which`` (k,)."""
        return PointPriors(
            point=self.point[which],
            xyz_m=self.xyz_m[which],
            information=self.information[which],
            loss_scale=self.loss_scale[which],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class PointToPlaneTerms:
    """Tie points on the model's surface: ``normal . point - distance_m - deviation[wall]`` is zero within ``sigma_m``.

    ``point`` (k,), ``normal_site`` (k, 3), ``distance_m`` (k,), ``wall`` (k,) row of a wall or -1 for none,
    ``sigma_m`` (k,). ``wall_sigma_m`` (w,): one sigma of the deviation of each wall as a whole from the model.
    """

    point: RowIndices
    normal_site: Float64Nx3
    distance_m: Float64N
    wall: RowIndices
    sigma_m: Float64N
    wall_sigma_m: Float64N


@dataclass(frozen=True, kw_only=True, eq=False)
class PositionTerms:
    """GPS positions: ``centre + offset[flight]`` equals ``xyz_site_m`` (k, 3) within ``sigma_m`` (k, 3).

    ``sigma_m`` is the noise between photographs; ``offset_sigma_m`` (f, 3) is one sigma of the error that all positions
    of a flight share.
    """

    photo: RowIndices
    flight: RowIndices
    xyz_site_m: Float64Nx3
    sigma_m: Float64Nx3
    offset_sigma_m: Float64Nx3


@dataclass(frozen=True, kw_only=True, eq=False)
class AttitudeTerms:
    """Gimbal attitudes: ``site_from_cam`` (k, 3, 3) within ``sigma_rad`` (k, 3) about the axes of site.

    ``yaw_sigma_rad`` (f,): one sigma of the compass error that all attitudes of a flight share.
    """

    photo: RowIndices
    flight: RowIndices
    site_from_cam: Float64Nx3x3
    sigma_rad: Float64Nx3
    yaw_sigma_rad: Float64N


@dataclass(frozen=True, kw_only=True, eq=False)
class AdjustmentProblem:
    """The bundle adjustment as a whole.

    ``initial_xyz_m`` (m, 3): initial object points in site. ``lens_prior_mean`` and ``lens_prior_sigma`` (c, 8; order
    ``LENS_PARAMETERS``): prior of the lenses; a sigma of 0 fixes the parameter at its mean.
    """

    block: Block
    initial_xyz_m: Float64Nx3
    image_points: ImagePoints
    point_priors: PointPriors
    point_to_plane: PointToPlaneTerms
    positions: PositionTerms
    attitudes: AttitudeTerms
    lens_prior_mean: Float64Array
    lens_prior_sigma: Float64Array
