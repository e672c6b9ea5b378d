"""Where each defect is, how well that is known, and how far it stands off the model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array, RowIndices
from facadelake.deduplication.observations import ObservationArrays
from facadelake.deduplication.pairs import PositionNoise
from facadelake.deduplication.settings import MergeSettings
from facadelake.deduplication.triangulation import GroupRays, SurfacePlanes, find_planes, triangulate_groups


@dataclass(frozen=True, kw_only=True, eq=False)
class DefectPositions:
    """Places of g defects: ``xyz_site_m`` (g, 3), ``covariance_m2`` (g, 3, 3), the surface's ``normal_site`` (g, 3).

    ``deviation_m`` (g,): how far the place stands before (+) the model's surface, ``deviation_sigma_m`` (g,) one sigma
    of that; ``triangulated`` (g,): whether the rays say so themselves, more than the surface.
    """

    xyz_site_m: Float64Array
    covariance_m2: Float64Array
    normal_site: Float64Array
    deviation_m: Float64Array
    deviation_sigma_m: Float64Array
    triangulated: BoolArray


def compute_block_covariance(sightings: ObservationArrays, rays: GroupRays, settings: MergeSettings) -> Float64Array:
    """Covariance (g, 3, 3) in m2 of what moves all sightings of a group alike: the block, by its poses' covariances.

    The poses of a block are taken to err together, as its datum makes them: what they state does not average out.
    They overstate it where intrinsics make up for attitudes, so it is scaled down to ``block_sigma_m``, where that was
    measured at points.
    """
    mean = rays.sum_groups(sightings.pose_covariance_m2[rays.rows]) / rays.count[:, None, None]
    axis = np.einsum("gii->g", mean) / 3
    bound = np.divide(settings.block_sigma_m**2, axis, out=np.full(len(axis), np.inf), where=axis > 0)
    shared: Float64Array = mean * np.minimum(bound, 1.0)[:, None, None]
    return shared


def estimate_positions(
    sightings: ObservationArrays,
    group: RowIndices,
    noise: PositionNoise,
    settings: MergeSettings,
    planes: SurfacePlanes | None = None,
) -> DefectPositions:
    """The places of groups 0, 1, ... of the sightings, ``group`` (n,), on ``planes`` or where their rays met the model.

    The rays cross at the place moved by the campaign's own offset (``offset_m``), which they share; the surface lies
    where it is to the relief. So what the crossing stands off the surface is shared out between the two by their
    variances: under GPS alone the surface is the better word, else the rays are.
    """
    if len(group) == 0:
        none = np.zeros(0)
        return DefectPositions(
            xyz_site_m=none.reshape(0, 3), covariance_m2=none.reshape(0, 3, 3), normal_site=none.reshape(0, 3),
            deviation_m=none, deviation_sigma_m=none, triangulated=np.zeros(0, dtype=bool),
        )  # fmt: skip
    order = np.argsort(group, kind="stable")
    rays = GroupRays(sightings, order, group[order], noise)
    if planes is None:
        planes = find_planes(sightings, rays)
    normal = planes.normal_site
    outer = normal[:, :, None] * normal[:, None, :]
    hold = noise.relief_m**2 + settings.offset_m**2
    found = triangulate_groups(rays, planes, hold**0.5)
    gain = settings.offset_m**2 / hold
    back = np.eye(3)[None] - gain * outer
    off = np.einsum("gi,gi->g", found.xyz_site_m - planes.xyz_site_m, normal)
    xyz = found.xyz_site_m - (gain * off)[:, None] * normal
    covariance = back @ found.covariance_m2 @ back + compute_block_covariance(sightings, rays, settings)
    covariance += settings.offset_m**2 * (np.eye(3)[None] - gain * outer)
    single = rays.count == 1
    return DefectPositions(
        xyz_site_m=np.where(single[:, None], rays.hit_site_m[rays.starts], xyz),
        covariance_m2=(covariance + covariance.transpose(0, 2, 1)) / 2,
        normal_site=normal,
        deviation_m=(1 - gain) * off,
        deviation_sigma_m=np.sqrt(np.einsum("gi,gij,gj->g", normal, covariance, normal)),
        triangulated=~single & (found.normal_sigma_m**2 < hold),
    )
