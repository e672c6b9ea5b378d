"""Visible defects of each photograph and their pixels: the truth of the annotations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64Nx3, Float64x2, Float64x3
from facadelake.demo.defect_recipe import DefectOnDay
from facadelake.demo.photographs.flight import DemoExposure
from facadelake.demo.textures.lighting import RayScene
from facadelake.demo.world import DemoWorld

MAX_INCIDENCE_DEG = 75.0
MIN_VISIBLE_SHARE = 0.6
MIN_SIDE_PX = 4.0
MIN_LONG_SIDE_PX = 10.0
# A ray that stops this far in front of the surface is occluded.
OCCLUSION_TOLERANCE_M = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class DefectGrid:
    """Points on a defect: ``xyz_site`` (n, 3), its centre first, with outward normals (n, 3) in site."""

    defect: DefectOnDay
    xyz_site: Float64Nx3
    normals: Float64Nx3

    @property
    def centre(self) -> Float64x3:
        """Centre (3,) of the drawn rectangle, on the surface."""
        return np.asarray(self.xyz_site[0])


@dataclass(frozen=True, kw_only=True, eq=False)
class ProjectedDefect:
    """A defect in a photograph: centre and size of its box in pixels, and its incidence."""

    grid: DefectGrid
    exposure: DemoExposure
    centre_px: Float64x2
    size_px: Float64x2
    incidence_deg: float


def sample_defect(world: DemoWorld, defect: DefectOnDay) -> DefectGrid:
    """The grid of points on a defect, with its size on that day."""
    chart = world.charts[defect.surface]
    steps = np.linspace(-0.5, 0.5, 7)
    du, dv = (a.ravel() for a in np.meshgrid(steps, steps))
    u = defect.u_m + defect.width_m * np.concatenate([[0.0], du])
    v = defect.v_m + defect.height_m * np.concatenate([[0.0], dv])
    return DefectGrid(
        defect=defect,
        xyz_site=world.transform_to_site(chart.compute_points(u, v)),
        normals=world.rotate_to_site(chart.compute_normals(u)),
    )


def project_defect(grid: DefectGrid, exposure: DemoExposure, rays: RayScene) -> ProjectedDefect | None:
    """A defect in a photograph; None where it is outside, seen too obliquely, occluded or too small to be annotated."""
    pixels = exposure.posed.project_site(grid.xyz_site)
    camera, centre_site = exposure.posed.camera, exposure.posed.centre_site_m
    if not np.isfinite(pixels).all():
        return None
    rays_to_grid = grid.xyz_site - centre_site
    distance = np.linalg.norm(rays_to_grid, axis=1)
    cosine = -np.einsum("ij,ij->i", rays_to_grid, grid.normals) / distance
    incidence = float(np.degrees(np.arccos(np.clip(cosine[0], -1, 1))))
    if incidence > MAX_INCIDENCE_DEG:
        return None
    half_size = np.abs(pixels - pixels[0]).max(axis=0)
    low, high = pixels[0] - half_size, pixels[0] + half_size
    if (low < 0).any() or (high > [camera.width_px, camera.height_px]).any():
        return None
    scale = camera.width_px / 1600
    if (2 * half_size).min() < MIN_SIDE_PX * scale or (2 * half_size).max() < MIN_LONG_SIDE_PX * scale:
        return None
    hit, _ = rays.cast(np.broadcast_to(centre_site, rays_to_grid.shape), rays_to_grid / distance[:, None])
    visible = hit > distance - OCCLUSION_TOLERANCE_M / np.clip(cosine, 0.2, 1)
    if not visible[0] or visible.mean() < MIN_VISIBLE_SHARE:
        return None
    return ProjectedDefect(
        grid=grid, exposure=exposure, centre_px=pixels[0], size_px=2 * half_size, incidence_deg=incidence
    )


def project_defects(grids: list[DefectGrid], exposures: list[DemoExposure], rays: RayScene) -> list[ProjectedDefect]:
    """All visible defects, photograph by photograph."""
    found = (project_defect(grid, exposure, rays) for exposure in exposures for grid in grids)
    return [s for s in found if s is not None]
