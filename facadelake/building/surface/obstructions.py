"""Obstructions: what hides the walls but is not in the model, such as a container, a scaffold or a tree."""

from __future__ import annotations

import numpy as np

from facadelake.building.surface.raycasting import Surface
from facadelake.core.arrays import BoolArray, Float64Nx3, Float64x3

_GAP_MIN_M = 0.3  # sills, pipes and small cornices that the model lacks are nearer to the wall
_GAP_SIGMAS = 4.0
_ON_MODEL_SHARE = 0.25  # at least this share of the tie points is on the building, the rest on its surroundings
_EDGE_MAX_M = 2.0  # longer triangles of the as-built surface bridge parts that no photograph shows


class Obstructions:
    """The parts of a campaign's as-built surface that are in front of the model.

    Args:
        as_built: surface of the campaign's tie points in site.
        surface: surface of the building model.
        placement_sigma_m: one sigma of the campaign's position relative to the model, metres.
    """

    def __init__(self, as_built: Surface, surface: Surface, placement_sigma_m: float) -> None:
        corners = as_built.vertices_site_m[as_built.triangles]
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
        vertices = as_built.vertices_site_m
        self._model = surface
        distance_m = surface.measure_distance(vertices)
        # A campaign placed by GPS alone is metres off, which must not count as an obstruction.
        offset_m = float(np.quantile(distance_m, _ON_MODEL_SHARE)) if len(vertices) else 0.0
        self._gap_m = max(_GAP_MIN_M, _GAP_SIGMAS * float(np.hypot(placement_sigma_m, offset_m)))
        # A triangle whose corners are all on the model, as across the corner of two walls, bridges parts of it.
        off_model = (distance_m > self._gap_m)[as_built.triangles].any(axis=1)
        kept = as_built.triangles[(longest <= _EDGE_MAX_M) & off_model]
        self._as_built = Surface.from_mesh(vertices, kept) if len(kept) else None

    def find_hidden_points(self, centre_site_m: Float64x3, xyz_site_m: Float64Nx3) -> BoolArray:
        """Which points (n, 3) of the model an obstruction hides from a camera at ``centre_site_m``."""
        if self._as_built is None:
            return np.zeros(len(xyz_site_m), dtype=bool)
        to_point = xyz_site_m - centre_site_m
        distance = np.linalg.norm(to_point, axis=1)
        hits = self._as_built.cast(np.broadcast_to(centre_site_m, to_point.shape), to_point)
        hidden: BoolArray = hits.hit & (distance - hits.distance_m > self._gap_m)
        # Along a grazing ray a small relief makes a long gap: the nearest part of the model must be as far away.
        rows = np.flatnonzero(hidden)
        if len(rows):
            hidden[rows] = self._model.measure_distance(hits.xyz_site_m[rows]) > self._gap_m
        return hidden
