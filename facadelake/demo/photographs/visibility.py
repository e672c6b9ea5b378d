"""Which defect is seen in which photograph, and where: the truth behind the boxes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64Array
from facadelake.demo.photographs.flight import Shot
from facadelake.demo.recipe import Defect, DefectState
from facadelake.demo.textures.defects import size_in
from facadelake.demo.textures.light import RayScene
from facadelake.demo.world import World

MAX_INCIDENCE_DEG = 75.0
MIN_SHARE_SEEN = 0.6
MIN_SIDE_PX = 4.0
MIN_LONG_SIDE_PX = 10.0
# A ray that stops this much before the surface is stopped by something else.
STOP_M = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class Spot:
    """A defect's place in site: a grid over it (n, 3) with its centre first, outward normals (n, 3)."""

    defect: Defect
    state: DefectState
    grid: Float64Array
    normals: Float64Array

    @property
    def centre(self) -> Float64Array:
        """The centre of the drawn rectangle, on the surface."""
        return np.asarray(self.grid[0])


@dataclass(frozen=True, kw_only=True, eq=False)
class Sighting:
    """A defect in a photograph: the projected centre and the box about it, pixels."""

    spot: Spot
    shot: Shot
    centre_px: Float64Array
    size_px: Float64Array
    incidence_deg: float


def spot_of(world: World, defect: Defect, state: DefectState) -> Spot:
    """The place of a defect as it is in a state."""
    chart = world.charts[defect.surface]
    width, height = size_in(defect, state)
    steps = np.linspace(-0.5, 0.5, 7)
    du, dv = (a.ravel() for a in np.meshgrid(steps, steps))
    u = defect.u_m + width * np.concatenate([[0.0], du])
    v = defect.v_m + height * np.concatenate([[0.0], dv])
    return Spot(
        defect=defect, state=state, grid=world.to_site(chart.points(u, v)), normals=world.turn(chart.compute_normals(u))
    )


def sighting_of(spot: Spot, shot: Shot, rays: RayScene) -> Sighting | None:
    """How a photograph shows a defect; none where it is outside, turned away, hidden or too small to be marked."""
    pixels = shot.posed.project_site(spot.grid)
    camera, eye = shot.posed.camera, shot.posed.centre_site_m
    if not np.isfinite(pixels).all():
        return None
    away = spot.grid - eye
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
    hit, _, _ = rays.hits(np.broadcast_to(eye, away.shape), away / distance[:, None])
    seen = hit > distance - STOP_M / np.clip(cosine, 0.2, 1)
    if not seen[0] or seen.mean() < MIN_SHARE_SEEN:
        return None
    return Sighting(spot=spot, shot=shot, centre_px=pixels[0], size_px=2 * reach, incidence_deg=incidence)


def sightings(spots: list[Spot], shots: list[Shot], rays: RayScene) -> list[Sighting]:
    """All sightings, photograph by photograph."""
    found = (sighting_of(spot, shot, rays) for shot in shots for spot in spots)
    return [s for s in found if s is not None]
