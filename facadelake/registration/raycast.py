"""Detections of localised photographs, cast onto the surface, and the patches that they form there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facadelake.building.surface import Hits, Surface
from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Float64Nx3, RowIndices
from facadelake.core.camera import PosedCamera
from facadelake.registration.centre import find_box_centres, find_mask_centre
from facadelake.registration.continuity import find_patch_members, select_main_side
from facadelake.registration.outline import Outlines, sample_outlines
from facadelake.registration.patch import (
    COSINE_MIN,
    find_nearest_member,
    intersect_planes,
    map_outlines,
    measure_extents,
)
from facadelake.registration.rays import PixelRays, compute_pixel_rays
from facadelake.registration.settings import RegistrationSettings

Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class Patches:
    """Patches of n detections; NaN or None where no ray hit the building.

    ``member`` (k,): which of the outlines' samples belong to the patch. ``ray``: the n rays of the positions
    ``xyz_site_m`` (n, 3), at ``distance_m`` (n,) from the camera, where the surface has the unit normal ``normal_site``
    (n, 3). ``polygon_site`` (n,): outlines in 3D, in site. ``width_m`` (n,): extent along the horizontal tangent,
    ``height_m`` (n,) along the upward one, ``length_m`` (n,) the largest; ``area_m2`` (n,). ``target_share`` (n,):
    share of the samples whose rays hit the building.
    """

    member: BoolArray
    xyz_site_m: Float64Nx3
    normal_site: Float64Nx3
    ray: PixelRays
    distance_m: Float64N
    polygon_site: NDArray[Any]
    width_m: Float64N
    height_m: Float64N
    length_m: Float64N
    area_m2: Float64N
    target_share: Float64N

    @property
    def incidence_deg(self) -> Float64N:
        """Angle (n,) between the rays of the positions and the normals of the surface."""
        cosine = np.clip(-np.einsum("ij,ij->i", self.ray.direction_site, self.normal_site), 0.0, 1.0)
        angle: Float64Array = np.degrees(np.arccos(cosine))
        return angle


@dataclass(frozen=True, kw_only=True, eq=False)
class RaycastBatch:
    """A batch of n detections on the surface.

    ``detections`` (n): rows of table ``detections``, all on localised photographs. ``cameras``: the photographs'
    cameras; ``camera_index`` (n,): each detection's. ``outlines`` (n) with samples (k); ``rays`` and ``hits`` (k) of
    the samples; ``patches`` (n).
    """

    detections: Sequence[Row]
    cameras: list[PosedCamera]
    camera_index: RowIndices
    outlines: Outlines
    rays: PixelRays
    hits: Hits
    patches: Patches


def cast_detections(
    detections: Sequence[Row], posed: Mapping[str, PosedCamera], surface: Surface, settings: RegistrationSettings
) -> RaycastBatch:
    """Cast the rays of accepted detections onto the surface.

    Args:
        detections: rows of table ``detections``, all on localised photographs.
        posed: cameras of the localised photographs by photo_id.
        surface: the building's surface.
        settings: sampling, near clipping distance and continuity limit.
    """
    names = sorted({row["photo_id"] for row in detections})
    cameras = [posed[name] for name in names]
    index_by_photo = {name: i for i, name in enumerate(names)}
    camera_index = np.array([index_by_photo[row["photo_id"]] for row in detections], dtype=np.int64)
    outlines = sample_outlines(detections, settings.rays_per_side)
    rays = compute_pixel_rays(cameras, camera_index[outlines.detection], outlines.xy_img)
    clipped_hits = surface.cast(rays.origin_site_m + settings.near_m * rays.direction_site, rays.direction_site)
    hits = replace(clipped_hits, distance_m=clipped_hits.distance_m + settings.near_m)
    patches = compute_patches(outlines, hits, rays, cameras, camera_index, settings.step_m)
    return RaycastBatch(
        detections=detections,
        cameras=cameras,
        camera_index=camera_index,
        outlines=outlines,
        rays=rays,
        hits=hits,
        patches=patches,
    )


def compute_patches(
    outlines: Outlines,
    hits: Hits,
    rays: PixelRays,
    cameras: list[PosedCamera],
    camera_index: RowIndices,
    step_m: float,
) -> Patches:
    """Patches of detections from the hits of their samples.

    Args:
        outlines: the outlines (n) with their samples (k).
        hits: hits of the samples (k).
        rays: rays of the samples (k).
        cameras: cameras of the photographs.
        camera_index: the camera (n,) of each detection, in ``cameras``.
        step_m: continuity limit, as in ``find_patch_members``.
    """
    count, owner = len(outlines), outlines.detection
    member = find_patch_members(outlines, hits, step_m)
    sample_count = np.bincount(owner, minlength=count)
    cosine = np.maximum(-np.einsum("ij,ij->i", rays.direction_site, hits.normal_site), COSINE_MIN)
    pixel_m2 = np.where(member, hits.distance_m**2 * rays.solid_angle_sr / cosine, 0.0)
    area = np.bincount(owner, weights=pixel_m2, minlength=count) * outlines.area_px2 / sample_count
    target_share = np.bincount(owner, weights=hits.hit, minlength=count) / sample_count

    members = np.flatnonzero(member)
    with_member, first = np.unique(owner[members], return_index=True)
    first_member = np.full(count, -1, dtype=np.int64)
    first_member[with_member] = members[first]
    found = first_member >= 0
    polygons = np.full(count, None, dtype=object)
    centre = outlines.centre_img.copy()
    if found.any():
        mapped = map_outlines(outlines, hits, member, first_member, cameras, camera_index)
        polygons[found] = mapped.polygon_site
        for row in np.flatnonzero(found & outlines.has_mask):
            centre[row] = find_mask_centre(
                outlines, hits, pixel_m2, int(row), polygons[row], cameras[camera_index[row]]
            )
        boxes = np.flatnonzero(found & ~outlines.has_mask)
        centre[boxes] = find_box_centres(outlines, hits.distance_m * rays.forward_cosine, member, boxes)
    anchor = find_nearest_member(outlines, select_main_side(outlines, hits, member), np.arange(count), centre)
    ray = compute_pixel_rays(cameras, camera_index, centre)
    xyz, normal = np.full((count, 3), np.nan), np.full((count, 3), np.nan)
    xyz[found] = intersect_planes(ray.origin_site_m[found], ray.direction_site[found], hits, anchor[found])
    normal[found] = hits.normal_site[anchor[found]]
    extent = np.full((count, 3), np.nan)
    if found.any():
        extent[found] = measure_extents(mapped.vertex_site_m, mapped.patch_of_vertex, xyz[found], normal[found])
    return Patches(
        member=member,
        xyz_site_m=xyz,
        normal_site=normal,
        ray=ray,
        distance_m=np.linalg.norm(xyz - ray.origin_site_m, axis=1),
        polygon_site=polygons,
        width_m=extent[:, 0],
        height_m=extent[:, 1],
        length_m=extent[:, 2],
        area_m2=np.where(found, area, np.nan),
        target_share=target_share,
    )
