"""Visibility of surface points in a photograph, and the resolution there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.building.surface.raycasting import Surface
from facadelake.core.arrays import BoolArray, Float64N, Float64Nx2, Float64Nx3
from facadelake.core.camera import Camera, PosedCamera


@dataclass(frozen=True, kw_only=True, eq=False)
class PointVisibility:
    """Visibility of points (n,) in one photograph.

    ``in_view``: the photograph's frame contains the point, and faces it at no more than the permitted incidence.
    ``visible``: it is in view, and the surface does not hide it. ``pixel_m``: size of a pixel on the surface along its
    longest side, metres. ``inset``: distance of the pixel from the photograph's border, 0 at the border and 1 at the
    centre; lenses are darker and less sharp towards the border.
    """

    in_view: BoolArray
    visible: BoolArray
    pixel_m: Float64N
    inset: Float64N


def _compute_max_tangent(camera: Camera) -> float:
    """Tangent of the largest angle from the optical axis within the photograph.

    Beyond it Brown's distortion polynomial is not monotonic and may project outside points into the photograph.
    """
    width, height = camera.width_px, camera.height_px
    rays = camera.rays_cam_from_img(np.array([[0, 0], [width, 0], [0, height], [width, height]], dtype=np.float64))
    return float((np.hypot(rays[:, 0], rays[:, 1]) / rays[:, 2]).max())


def project_points(posed: PosedCamera, xyz_site_m: Float64Nx3) -> tuple[Float64Nx2, BoolArray]:
    """Pixels (n, 2) of points of site, and a mask (n,) of those within the photograph."""
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
    xyz_site_m: Float64Nx3,
    normal_site: Float64Nx3,
    *,
    tolerance_m: float,
    max_incidence_deg: float,
) -> PointVisibility:
    """Visibility of surface points in a photograph; rays are cast only to points that project into it.

    Args:
        posed: camera with pose.
        surface: surface that may hide the points.
        xyz_site_m: points in site, metres.
        normal_site: outward unit normals at the points, in site.
        tolerance_m: a surface up to this distance in front of a point does not hide it, metres.
        max_incidence_deg: larger angles between ray and normal count as not visible, degrees.
    """
    count = len(xyz_site_m)
    in_view, visible = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    pixel_m, inset = np.full(count, np.inf), np.zeros(count)
    to_point = xyz_site_m - posed.centre_site_m
    distance = np.linalg.norm(to_point, axis=1)
    cosine = -np.einsum("ij,ij->i", to_point, normal_site) / np.maximum(distance, 1e-9)
    facing = np.flatnonzero(cosine > np.cos(np.radians(max_incidence_deg)))
    xy, inside = project_points(posed, xyz_site_m[facing])
    rows = facing[inside]
    in_view[rows] = True
    if len(rows):
        origins = np.broadcast_to(posed.centre_site_m, (len(rows), 3))
        hits = surface.cast(origins, to_point[rows])
        visible[rows] = hits.distance_m >= distance[rows] - tolerance_m
        pixel_m[rows] = distance[rows] / posed.camera.fx_px / cosine[rows]
        share = xy[inside] / (posed.camera.width_px, posed.camera.height_px)
        inset[rows] = np.clip(2.0 * np.minimum(share, 1.0 - share).min(axis=1), 0.0, 1.0)
    return PointVisibility(in_view=in_view, visible=visible, pixel_m=pixel_m, inset=inset)
