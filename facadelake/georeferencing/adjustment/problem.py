"""What a bundle adjustment is given: the block as it starts, and every observation of it with its sigma.

Unknowns are photographs (centre and attitude), lenses, and two kinds of smaller ones: *nodes*, three coordinates each,
which are eliminated (the place of a tie point or a marked point), and *walls* and *flights*, few and
kept (the deviation of a wall from the model; the common error of a flight's GPS and compass).
"""

from __future__ import annotations

from dataclasses import dataclass

from facadelake.core.arrays import BoolArray, Float64Array, RowIndices
from facadelake.core.camera import Camera


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """Photographs as they stand: ``centre_site_m`` (n, 3), ``site_from_cam`` rotations (n, 3, 3), ``cameras`` (c) and
    which of them took each photograph, ``camera_of_photo`` (n,)."""

    cameras: tuple[Camera, ...]
    camera_of_photo: RowIndices
    centre_site_m: Float64Array
    site_from_cam: Float64Array


@dataclass(frozen=True, kw_only=True, eq=False)
class ImagePoints:
    """Image observations of nodes: a photograph shows ``offset_site_m + node`` at ``xy_img``.

    ``photo`` (k,), ``point`` (k,), ``offset_site_m`` (k, 3; zero for points), ``xy_img`` (k, 2), ``whitening``
    (k, 2, 2): times the residual in pixels gives unit variance (a line has a second row of zeros), ``is_tie_point`` (k,):
    whether the residual counts to the tie points' variance, which is estimated. Lines and offsets serve sightings of
    model edges; no control makes them now (decision 9).
    """

    photo: RowIndices
    point: RowIndices
    offset_site_m: Float64Array
    xy_img: Float64Array
    whitening: Float64Array
    is_tie_point: BoolArray


@dataclass(frozen=True, kw_only=True, eq=False)
class PointPriors:
    """Nodes whose coordinates are known from elsewhere: ``point`` (k,), ``xyz_m`` (k, 3), ``information`` (k, 3, 3) in
    1/m2 (singular where a direction is not known), ``loss_scale`` (k,) in sigmas, beyond which a prior loses its say."""

    point: RowIndices
    xyz_m: Float64Array
    information: Float64Array
    loss_scale: Float64Array

    def take(self, which: BoolArray) -> PointPriors:
        """Those of ``which`` (k,)."""
        return PointPriors(
            point=self.point[which],
            xyz_m=self.xyz_m[which],
            information=self.information[which],
            loss_scale=self.loss_scale[which],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class PointToPlaneTerms:
    """Tie points on the model's surface: ``normal . node - distance_m - deviation[wall]`` is zero within ``sigma_m``.

    ``point`` (k,), ``normal_site`` (k, 3), ``distance_m`` (k,), ``wall`` (k,) row of a wall or -1 for none;
    ``wall_sigma_m`` (w,) is how far each wall as a whole may stand off the model.
    """

    point: RowIndices
    normal_site: Float64Array
    distance_m: Float64Array
    wall: RowIndices
    sigma_m: Float64Array
    wall_sigma_m: Float64Array


@dataclass(frozen=True, kw_only=True, eq=False)
class PositionTerms:
    """GPS: ``centre + offset[flight]`` is ``xyz_site_m`` (k, 3) within ``sigma_m`` (k, 3), the noise between
    photographs; ``offset_sigma_m`` (f, 3) bounds what a flight's positions have in common."""

    photo: RowIndices
    flight: RowIndices
    xyz_site_m: Float64Array
    sigma_m: Float64Array
    offset_sigma_m: Float64Array


@dataclass(frozen=True, kw_only=True, eq=False)
class AttitudeTerms:
    """Gimbal attitudes: ``site_from_cam`` (k, 3, 3) within ``sigma_rad`` (k, 3) about site's axes, after a yaw that is
    common to a flight (compass), of ``yaw_sigma_rad`` (f,)."""

    photo: RowIndices
    flight: RowIndices
    site_from_cam: Float64Array
    sigma_rad: Float64Array
    yaw_sigma_rad: Float64Array


@dataclass(frozen=True, kw_only=True, eq=False)
class AdjustmentProblem:
    """The whole adjustment.

    ``initial_xyz_m`` (m, 3) are the nodes' starts. ``lens_prior_mean`` and ``lens_prior_sigma`` (c, 8) are what is known of the lenses
    beforehand (order: LENS_TERMS); a sigma of 0 holds the term at its mean.
    """

    block: Block
    initial_xyz_m: Float64Array
    image_points: ImagePoints
    point_priors: PointPriors
    point_to_plane: PointToPlaneTerms
    positions: PositionTerms
    attitudes: AttitudeTerms
    lens_prior_mean: Float64Array
    lens_prior_sigma: Float64Array
