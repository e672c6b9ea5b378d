"""Positions of defects, their covariances, and their distances from the model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Float64Nx3, Float64Nx3x3, RowIndices
from facadelake.deduplication.candidate_pairs import PositionNoise
from facadelake.deduplication.observations import ObservationArrays
from facadelake.deduplication.settings import MergeSettings
from facadelake.deduplication.triangulation import GroupRays, find_planes, triangulate_groups


@dataclass(frozen=True, kw_only=True, eq=False)
class DefectPositions:
    """Positions of g defects.

    ``xyz_site_m`` (g, 3); ``covariance_m2`` (g, 3, 3); ``normal_site`` (g, 3): normal of the surface; ``deviation_m``
    (g,): distance of the position from the model's surface, positive in front, ``deviation_sigma_m`` (g,) its one
    sigma; ``triangulated`` (g,): the rays determine the deviation better than the prior of the surface.
    """

    xyz_site_m: Float64Nx3
    covariance_m2: Float64Nx3x3
    normal_site: Float64Nx3
    deviation_m: Float64N
    deviation_sigma_m: Float64N
    triangulated: BoolArray


def compute_block_covariance(observations: ObservationArrays, rays: GroupRays, settings: MergeSettings) -> Float64Nx3x3:
    """Covariance (g, 3, 3) in m2 of the error that all observations of a group share: the block's, from its poses.

    The poses of a block are assumed to be fully correlated through its datum, so their covariance does not average out.
    They overestimate it where intrinsics compensate attitudes, so it is scaled down to ``settings.block_sigma_m`` where
    check points measured that.
    """
    mean = rays.sum_groups(observations.pose_covariance_m2[rays.rows]) / rays.count[:, None, None]
    mean_variance = np.einsum("gii->g", mean) / 3
    scale = np.divide(
        settings.block_sigma_m**2, mean_variance, out=np.full(len(mean_variance), np.inf), where=mean_variance > 0
    )
    shared: Float64Array = mean * np.minimum(scale, 1.0)[:, None, None]
    return shared


def estimate_positions(
    observations: ObservationArrays,
    group: RowIndices,
    noise: PositionNoise,
    settings: MergeSettings,
) -> DefectPositions:
    """Positions of groups of observations.

    The intersection of the rays is shifted by the campaign's own offset (``settings.offset_m``), which all rays share;
    the surface is correct to the relief. The distance of the intersection from the surface is distributed among the two
    by their variances: with GPS alone the surface dominates, otherwise the rays.

    Args:
        observations: the observations (n).
        group: group (n,) of each, from 0 without gaps.
        noise: noise of the rays.
        settings: offset and block sigma of the campaign.
    """
    if len(group) == 0:
        empty = np.zeros(0)
        return DefectPositions(
            xyz_site_m=empty.reshape(0, 3), covariance_m2=empty.reshape(0, 3, 3), normal_site=empty.reshape(0, 3),
            deviation_m=empty, deviation_sigma_m=empty, triangulated=np.zeros(0, dtype=bool),
        )  # fmt: skip
    order = np.argsort(group, kind="stable")
    rays = GroupRays(observations, order, group[order], noise)
    planes = find_planes(observations, rays)
    normal = planes.normal_site
    outer = normal[:, :, None] * normal[:, None, :]
    plane_variance = noise.relief_m**2 + settings.offset_m**2
    triangulated = triangulate_groups(rays, planes, plane_variance**0.5)
    gain = settings.offset_m**2 / plane_variance
    projection = np.eye(3)[None] - gain * outer
    offset = np.einsum("gi,gi->g", triangulated.xyz_site_m - planes.xyz_site_m, normal)
    xyz = triangulated.xyz_site_m - (gain * offset)[:, None] * normal
    covariance = projection @ triangulated.covariance_m2 @ projection + compute_block_covariance(
        observations, rays, settings
    )
    covariance += settings.offset_m**2 * (np.eye(3)[None] - gain * outer)
    single = rays.count == 1
    return DefectPositions(
        xyz_site_m=np.where(single[:, None], rays.hit_site_m[rays.starts], xyz),
        covariance_m2=(covariance + covariance.transpose(0, 2, 1)) / 2,
        normal_site=normal,
        deviation_m=(1 - gain) * offset,
        deviation_sigma_m=np.sqrt(np.einsum("gi,gij,gj->g", normal, covariance, normal)),
        triangulated=~single & (triangulated.normal_sigma_m**2 < plane_variance),
    )
