"""The cells of a building's facades: squares of the facade's plane, cut by the elements, on the outer surface.

The grid is anchored at the site's origin, so that a place has the same cell in every campaign. A facade's surface is
sampled by parallel rays; each sample stands for the area of the surface, not of its view, so that a wall that turns
away from the facade's plane, as at a round corner, counts as if it were unrolled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from facadelake.building import BuildingModel, mask_target_elements
from facadelake.building.facades import collect_facades, collect_triangles, find_facade_triangles
from facadelake.building.surface import Surface
from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Float64Nx3, Int64Array, RowIndices
from facadelake.core.camera import PosedCamera
from facadelake.core.frames import compute_facade_axes, facade_from_site

CELL_M = 0.25
_SAMPLES_PER_SIDE = 2
_STEP_M = CELL_M / _SAMPLES_PER_SIDE
_START_M = 1.0  # distance of the rays' origins from the foremost point of the facade
_COVERED_GAP_M = 0.5  # a surface less than this behind another is covered by it, as a wall by its cladding
_LAYER_GAP_M = 1.0
_MAX_LAYERS = 16
_STEP_PAST_M = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class FacadeCells:
    """The n cells of all facades, and m samples of their surface.

    ``facades``: names. Of cells: ``facade`` indices in them, ``azimuth_deg``, ``column`` and ``row`` in the grid,
    ``element`` rows of table ``elements``, ``layer``, ``bounds_m`` (n, 4: u_min, u_max, v_min, v_max), ``area_m2``,
    mean ``xyz_site_m`` (n, 3) and unit ``normal_site`` (n, 3). Of samples: ``cell_of_sample`` (m,), ascending,
    ``sample_xyz_site_m``, ``sample_normal_site`` (m, 3).
    """

    facades: tuple[str, ...]
    facade: Int64Array
    azimuth_deg: Float64N
    column: Int64Array
    row: Int64Array
    element: RowIndices
    layer: Int64Array
    bounds_m: Float64Array
    area_m2: Float64N
    xyz_site_m: Float64Nx3
    normal_site: Float64Nx3
    cell_of_sample: RowIndices
    sample_xyz_site_m: Float64Nx3
    sample_normal_site: Float64Nx3

    def __len__(self) -> int:
        return len(self.facade)

    def sum_samples(self, values: Float64N | BoolArray) -> Float64N:
        """Sum (n,) over each cell's samples of ``values`` (m,)."""
        total: Float64N = np.bincount(self.cell_of_sample, weights=values, minlength=len(self)).astype(np.float64)
        return total

    def widen_to_neighbours(self, mask: BoolArray) -> BoolArray:
        """``mask`` (n,) of cells, widened to the eight neighbours of each in its facade."""
        wide = mask.copy()
        for facade in np.unique(self.facade[mask]):
            own = np.flatnonzero(self.facade == facade)
            column, row = self.column[own] - self.column[own].min(), self.row[own] - self.row[own].min()
            grid = np.zeros((row.max() + 1, column.max() + 1), dtype=np.uint8)
            grid[row[mask[own]], column[mask[own]]] = 1
            wide[own] = cv2.dilate(grid, np.ones((3, 3), dtype=np.uint8))[row, column] > 0
        return wide

    def build_outlines(self) -> Float64Array:
        """Corners (n, 4, 3) of the cells in site, anticlockwise as seen from outside, in the plane of each surface."""
        u_min, u_max, v_min, v_max = self.bounds_m.T
        corners = np.empty((len(self), 4, 3))
        for azimuth_deg in np.unique(self.azimuth_deg):
            own = np.flatnonzero(self.azimuth_deg == azimuth_deg)
            axes = compute_facade_axes(float(azimuth_deg))
            centre, normal = self.xyz_site_m[own] @ axes.T, self.normal_site[own] @ axes.T
            for index, (u, v) in enumerate(((u_min, v_min), (u_max, v_min), (u_max, v_max), (u_min, v_max))):
                du, dv = u[own] - centre[:, 0], v[own] - centre[:, 1]
                dw = -(du * normal[:, 0] + dv * normal[:, 1]) / normal[:, 2]
                corners[own, index] = np.column_stack([u[own], v[own], centre[:, 2] + dw]) @ axes
        return corners


