"""Which defect is seen in which photograph, and where: the truth behind the boxes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64Array
from facadelake.demo.photographs.flight import DemoExposure
from facadelake.demo.recipe import DefectState, DemoDefect
from facadelake.demo.textures.defects import compute_size
from facadelake.demo.textures.lighting import RayScene
from facadelake.demo.world import DemoWorld

MAX_INCIDENCE_DEG = 75.0
MIN_VISIBLE_SHARE = 0.6
MIN_SIDE_PX = 4.0
MIN_LONG_SIDE_PX = 10.0
# A ray that stops this much before the surface is stopped by something else.
OCCLUSION_TOLERANCE_M = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class DefectGrid:
    """A defect's place in site: a grid over it (n, 3) with its centre first, outward normals (n, 3)."""

    defect: DemoDefect
    state: DefectState
    xyz_site: Float64Array
    normals: Float64Array

    @property
    def centre(self) -> Float64Array:
        """The centre of the drawn rectangle, on the surface."""
        return np.asarray(self.xyz_site[0])


@dataclass(frozen=True, kw_only=True, eq=False)
class ProjectedDefect:
    """A defect in a photograph: the projected centre and the box about it, pixels."""

    grid: DefectGrid
    exposure: DemoExposure
    centre_px: Float64Array
    size_px: Float64Array
    incidence_deg: float


def sample_defect(world: DemoWorld, defect: DemoDefect, state: DefectState) -> DefectGrid:
    """The place of a defect as it is in a state."""
    chart = world.charts[defect.surface]
    width, height = compute_size(defect, state)
    steps = np.linspace(-0.5, 0.5, 7)
    du, dv = (a.ravel() for a in np.meshgrid(steps, steps))
    u = defect.u_m + width * np.concatenate([[0.0], du])
    v = defect.v_m + height * np.concatenate([[0.0], dv])
    return DefectGrid(
        defect=defect,
        state=state,
        xyz_site=world.transform_to_site(chart.compute_points(u, v)),
        normals=world.rotate_to_site(chart.compute_normals(u)),
    )


def project_defect(spot: DefectGrid, shot: DemoExposure, rays: RayScene) -> ProjectedDefect | None:
    """How a photograph shows a defect; none where it is outside, turned away, hidden or too small to be marked."""
    pixels = shot.posed.project_site(spot.xyz_site)
    camera, eye = shot.posed.camera, shot.posed.centre_site_m
    if not np.isfinite(pixels).all():
        return None
    away = spot.xyz_site - eye
    distance = np.linalg.norm(away, axis=1)
    cosine = -np.einsum("ij,ij->i", away, spot.normals) / distance
    incidence = float(np.degrees(np.arccos(np.clip(cosine[0], -1, 1))))
    if incidence > MAX_INCIDENCE_DEG:
        return None
    reach = np.abs(pixels - pixels[0]).max(axis=0)
    low, high = pixels[0] - reach, pixels[0] + reach
    if (low < 0).any() or (high > [camera.width_px, camera.height_px]).any():
        return None
    scale = camera.width_px / 1600
    if (2 * reach).min() < MIN_SIDE_PX * scale or (2 * reach).max() < MIN_LONG_SIDE_PX * scale:
        return None
    hit, _, _ = rays.cast(np.broadcast_to(eye, away.shape), away / distance[:, None])
    seen = hit > distance - OCCLUSION_TOLERANCE_M / np.clip(cosine, 0.2, 1)
    if not seen[0] or seen.mean() < MIN_VISIBLE_SHARE:
        return None
    return ProjectedDefect(grid=spot, exposure=shot, centre_px=pixels[0], size_px=2 * reach, incidence_deg=incidence)


def project_defects(spots: list[DefectGrid], shots: list[DemoExposure], rays: RayScene) -> list[ProjectedDefect]:
    """All sightings, photograph by photograph."""
    found = (project_defect(spot, shot, rays) for shot in shots for spot in spots)
    return [s for s in found if s is not None]
