"""Reassignment of observations to a surface behind the first one that the model has on their rays.

The model may have a part that is elsewhere in reality, or a wall that is too thick. Two kinds of evidence show that a
defect is on a surface behind the first: the rays of one group intersect clearly there; or two groups of one class,
without a photograph in common, are separate on the first surface and coincide on one behind, which is unlikely for two
defects.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from facadelake.building.surface import MISS, Surface
from facadelake.core.arrays import Float64Array, Float64N, RowIndices
from facadelake.deduplication.average_linkage import label_groups
from facadelake.deduplication.candidate_pairs import (
    PositionNoise,
    compute_observation_covariance,
    find_pairs_in_gate,
    measure_pairs,
)
from facadelake.deduplication.clustering import Clustering
from facadelake.deduplication.observations import ObservationArrays, concatenate_observations
from facadelake.deduplication.settings import MergeSettings
from facadelake.deduplication.triangulation import GroupRays, SurfacePlanes, find_planes, triangulate_groups

_log = logging.getLogger(__name__)
_REAR_SURFACES = 3  # surfaces behind the first that are tested
_FAR_M = 1e4  # start of a ray after a miss, outside the scene
_RAY_OFFSET_M = 0.01  # start of the next ray behind a hit
_SEPARATION_SIGMAS = 3.0  # limit up to which relief explains the distance of rays from the surface
_MODEL_ERROR_COST = 9.0  # cost, in squared sigmas, of an error of the model: prior probability of one per cent
_COMBINED_OBSERVATIONS_MIN = 3  # of two groups together, for their coincidence to be significant
_DECIDED_GATES = 1.5  # in gates: closer groups on the first surface were decided there


@dataclass(frozen=True, kw_only=True, eq=False)
class ReassignedObservations:
    """Observations, some of which are moved to a rear surface.

    ``rows`` (m,): those that are moved; ``element`` (m,): rows of table ``elements`` that they are on.
    """

    observations: ObservationArrays
    rows: RowIndices
    element: RowIndices


@dataclass(frozen=True, kw_only=True, eq=False)
class _RearSurfaces:
    """What the rays of k observations hit behind their first surface, l = ``_REAR_SURFACES`` each.

    ``behind_m`` (k, l): distance behind the first hit, inf for a miss; ``xyz_site_m`` and ``normal_site`` (k, l, 3);
    ``element`` (k, l).
    """

    behind_m: Float64Array
    xyz_site_m: Float64Array
    normal_site: Float64Array
    element: RowIndices


def reassign_to_rear_surface(
    observations: ObservationArrays, clustering: Clustering, settings: MergeSettings, surface: Surface
) -> ReassignedObservations | None:
    """Move observations whose defect is on a surface behind the model's first one.

    Args:
        observations: the observations (n).
        clustering: their groups, on the first surface.
        settings: gate and offset of the campaign.
        surface: the building's surface.

    Returns:
        The observations, some of them moved; None where none is.
    """
    if settings.offset_m > 0 or len(observations) == 0:
        return None  # with an offset of the campaign, rays do not determine the depth
    # Parts of a defect that a seam or an occluder cut have no ray through its centre.
    parts = np.bincount(clustering.unit)[clustering.unit] > 1
    is_cut = np.zeros(int(clustering.group.max()) + 1, dtype=bool)
    is_cut[clustering.group[parts]] = True
    usable = np.flatnonzero(~is_cut[clustering.group])
    usable = usable[np.argsort(clustering.group[usable], kind="stable")]
    if len(usable) == 0:
        return None
    group, noise = label_groups(clustering.group[usable]), clustering.noise
    rays = GroupRays(observations, usable, group, noise)
    planes = find_planes(observations, rays)
    first = rays.rows[rays.find_nearest(rays.compute_medians())]
    surfaces = _cast_rear_surfaces(observations, first, surface)
    crossing = _find_crossing_depth(observations, rays, planes, surfaces, noise)
    meeting = _find_meeting_depth(observations, rays, planes, surfaces, first, noise, settings)
    depth = np.where(np.isfinite(crossing), crossing, meeting)[group]
    rows, depth = usable[np.isfinite(depth)], depth[np.isfinite(depth)]
    if len(rows) == 0:
        return None
    observation_surfaces = _cast_rear_surfaces(observations, rows, surface)
    nearest = np.argmin(np.abs(observation_surfaces.behind_m - depth[:, None]), axis=1)
    kept = np.flatnonzero(np.isfinite(observation_surfaces.behind_m[np.arange(len(rows)), nearest]))
    _log.info("reassigned %d observations to a surface behind the model's first", len(kept))
    return _move_observations(observations, rows[kept], _select_surfaces(observation_surfaces, kept, nearest[kept]))


def _find_crossing_depth(
    observations: ObservationArrays,
    rays: GroupRays,
    planes: SurfacePlanes,
    surfaces: _RearSurfaces,
    noise: PositionNoise,
) -> Float64N:
    """Depth behind the first surface at which the rays of a group intersect on another one.

    Args:
        observations: the observations (n).
        rays: their rays by group (g).
        planes: the first surface at each group.
        surfaces: the surfaces (g, l) behind it.
        noise: noise of the rays.

    Returns:
        Depth (g,) in m; NaN where the rays intersect on none.
    """
    constrained = triangulate_groups(rays, planes, noise.relief_m)
    deviation = np.einsum("gi,gi->g", constrained.xyz_site_m - planes.xyz_site_m, planes.normal_site)
    out = np.full(len(deviation), np.nan)
    suspects = np.flatnonzero((rays.count >= 2) & (deviation < -_SEPARATION_SIGMAS * noise.relief_m))
    if len(suspects) == 0:
        return out
    rows = np.flatnonzero(np.isin(rays.group, suspects))
    suspect_rays = GroupRays(observations, rays.rows[rows], np.searchsorted(suspects, rays.group[rows]), noise)
    depth, cost_limit = out[suspects], constrained.cost[suspects] - _MODEL_ERROR_COST
    for number in range(_REAR_SURFACES):
        is_hit = np.isfinite(surfaces.behind_m[suspects, number])
        plane = SurfacePlanes(
            xyz_site_m=np.where(is_hit[:, None], surfaces.xyz_site_m[suspects, number], planes.xyz_site_m[suspects]),
            normal_site=np.where(is_hit[:, None], surfaces.normal_site[suspects, number], planes.normal_site[suspects]),
        )
        found = triangulate_groups(suspect_rays, plane, noise.relief_m)
        deviation = np.einsum("gi,gi->g", found.xyz_site_m - plane.xyz_site_m, plane.normal_site)
        better = is_hit & (found.cost < cost_limit) & (np.abs(deviation) < _SEPARATION_SIGMAS * noise.relief_m)
        depth = np.where(better, surfaces.behind_m[suspects, number], depth)
        cost_limit = np.where(better, found.cost, cost_limit)
    out[suspects] = depth
    return out


def _find_meeting_depth(
    observations: ObservationArrays,
    rays: GroupRays,
    planes: SurfacePlanes,
    surfaces: _RearSurfaces,
    first: RowIndices,
    noise: PositionNoise,
    settings: MergeSettings,
) -> Float64N:
    """Depth behind the first surface at which a group coincides with another one.

    Args:
        observations: the observations (n).
        rays: their rays by group (g).
        planes: the first surface at each group.
        surfaces: the surfaces (g, l) behind it.
        first: row (g,) of the observation that gives the first surface.
        noise: noise of the rays.
        settings: gate and ceiling.

    Returns:
        Depth (g,) in m; NaN where the group coincides with none.
    """
    free = triangulate_groups(rays, planes, 10.0)
    deviation = np.einsum("gi,gi->g", free.xyz_site_m - planes.xyz_site_m, planes.normal_site)
    depth = np.einsum("gli,gi->gl", surfaces.xyz_site_m - planes.xyz_site_m[:, None], planes.normal_site)
    tolerance = _SEPARATION_SIGMAS * np.hypot(free.normal_sigma_m, noise.relief_m)
    with np.errstate(invalid="ignore"):
        allowed = np.isfinite(surfaces.behind_m) & (
            (rays.count < 2)[:, None] | (np.abs(depth - deviation[:, None]) <= tolerance[:, None])
        )
    owner, layer = np.nonzero(allowed)
    out = np.full(len(first), np.nan)
    if len(owner) == 0:
        return out
    # Each group on its first surface, and on every possible one behind it.
    front = observations.take(first)
    rear = _move_observations(
        observations.take(first[owner]), np.arange(len(owner)), _select_surfaces(surfaces, owner, layer)
    ).observations
    candidates = concatenate_observations([front, rear])
    group = np.r_[np.arange(len(first)), owner]
    behind = np.r_[np.zeros(len(first)), surfaces.behind_m[owner, layer]]
    near = cKDTree(candidates.xyz_site_m).query_pairs(settings.ceiling_m, output_type="ndarray")
    near = near[(group[near[:, 0]] != group[near[:, 1]]) & (behind[near].max(axis=1) > 0)]
    near = near[candidates.defect_class[near[:, 0]] == candidates.defect_class[near[:, 1]]]
    pairs = measure_pairs(candidates, near, compute_observation_covariance(candidates, noise), noise, settings)
    at_first = measure_pairs(front, group[near], compute_observation_covariance(front, noise), noise, settings)
    coincident = find_pairs_in_gate(pairs, settings)
    coincident &= at_first.sigmas > _DECIDED_GATES * settings.gate_sigma
    near, sigmas = near[coincident], pairs.sigmas[coincident]
    ends = near.ravel()
    support = rays.count[group] + np.bincount(
        ends, weights=rays.count[group[near[:, ::-1].ravel()]], minlength=len(group)
    )
    significant = support[near].max(axis=1) >= _COMBINED_OBSERVATIONS_MIN
    near = near[significant][np.argsort(sigmas[significant], kind="stable")]
    photos = {
        number: set(observations.photo[rays.rows[rays.starts[number] :][: rays.count[number]]].tolist())
        for number in np.unique(group[near]).tolist()
    }
    for a, b in near.tolist():
        one, other = int(group[a]), int(group[b])
        is_decided = any(np.isfinite(out[group[c]]) and out[group[c]] != behind[c] for c in (a, b))
        if is_decided or photos[one] & photos[other]:
            continue
        both_photos = photos[one] | photos[other]
        for member in (a, b):
            photos[int(group[member])] = both_photos
            if behind[member] > 0:
                out[group[member]] = behind[member]
    return out


def _cast_rear_surfaces(observations: ObservationArrays, rows: RowIndices, surface: Surface) -> _RearSurfaces:
    """The surfaces behind the hits of ``rows`` (k,), along their rays."""
    shape = (len(rows), _REAR_SURFACES)
    distance, element = np.full(shape, np.inf), np.full(shape, MISS, dtype=np.int64)
    xyz, normal = np.full((*shape, 3), np.nan), np.full((*shape, 3), np.nan)
    ray, start = observations.ray_site[rows], observations.xyz_site_m[rows]
    travelled = np.zeros(len(rows))
    for number in range(_REAR_SURFACES):
        hits = surface.cast(start + _RAY_OFFSET_M * ray, ray)
        travelled = travelled + hits.distance_m + _RAY_OFFSET_M
        distance[:, number], xyz[:, number] = travelled, hits.xyz_site_m
        normal[:, number], element[:, number] = hits.normal_site, hits.element
        start = np.where(hits.hit[:, None], hits.xyz_site_m, start + _FAR_M * ray)
    return _RearSurfaces(behind_m=distance, xyz_site_m=xyz, normal_site=normal, element=element)


def _select_surfaces(surfaces: _RearSurfaces, rows: RowIndices, layer: RowIndices) -> _RearSurfaces:
    """The surface ``layer`` (k,) of each of ``rows`` (k,)."""
    return _RearSurfaces(
        behind_m=surfaces.behind_m[rows, layer],
        xyz_site_m=surfaces.xyz_site_m[rows, layer],
        normal_site=surfaces.normal_site[rows, layer],
        element=surfaces.element[rows, layer],
    )


def _move_observations(
    observations: ObservationArrays, rows: RowIndices, rear: _RearSurfaces
) -> ReassignedObservations:
    """The observations with ``rows`` (k,) on the rear surfaces ``rear`` (k,); extents grow with the distance."""
    values = {
        name: getattr(observations, name).copy()
        for name in ("xyz_site_m", "normal_site", "distance_m", "width_m", "height_m", "gsd_m")
    }
    scale = 1 + rear.behind_m / observations.distance_m[rows]
    values["xyz_site_m"][rows], values["normal_site"][rows] = rear.xyz_site_m, rear.normal_site
    for name in ("distance_m", "width_m", "height_m", "gsd_m"):
        values[name][rows] *= scale
    return ReassignedObservations(observations=replace(observations, **values), rows=rows, element=rear.element)