@dataclass(frozen=True, kw_only=True, eq=False)
class _FacadeSamples:
    """Samples (m,) of the outer surface of one facade: uvw (m, 3) in frame ``facade``, unit normals, elements."""

    name: str
    azimuth_deg: float
    uvw_m: Float64Nx3
    xyz_site_m: Float64Nx3
    normal_site: Float64Nx3
    element: RowIndices


def divide_facades(
    building: BuildingModel, surface: Surface, posed: Mapping[str, PosedCamera], *, tolerance_m: float
) -> FacadeCells:
    """Divide the facades of a building into cells of 0.25 m.

    Only walls and openings that belong to a facade have cells: not roofs, soffits and floors (facade "level"), interior
    surfaces, the ground, or a surface that another one covers at less than half a metre.

    Args:
        building: the building model.
        surface: its surface.
        posed: cameras with poses, by photo_id; they show which side of a wall is outside.
        tolerance_m: a surface up to this distance in front of a point does not hide it, metres.
    """
    walls = collect_triangles(building, surface)
    facades = collect_facades(building.elements)
    is_target = mask_target_elements(building.elements)
    triangles = find_facade_triangles(building, walls, surface, posed, tolerance_m)
    parts = []
    for name in sorted(triangles):
        azimuth_deg = facades.get_azimuth_deg(name)
        own = triangles[name][is_target[walls.element[triangles[name]]] & (walls.area[triangles[name]] > 0)]
        if azimuth_deg is not None and len(own):
            parts.append(_sample_facade(name, azimuth_deg, own, surface))
    return _group_samples([part for part in parts if len(part.uvw_m)])


def _sample_facade(name: str, azimuth_deg: float, own: RowIndices, surface: Surface) -> _FacadeSamples:
    """Sample the triangles ``own`` of a facade where they are the outer surface, in all its layers."""
    axes = compute_facade_axes(azimuth_deg)
    is_own = np.zeros(len(surface.triangles) + 1, dtype=bool)  # the last entry is that of a miss
    is_own[own] = True
    corners = facade_from_site(surface.vertices_site_m[np.unique(surface.triangles[own])], azimuth_deg)
    low, high = corners.min(axis=0), corners.max(axis=0)
    u, v = (
        (np.arange(np.floor(low[axis] / CELL_M), np.ceil(high[axis] / CELL_M), 1 / _SAMPLES_PER_SIDE) * CELL_M)
        + _STEP_M / 2
        for axis in (0, 1)
    )
    grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    start_w = np.full(len(grid), high[2] + _START_M)
    previous_w = np.full(len(grid), np.inf)
    uvw_parts, xyz_parts, normal_parts = ([np.zeros((0, 3))] for _ in range(3))
    element_parts = [np.zeros(0, dtype=np.int64)]
    for _ in range(_MAX_LAYERS):
        if len(grid) == 0:
            break
        origins = np.column_stack([grid, start_w]) @ axes
        hits = surface.cast(origins, np.broadcast_to(-axes[2], origins.shape))
        w = start_w - hits.distance_m
        outer = is_own[hits.triangle] & (previous_w - w > _COVERED_GAP_M)
        uvw_parts.append(np.column_stack([grid, w])[outer])
        xyz_parts.append(hits.xyz_site_m[outer])
        normal_parts.append(hits.normal_site[outer])
        element_parts.append(hits.element[outer])
        onward = hits.hit & (w > low[2])
        grid, start_w, previous_w = grid[onward], w[onward] - _STEP_PAST_M, w[onward]
    return _FacadeSamples(
        name=name,
        azimuth_deg=azimuth_deg,
        uvw_m=np.concatenate(uvw_parts),
        xyz_site_m=np.concatenate(xyz_parts),
        normal_site=np.concatenate(normal_parts),
        element=np.concatenate(element_parts),
    )


