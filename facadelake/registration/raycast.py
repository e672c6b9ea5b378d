"""Detections of localised photographs, cast onto the building's surface, and the patches that they make there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facadelake.building.surface import Hits, Surface
from facadelake.core.arrays import BoolArray, Float64Array, Int64Array
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
    """Patches of n detections; NaN or None where no ray met the building.

    ``member`` (k,): which of the outlines' pixels belong to the patch. ``ray``: the n rays of the positions
    ``xyz_site_m`` (n, 3), at ``distance_m`` (n,) from the camera, where the surface has ``normal_site`` (n, 3).
    ``polygon_site`` (n,): 3D outlines in site. ``width_m`` (n,) along the horizontal tangent, ``height_m`` across it,
    ``length_m`` the longest extent, ``area_m2``. ``target_share`` (n,): rays that met the building.
    """

    member: BoolArray
    xyz_site_m: Float64Array
    normal_site: Float64Array
    ray: PixelRays
    distance_m: Float64Array
    polygon_site: NDArray[Any]
    width_m: Float64Array
    height_m: Float64Array
    length_m: Float64Array
    area_m2: Float64Array
    target_share: Float64Array

    @property
    def incidence_deg(self) -> Float64Array:
        """Angle (n,) between the positions' rays and the surface's normals."""
        cosine = np.clip(-np.einsum("ij,ij->i", self.ray.direction_site, self.normal_site), 0.0, 1.0)
        angle: Float64Array = np.degrees(np.arccos(cosine))
        return angle


@dataclass(frozen=True, kw_only=True, eq=False)
class RaycastBatch:
    """Detections of localised photographs on the surface: rows of table ``detections`` (n), the photographs' cameras,
    ``camera_index`` (n,) in them, the pixels of their outlines (k), these pixels' rays and hits, and the patches (n)."""

    detections: Sequence[Row]
    cameras: list[PosedCamera]
    camera_index: Int64Array
    outlines: Outlines
    rays: PixelRays
    hits: Hits
    patches: Patches


def cast_detections(
    detections: Sequence[Row], posed: Mapping[str, PosedCamera], surface: Surface, settings: RegistrationSettings
) -> RaycastBatch:
    """The rays of accepted ``detections`` on localised photographs, and the patches they make."""
    names = sorted({row["photo_id"] for row in detections})
    cameras = [posed[name] for name in names]
    number = {name: i for i, name in enumerate(names)}
    camera_of = np.array([number[row["photo_id"]] for row in detections], dtype=np.int64)
    outlines = sample_outlines(detections, settings.rays_per_side)
    rays = compute_pixel_rays(cameras, camera_of[outlines.detection], outlines.xy_img)
    seen = surface.cast(rays.origin_site_m + settings.near_m * rays.direction_site, rays.direction_site)
    hits = replace(seen, distance_m=seen.distance_m + settings.near_m)
    patches = compute_patches(outlines, hits, rays, cameras, camera_of, settings.step_m)
    return RaycastBatch(
        detections=detections,
        cameras=cameras,
        camera_index=camera_of,
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
    camera_of: Int64Array,
    step_m: float,
) -> Patches:
    """Patches of ``outlines`` (n), whose pixels' ``rays`` met the surface at ``hits``.

    ``camera_index`` (n,): the outlines' cameras in ``cameras``. ``step_m`` as in ``find_patch_members``.
    """
    count, owner = len(outlines), outlines.detection
    member = find_patch_members(outlines, hits, step_m)
    sampled = np.bincount(owner, minlength=count)
    cosine = np.maximum(-np.einsum("ij,ij->i", rays.direction_site, hits.normal_site), COSINE_MIN)
    pixel_m2 = np.where(member, hits.distance_m**2 * rays.solid_angle_sr / cosine, 0.0)
    area = np.bincount(owner, weights=pixel_m2, minlength=count) * outlines.area_px2 / sampled
    target_share = np.bincount(owner, weights=hits.hit, minlength=count) / sampled

    kept = np.flatnonzero(member)
    owners, first = np.unique(owner[kept], return_index=True)
    some_member = np.full(count, -1, dtype=np.int64)
    some_member[owners] = kept[first]
    found = some_member >= 0
    polygons = np.full(count, None, dtype=object)
    middle = outlines.centre_img.copy()
    if found.any():
        shapes = map_outlines(outlines, hits, member, some_member, cameras, camera_of)
        polygons[found] = shapes.polygon_site
        for row in np.flatnonzero(found & outlines.has_mask):
            middle[row] = find_mask_centre(outlines, hits, pixel_m2, int(row), polygons[row], cameras[camera_of[row]])
        boxes = np.flatnonzero(found & ~outlines.has_mask)
        middle[boxes] = find_box_centres(outlines, hits.distance_m * rays.forward_cosine, member, boxes)
    anchor = find_nearest_member(outlines, select_main_side(outlines, hits, member), np.arange(count), middle)
    ray = compute_pixel_rays(cameras, camera_of, middle)
    xyz, normal = np.full((count, 3), np.nan), np.full((count, 3), np.nan)
    xyz[found] = intersect_planes(ray.origin_site_m[found], ray.direction_site[found], hits, anchor[found])
    normal[found] = hits.normal_site[anchor[found]]
    sizes = np.full((count, 3), np.nan)
    if found.any():
        sizes[found] = measure_extents(shapes.vertex_site_m, shapes.patch_of_vertex, xyz[found], normal[found])
    return Patches(
        member=member,
        xyz_site_m=xyz,
        normal_site=normal,
        ray=ray,
        distance_m=np.linalg.norm(xyz - ray.origin_site_m, axis=1),
        polygon_site=polygons,
        width_m=sizes[:, 0],
        height_m=sizes[:, 1],
        length_m=sizes[:, 2],
        area_m2=np.where(found, area, np.nan),
        target_share=target_share,
    )
