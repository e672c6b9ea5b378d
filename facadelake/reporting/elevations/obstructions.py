"""Obstructions: what hides the walls but is not in the model, such as a container, a scaffold or a tree."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from facadelake.building.surface import Surface
from facadelake.core.arrays import BoolArray, Float64Nx3, Float64x3
from facadelake.reporting.elevations.relief import FacadeRelief

_GAP_MIN_M = 0.3  # sills, pipes and small cornices that the model lacks are nearer to the wall
_GAP_SIGMAS = 4.0
_ON_MODEL_SHARE = 0.25  # at least this share of the tie points is on the building, the rest on its surroundings
_EDGE_MAX_M = 2.0  # longer triangles of the as-built surface bridge parts that no photograph shows
_LISTED_MIN_M2 = 0.1


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
        self._as_built = Surface.from_mesh(vertices, as_built.triangles[longest <= _EDGE_MAX_M])
        # A campaign placed by GPS alone is metres off, which must not count as an obstruction.
        offset_m = float(np.quantile(surface.measure_distance(vertices), _ON_MODEL_SHARE)) if len(vertices) else 0.0
        self._gap_m = max(_GAP_MIN_M, _GAP_SIGMAS * float(np.hypot(placement_sigma_m, offset_m)))

    def find_hidden_points(self, centre_site_m: Float64x3, xyz_site_m: Float64Nx3) -> BoolArray:
        """Which points (n, 3) of the model an obstruction hides from a camera at ``centre_site_m``."""
        to_point = xyz_site_m - centre_site_m
        distance = np.linalg.norm(to_point, axis=1)
        hits = self._as_built.cast(np.broadcast_to(centre_site_m, to_point.shape), to_point)
        hidden: BoolArray = hits.hit & (distance - hits.distance_m > self._gap_m)
        # Along a grazing ray a small relief makes a long gap: the nearest part of the model must be as far away.
        rows = np.flatnonzero(hidden)
        if len(rows):
            hidden[rows] = self._model.measure_distance(hits.xyz_site_m[rows]) > self._gap_m
        return hidden


@dataclass(frozen=True, kw_only=True)
class HiddenRegion:
    """A part of an elevation that something hides; its extents in frame ``facade``, metres, and its area."""

    u_min_m: float
    u_max_m: float
    v_min_m: float
    v_max_m: float
    area_m2: float


def find_hidden_regions(relief: FacadeRelief, hidden: BoolArray) -> list[HiddenRegion]:
    """The connected parts of the cells ``hidden`` (rows, columns) of at least 0.1 m2, the largest first."""
    count, _, statistics, _ = cv2.connectedComponentsWithStats(hidden.astype(np.uint8), connectivity=8)
    facade, cell_m = relief.facade, relief.cell_m
    regions = [
        HiddenRegion(
            u_min_m=facade.u_min_m + left * cell_m, u_max_m=facade.u_min_m + (left + width) * cell_m,
            v_min_m=facade.v_max_m - (top + height) * cell_m, v_max_m=facade.v_max_m - top * cell_m,
            area_m2=cells * cell_m**2,
        )
        for left, top, width, height, cells in statistics[1:count].tolist()
    ]  # fmt: skip
    return sorted((one for one in regions if one.area_m2 >= _LISTED_MIN_M2), key=lambda one: -one.area_m2)
