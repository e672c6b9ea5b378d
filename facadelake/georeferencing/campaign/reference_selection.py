"""Selection of the tie points that become a campaign's reference: accurate, recognisable, spread over the building."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from facadelake.core.arrays import Float64N, Float64Nx3, Float64Nx3x3, Float64x3x3, Int64Array, UInt8Array
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import GeoreferenceError
from facadelake.core.geodesy import SiteOrigin
from facadelake.georeferencing.campaign.reference import MAX_POINTS, ReferencePoints, check_descriptor_count
from facadelake.sfm import Reconstruction, describe_tie_point_views

# A point with a larger sigma does not contribute to a placement to the centimetre.
MAX_SIGMA_M = 0.10
_VOXEL_M = 0.5
_MIN_PHOTOGRAPHS = 2


def build_reference(
    reconstruction: Reconstruction,
    descriptors: UInt8Array,
    *,
    cameras: Sequence[PosedCamera],
    xyz_site_m: Float64Nx3,
    covariance_m2: Float64Nx3x3,
    frame_covariance_m2: Float64x3x3,
    building_id: str,
    campaign_id: str,
    origin: SiteOrigin,
    max_points: int = MAX_POINTS,
) -> ReferencePoints:
    """The reference of a placed campaign: its best tie points, spread over the building.

    Args:
        reconstruction: the block.
        descriptors: SIFT descriptors (m, 128) of its tie points.
        cameras: the adjusted cameras, in the order of ``reconstruction.photos``.
        xyz_site_m: the adjusted tie points (m, 3); NaN where a point took no part in the adjustment.
        covariance_m2: their covariance (m, 3, 3) within the block.
        frame_covariance_m2: covariance (3, 3) of the campaign's position as a whole.
        building_id: the building.
        campaign_id: the campaign.
        origin: origin of the site frame.
        max_points: largest number of points.

    Returns:
        the reference.

    Raises:
        GeoreferenceError: no point has a sigma of 10 cm or less.
    """
    check_descriptor_count(reconstruction, descriptors)
    sigma_m = _compute_largest_sigma(covariance_m2)
    views = describe_tie_point_views(reconstruction, cameras, xyz_site_m)
    usable = np.isfinite(xyz_site_m).all(axis=1) & (views.photographs >= _MIN_PHOTOGRAPHS) & (sigma_m <= MAX_SIGMA_M)
    if not usable.any():
        raise GeoreferenceError(
            f"none of the {len(xyz_site_m)} tie points is known to {MAX_SIGMA_M:.2f} m, so this campaign cannot be "
            "the reference of later ones; photograph with more overlap, or nearer"
        )
    # Points in many photographs are recognised more reliably; among equals the more accurate one.
    quality = np.sqrt(views.photographs) / np.maximum(sigma_m, 1e-4)
    rows = np.flatnonzero(usable)
    rows = rows[choose_spread_points(xyz_site_m[rows], quality[rows], max_points=max_points)]
    return ReferencePoints(
        building_id=building_id,
        campaign_id=campaign_id,
        origin=origin,
        xyz_site_m=xyz_site_m[rows],
        covariance_m2=covariance_m2[rows],
        descriptors=descriptors[rows],
        direction_site=views.direction[rows],
        gsd_m=views.gsd[rows],
        photographs=views.photographs[rows],
        frame_covariance_m2=frame_covariance_m2,
    )


def choose_spread_points(xyz_m: Float64Nx3, quality: Float64N, *, max_points: int) -> Int64Array:
    """Rows (sorted) of at most ``max_points``: the best of each half-metre cell, then the second best, and so on."""
    if len(xyz_m) <= max_points:
        return np.arange(len(xyz_m))
    cell = np.unique(np.floor(xyz_m / _VOXEL_M).astype(np.int64), axis=0, return_inverse=True)[1].ravel()
    order = np.lexsort((-quality, cell))
    first_of_cell = np.r_[0, np.flatnonzero(np.diff(cell[order])) + 1]
    rank = np.arange(len(order)) - np.repeat(first_of_cell, np.diff(np.r_[first_of_cell, len(order)]))
    chosen: Int64Array = np.sort(order[np.lexsort((-quality[order], rank))[:max_points]])
    return chosen


def _compute_largest_sigma(covariance_m2: Float64Nx3x3) -> Float64N:
    """One sigma (m,) in the least accurate direction of each point; infinite where it is not known."""
    finite = np.isfinite(covariance_m2).all(axis=(1, 2))
    sigma = np.full(len(covariance_m2), np.inf)
    values = np.linalg.eigvalsh(covariance_m2[finite])
    sigma[finite] = np.where(values[:, 0] > 0, np.sqrt(np.maximum(values[:, 2], 0)), np.inf)
    return sigma
