"""Which points of a surface a photograph shows, and how well."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.building.surface import Surface
from facadelake.core.arrays import BoolArray, Float64Array
from facadelake.core.camera import Camera, PosedCamera


@dataclass(frozen=True, kw_only=True, eq=False)
class PointVisibility:
    """Per point: is it seen; the size of a pixel on the surface there (m, where it is longest); how far the pixel lies
    from the photograph's border (0 at it, 1 in the middle; lenses are darker and softer towards it)."""

    visible: BoolArray
    pixel_m: Float64Array
    inset: Float64Array


def _compute_max_tangent(camera: Camera) -> float:
    """Tangent of the widest angle from the optical axis inside the photograph.

    Beyond it Brown's polynomial may fold points that are far outside back into the picture.
    """
    width, height = camera.width_px, camera.height_px
    rays = camera.rays_cam_from_img(np.array([[0, 0], [width, 0], [0, height], [width, height]], dtype=np.float64))
    return float((np.hypot(rays[:, 0], rays[:, 1]) / rays[:, 2]).max())


def project_points(posed: PosedCamera, xyz_site_m: Float64Array) -> tuple[Float64Array, BoolArray]:
    """Pixels (n, 2) of site points (n, 3) and which of them (n,) lie inside the photograph."""
    xyz_cam = posed.site_from_cam.invert().apply(xyz_site_m)
    xy = posed.camera.project(xyz_cam)
    in_front = xyz_cam[:, 2] > 1e-6
    tangent = np.hypot(xyz_cam[:, 0], xyz_cam[:, 1]) / np.where(in_front, xyz_cam[:, 2], 1.0)
    inside = in_front & (tangent <= 1.05 * _compute_max_tangent(posed.camera))
    inside[inside] = posed.camera.is_inside(xy[inside])
    return xy, inside


def check_visibility(
    posed: PosedCamera,
    surface: Surface,
    xyz_site_m: Float64Array,
    normal_site: Float64Array,
    *,
    tolerance_m: float,
    max_incidence_deg: float,
) -> PointVisibility:
    """Which of the surface's points (n, 3) with outward normals (n, 3) the photograph shows.

    A point is hidden where the ray to it meets the surface more than ``tolerance_m`` before it, or where it is seen
    flatter than ``max_incidence_deg``. Rays are cast only for points that project into the photograph.
    """
    count = len(xyz_site_m)
    visible, pixel_m, inset = np.zeros(count, dtype=bool), np.full(count, np.inf), np.zeros(count)
    to_point = xyz_site_m - posed.centre_site_m
    distance = np.linalg.norm(to_point, axis=1)
    cosine = -np.einsum("ij,ij->i", to_point, normal_site) / np.maximum(distance, 1e-9)
    facing = np.flatnonzero(cosine > np.cos(np.radians(max_incidence_deg)))
    xy, inside = project_points(posed, xyz_site_m[facing])
    ask = facing[inside]
    if len(ask):
        origins = np.broadcast_to(posed.centre_site_m, (len(ask), 3))
        hits = surface.cast(origins, to_point[ask])
        visible[ask] = hits.distance_m >= distance[ask] - tolerance_m
        pixel_m[ask] = distance[ask] / posed.camera.fx_px / cosine[ask]
        share = xy[inside] / (posed.camera.width_px, posed.camera.height_px)
        inset[ask] = np.clip(2.0 * np.minimum(share, 1.0 - share).min(axis=1), 0.0, 1.0)
    return PointVisibility(visible=visible, pixel_m=pixel_m, inset=inset)
