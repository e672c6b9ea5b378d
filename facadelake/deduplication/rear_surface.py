"""Sightings that look past what the model has in the way: a part that stands elsewhere, or a wall drawn too thick.

Each ray meets the model where the model has its first surface. Two kinds of evidence say that a defect is shown on a
surface behind it: the rays of one group cross clearly there; or two groups of one class, in photographs that have none
in common, part on the first surface and meet on one behind, which two defects would do by a rare chance alone.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.spatial import cKDTree

from facadelake.building.surface import MISS, Surface
from facadelake.core.arrays import Float64Array, RowIndices
from facadelake.deduplication.clustering import Clustering
from facadelake.deduplication.linkage import label_groups
from facadelake.deduplication.observations import ObservationArrays
from facadelake.deduplication.pairs import PositionNoise, compute_observation_covariance, measure_pairs
from facadelake.deduplication.settings import MergeSettings
from facadelake.deduplication.triangulation import GroupRays, SurfacePlanes, find_planes, triangulate_groups

_log = logging.getLogger(__name__)
_REAR_SURFACES = 3  # surfaces behind the first that are looked at
_FAR_M = 1e4  # a ray that met nothing goes on out of the scene
_RAY_OFFSET_M = 0.01  # so far behind a surface the ray goes on
_SEPARATION_SIGMAS = 3.0  # rays and surface that disagree by less are left to the relief
_MODEL_ERROR_COST = 9.0  # what it costs, in squared sigmas, that the model is wrong here: one part in a hundred
_COMBINED_OBSERVATIONS_MIN = 3  # sightings that two groups have together, to be believed that they meet behind
_DECIDED_GATES = 1.5  # gates: groups that are no further apart on the first surface were decided there


@dataclass(frozen=True, kw_only=True, eq=False)
class ReassignedObservations:
    """``observations`` with ``rows`` (m,) moved to what they look at behind, on ``element`` (m,) rows of the building."""

    observations: ObservationArrays
    rows: RowIndices
    element: RowIndices


@dataclass(frozen=True, kw_only=True, eq=False)
class _RearSurfaces:
    """What the rays of k sightings meet behind their hits, ``_REAR_SURFACES`` each: how far behind (k, l), place, normal
    (k, l, 3) and element (k, l); a miss is infinitely far."""

    behind_m: Float64Array
    xyz_site_m: Float64Array
    normal_site: Float64Array
    element: RowIndices


def reassign_to_rear_surface(
    sightings: ObservationArrays, grouping: Clustering, settings: MergeSettings, surface: Surface
) -> ReassignedObservations | None:
    """The ``observations`` with those moved that look past the model's first surface; None where none do."""
    if settings.offset_m > 0 or len(sightings) == 0:
        return None  # rays of a block that may itself stand off tell no depth
    # Parts of a defect that a seam cut have no ray through its middle.
    parts = np.bincount(grouping.unit)[grouping.unit] > 1
    cut = np.zeros(int(grouping.group.max()) + 1, dtype=bool)
    cut[grouping.group[parts]] = True
    usable = np.flatnonzero(~cut[grouping.group])
    usable = usable[np.argsort(grouping.group[usable], kind="stable")]
    if len(usable) == 0:
        return None
    group, noise = label_groups(grouping.group[usable]), grouping.noise
    rays = GroupRays(sightings, usable, group, noise)
    planes = find_planes(sightings, rays)
    first = rays.rows[rays.find_nearest(rays.compute_medians())]
    layers = _cast_rear_surfaces(sightings, first, surface)
    crossing = _find_crossing_depth(sightings, rays, planes, layers, noise)
    meeting = _find_meeting_depth(sightings, rays, planes, layers, first, noise, settings)
    depth = np.where(np.isfinite(crossing), crossing, meeting)[group]
    rows, depth = usable[np.isfinite(depth)], depth[np.isfinite(depth)]
    if len(rows) == 0:
        return None
    own = _cast_rear_surfaces(sightings, rows, surface)
    nearest = np.argmin(np.abs(own.behind_m - depth[:, None]), axis=1)
    kept = np.flatnonzero(np.isfinite(own.behind_m[np.arange(len(rows)), nearest]))
    _log.info("%d sightings look past the model's first surface", len(kept))
    return _move_observations(sightings, rows[kept], _select_surfaces(own, kept, nearest[kept]))