def _group_samples(parts: list[_FacadeSamples]) -> FacadeCells:
    """Group samples by facade, cell of the grid, element and layer."""
    of_facade = np.repeat(np.arange(len(parts)), [len(part.uvw_m) for part in parts])
    uvw = np.concatenate([part.uvw_m for part in parts] or [np.zeros((0, 3))])
    element = np.concatenate([part.element for part in parts] or [np.zeros(0, dtype=np.int64)])
    grid = np.floor(uvw[:, :2] / CELL_M).astype(np.int64)
    order = np.lexsort((-uvw[:, 2], element, grid[:, 1], grid[:, 0], of_facade))
    uvw, keys = uvw[order], np.column_stack([of_facade, grid, element])[order]
    xyz: Float64Nx3 = np.concatenate([part.xyz_site_m for part in parts] or [np.zeros((0, 3))])[order]
    normal: Float64Nx3 = np.concatenate([part.normal_site for part in parts] or [np.zeros((0, 3))])[order]
    is_new_key, is_behind = np.ones(len(keys), dtype=bool), np.zeros(len(keys), dtype=bool)
    is_new_key[1:] = (keys[1:] != keys[:-1]).any(axis=1)
    is_behind[1:] = ~is_new_key[1:] & (uvw[:-1, 2] - uvw[1:, 2] > _LAYER_GAP_M)
    starts = np.flatnonzero(is_new_key | is_behind)
    cell = np.cumsum(is_new_key | is_behind) - 1
    layers, first_of_key = np.cumsum(is_behind), np.flatnonzero(is_new_key)[np.cumsum(is_new_key) - 1]
    azimuths = np.array([part.azimuth_deg for part in parts], dtype=np.float64)
    outward = np.array([compute_facade_axes(azimuth)[2] for azimuth in azimuths]).reshape(-1, 3)
    area = _STEP_M**2 / np.einsum("ij,ij->i", normal, outward[keys[:, 0]])
    mean_normal = _average(cell, normal)
    return FacadeCells(
        facades=tuple(part.name for part in parts),
        facade=keys[starts, 0],
        azimuth_deg=azimuths[keys[starts, 0]],
        column=keys[starts, 1], row=keys[starts, 2], element=keys[starts, 3],
        layer=(layers - layers[first_of_key])[starts],
        bounds_m=_bound_cells(uvw, starts),
        area_m2=np.bincount(cell, weights=area).astype(np.float64),
        xyz_site_m=_average(cell, xyz),
        normal_site=mean_normal / np.linalg.norm(mean_normal, axis=1, keepdims=True),
        cell_of_sample=cell, sample_xyz_site_m=xyz, sample_normal_site=normal,
    )  # fmt: skip


def _bound_cells(uvw_m: Float64Nx3, starts: RowIndices) -> Float64Array:
    """u_min, u_max, v_min, v_max (n, 4) of the parts of cells on their elements, from the samples (m, 3) of each."""
    bounds = np.empty((len(starts), 4))
    if len(starts):
        for axis in (0, 1):
            bounds[:, 2 * axis] = np.minimum.reduceat(uvw_m[:, axis], starts) - _STEP_M / 2
            bounds[:, 2 * axis + 1] = np.maximum.reduceat(uvw_m[:, axis], starts) + _STEP_M / 2
    return bounds


def _average(cell: RowIndices, vectors: Float64Nx3) -> Float64Nx3:
    """Mean (n, 3) of the vectors (m, 3) of each cell."""
    count = np.bincount(cell)
    mean: Float64Nx3 = np.column_stack([np.bincount(cell, weights=vectors[:, axis]) / count for axis in range(3)])
    return mean