def _find_crossing_depth(
    sightings: ObservationArrays, rays: GroupRays, planes: SurfacePlanes, layers: _RearSurfaces, noise: PositionNoise
) -> Float64Array:
    """How far (g,) behind their first surface the rays of each group cross at another; NaN where they do not."""
    held = triangulate_groups(rays, planes, noise.relief_m)
    off = np.einsum("gi,gi->g", held.xyz_site_m - planes.xyz_site_m, planes.normal_site)
    out = np.full(len(off), np.nan)
    suspects = np.flatnonzero((rays.count >= 2) & (off < -_SEPARATION_SIGMAS * noise.relief_m))
    if len(suspects) == 0:
        return out
    rows = np.flatnonzero(np.isin(rays.group, suspects))
    own = GroupRays(sightings, rays.rows[rows], np.searchsorted(suspects, rays.group[rows]), noise)
    depth, least = out[suspects], held.cost[suspects] - _MODEL_ERROR_COST
    for number in range(_REAR_SURFACES):
        met = np.isfinite(layers.behind_m[suspects, number])
        plane = SurfacePlanes(
            xyz_site_m=np.where(met[:, None], layers.xyz_site_m[suspects, number], planes.xyz_site_m[suspects]),
            normal_site=np.where(met[:, None], layers.normal_site[suspects, number], planes.normal_site[suspects]),
        )
        found = triangulate_groups(own, plane, noise.relief_m)
        off = np.einsum("gi,gi->g", found.xyz_site_m - plane.xyz_site_m, plane.normal_site)
        better = met & (found.cost < least) & (np.abs(off) < _SEPARATION_SIGMAS * noise.relief_m)
        depth = np.where(better, layers.behind_m[suspects, number], depth)
        least = np.where(better, found.cost, least)
    out[suspects] = depth
    return out


def _find_meeting_depth(
    sightings: ObservationArrays,
    rays: GroupRays,
    planes: SurfacePlanes,
    layers: _RearSurfaces,
    first: RowIndices,
    noise: PositionNoise,
    settings: MergeSettings,
) -> Float64Array:
    """How far (g,) behind its first surface each group meets another; NaN where it meets none."""
    free = triangulate_groups(rays, planes, 10.0)
    off = np.einsum("gi,gi->g", free.xyz_site_m - planes.xyz_site_m, planes.normal_site)
    depth = np.einsum("gli,gi->gl", layers.xyz_site_m - planes.xyz_site_m[:, None], planes.normal_site)
    slack = _SEPARATION_SIGMAS * np.hypot(free.normal_sigma_m, noise.relief_m)
    with np.errstate(invalid="ignore"):
        allowed = np.isfinite(layers.behind_m) & (
            (rays.count < 2)[:, None] | (np.abs(depth - off[:, None]) <= slack[:, None])
        )
    owner, layer = np.nonzero(allowed)
    out = np.full(len(first), np.nan)
    if len(owner) == 0:
        return out
    # Each group where it is, and wherever behind it may be.
    here = _select_observations(sightings, first)
    there = _move_observations(
        _select_observations(sightings, first[owner]), np.arange(len(owner)), _select_surfaces(layers, owner, layer)
    ).observations
    whole = concatenate_observations(here, there)
    group = np.r_[np.arange(len(first)), owner]
    behind = np.r_[np.zeros(len(first)), layers.behind_m[owner, layer]]
    near = cKDTree(whole.xyz_site_m).query_pairs(settings.ceiling_m, output_type="ndarray")
    near = near[(group[near[:, 0]] != group[near[:, 1]]) & (behind[near].max(axis=1) > 0)]
    near = near[whole.defect_class[near[:, 0]] == whole.defect_class[near[:, 1]]]
    pairs = measure_pairs(whole, near, compute_observation_covariance(whole, noise), noise, settings)
    at_first = measure_pairs(here, group[near], compute_observation_covariance(here, noise), noise, settings)
    met = (pairs.sigmas <= settings.gate_sigma) & pairs.touching
    met &= at_first.sigmas > _DECIDED_GATES * settings.gate_sigma
    near, sigmas = near[met], pairs.sigmas[met]
    ends = near.ravel()
    support = rays.count[group] + np.bincount(
        ends, weights=rays.count[group[near[:, ::-1].ravel()]], minlength=len(group)
    )
    strong = support[near].max(axis=1) >= _COMBINED_OBSERVATIONS_MIN
    near = near[strong][np.argsort(sigmas[strong], kind="stable")]
    photos = {
        number: set(sightings.photo[rays.rows[rays.starts[number] :][: rays.count[number]]].tolist())
        for number in np.unique(group[near]).tolist()
    }
    for a, b in near.tolist():
        one, other = int(group[a]), int(group[b])
        settled = any(np.isfinite(out[group[c]]) and out[group[c]] != behind[c] for c in (a, b))
        if settled or photos[one] & photos[other]:
            continue
        together = photos[one] | photos[other]
        for member in (a, b):
            photos[int(group[member])] = together
            if behind[member] > 0:
                out[group[member]] = behind[member]
    return out


def _cast_rear_surfaces(sightings: ObservationArrays, rows: RowIndices, surface: Surface) -> _RearSurfaces:
    """What lies behind the hits of ``rows`` (k,)."""
    shape = (len(rows), _REAR_SURFACES)
    distance, element = np.full(shape, np.inf), np.full(shape, MISS, dtype=np.int64)
    xyz, normal = np.full((*shape, 3), np.nan), np.full((*shape, 3), np.nan)
    ray, start = sightings.ray_site[rows], sightings.xyz_site_m[rows]
    gone = np.zeros(len(rows))
    for number in range(_REAR_SURFACES):
        hits = surface.cast(start + _RAY_OFFSET_M * ray, ray)
        gone = gone + hits.distance_m + _RAY_OFFSET_M
        distance[:, number], xyz[:, number] = gone, hits.xyz_site_m
        normal[:, number], element[:, number] = hits.normal_site, hits.element
        start = np.where(hits.hit[:, None], hits.xyz_site_m, start + _FAR_M * ray)
    return _RearSurfaces(behind_m=distance, xyz_site_m=xyz, normal_site=normal, element=element)


def _select_surfaces(layers: _RearSurfaces, rows: RowIndices, layer: RowIndices) -> _RearSurfaces:
    """One ``layer`` (k,) of each of ``rows`` (k,)."""
    return _RearSurfaces(
        behind_m=layers.behind_m[rows, layer],
        xyz_site_m=layers.xyz_site_m[rows, layer],
        normal_site=layers.normal_site[rows, layer],
        element=layers.element[rows, layer],
    )


def _move_observations(sightings: ObservationArrays, rows: RowIndices, layer: _RearSurfaces) -> ReassignedObservations:
    """The sightings with ``rows`` where their rays meet the layer chosen for each; extents grow with the distance."""
    values = {
        name: getattr(sightings, name).copy()
        for name in ("xyz_site_m", "normal_site", "distance_m", "width_m", "height_m", "gsd_m")
    }
    grown = 1 + layer.behind_m / sightings.distance_m[rows]
    values["xyz_site_m"][rows], values["normal_site"][rows] = layer.xyz_site_m, layer.normal_site
    for name in ("distance_m", "width_m", "height_m", "gsd_m"):
        values[name][rows] *= grown
    return ReassignedObservations(observations=replace(sightings, **values), rows=rows, element=layer.element)


def _select_observations(sightings: ObservationArrays, rows: RowIndices) -> ObservationArrays:
    return ObservationArrays(
        **{field.name: getattr(sightings, field.name)[rows] for field in fields(ObservationArrays)}
    )


def concatenate_observations(a: ObservationArrays, b: ObservationArrays) -> ObservationArrays:
    """Sightings one after the other."""
    return ObservationArrays(
        **{
            field.name: np.concatenate([getattr(a, field.name), getattr(b, field.name)])
            for field in fields(ObservationArrays)
        }
    )
