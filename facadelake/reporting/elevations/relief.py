"""Orthographic view of the model for an elevation: depth, normal and element of each cell, edges and shading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facadelake.building import BuildingModel
from facadelake.building.surface import MISS, Surface
from facadelake.core.arrays import BoolArray, Float32Array, Float64Nx3, Float64x3, RowIndices, UInt8Image
from facadelake.reporting.elevations.facades import Facade
from facadelake.reporting.inspection import PictureSettings
from schemas.vocabulary import SurfaceKind

_BAND_ROWS = 256  # rows of cells cast at a time, to limit memory
_STEP_M = 0.03  # smallest step of the surface that is drawn as an edge
_CREASE_COS = np.cos(np.radians(25))
_OPENINGS = ("IfcWindow", "IfcDoor", "IfcCurtainWall", "IfcPlate")


@dataclass(frozen=True, kw_only=True, eq=False)
class FacadeRelief:
    """The cells (rows, columns) of an elevation, from the top left as seen from outside; float32 to save memory.

    ``w_m``: coordinate towards the viewer, metres (NaN where no surface is met); ``normal`` (rows, columns, 3) in site;
    ``element``: row of table ``elements`` (``MISS`` where no surface is met).
    """

    facade: Facade
    cell_m: float
    w_m: Float32Array
    normal: Float32Array
    element: NDArray[np.int32]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.w_m.shape[0], self.w_m.shape[1]

    def site_from_cells(self, rows: RowIndices, columns: RowIndices) -> Float64Nx3:
        """Surface points in site, metres, at the centres of cells."""
        uvw = np.column_stack(
            [
                self.facade.u_min_m + (columns + 0.5) * self.cell_m,
                self.facade.v_max_m - (rows + 0.5) * self.cell_m,
                self.w_m[rows, columns].astype(np.float64),
            ]
        )
        points: Float64Nx3 = uvw @ self.facade.axes_site
        return points

    def has_surface_at(self, xyz_site_m: Float64x3, tolerance_m: float) -> bool:
        """Whether the surface in the point's cell is within ``tolerance_m`` of the point of site, along w."""
        u, v, w = self.facade.uvw_from_site(xyz_site_m[None])[0]
        column, row = int((u - self.facade.u_min_m) // self.cell_m), int((self.facade.v_max_m - v) // self.cell_m)
        if not (0 <= row < self.shape[0] and 0 <= column < self.shape[1]):
            return False
        return bool(abs(float(self.w_m[row, column]) - w) <= tolerance_m)


def choose_cell_size_m(facade: Facade, settings: PictureSettings) -> float:
    """The cell size of the settings, or the smallest one that keeps the facade below ``max_cells``."""
    area = (facade.u_max_m - facade.u_min_m) * (facade.v_max_m - facade.v_min_m)
    return max(settings.cell_m, float(np.sqrt(area / settings.max_cells)))


def render_relief(facade: Facade, surface: Surface, cell_m: float) -> FacadeRelief:
    """Cast parallel rays onto the facade, one per cell of ``cell_m``, from the plane ``near_w_m`` inwards."""
    rows = max(1, int(np.ceil((facade.v_max_m - facade.v_min_m) / cell_m)))
    columns = max(1, int(np.ceil((facade.u_max_m - facade.u_min_m) / cell_m)))
    w_m = np.full((rows, columns), np.nan, dtype=np.float32)
    normal = np.zeros((rows, columns, 3), dtype=np.float32)
    element = np.full((rows, columns), MISS, dtype=np.int32)
    axes = facade.axes_site
    u = facade.u_min_m + (np.arange(columns) + 0.5) * cell_m
    for top in range(0, rows, _BAND_ROWS):
        v = facade.v_max_m - (np.arange(top, min(rows, top + _BAND_ROWS)) + 0.5) * cell_m
        uvw = np.stack(np.broadcast_arrays(u[None, :], v[:, None], facade.near_w_m), axis=-1).reshape(-1, 3)
        hits = surface.cast(uvw @ axes, np.broadcast_to(-axes[2], (len(uvw), 3)))
        shape = (len(v), columns)
        w = np.where(hits.hit, facade.near_w_m - hits.distance_m, np.nan)
        w_m[top : top + len(v)] = w.reshape(shape)
        normal[top : top + len(v)] = np.where(hits.hit[:, None], hits.normal_site, 0.0).reshape(*shape, 3)
        element[top : top + len(v)] = hits.element.reshape(shape)
    return FacadeRelief(facade=facade, cell_m=cell_m, w_m=w_m, normal=normal, element=element)


def find_openings(building: BuildingModel) -> BoolArray:
    """Mask (elements,) of windows, doors, curtain walls and their panels."""
    return np.array(
        [ifc_class.startswith(_OPENINGS) for ifc_class in building.elements.column("ifc_class").to_pylist()], dtype=bool
    )


def find_edges(xyz: Float32Array, normal: Float32Array, element: NDArray[np.int32], is_opening: BoolArray) -> BoolArray:
    """Mask (h, w) of edges in a view: steps, creases and borders of the visible surface, and borders of openings.

    Joints between coplanar elements, such as wall piers and lintels, are not edges: they are not visible.

    Args:
        xyz: surface points (h, w, 3), metres, near the origin of their frame because of float32.
        normal: unit normals (h, w, 3).
        element: rows of table ``elements`` (h, w); ``MISS`` where no surface is met.
        is_opening: mask (elements,) of openings.
    """
    edges = np.zeros(element.shape, dtype=bool)
    opening = np.append(is_opening, False)[element]  # MISS is -1 and selects the appended entry
    for here, neighbour in (
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ):
        both_met = (element[here] != MISS) & (element[neighbour] != MISS)
        offset = xyz[neighbour] - xyz[here]
        step = np.minimum(
            np.abs((offset * normal[here]).sum(axis=-1)), np.abs((offset * normal[neighbour]).sum(axis=-1))
        )
        crease = (normal[here] * normal[neighbour]).sum(axis=-1) < _CREASE_COS
        into_opening = (opening[here] != opening[neighbour]) & (element[here] != element[neighbour])
        change = both_met & ((step > _STEP_M) | crease | into_opening)
        edges[here] |= change | ((element[here] != MISS) != (element[neighbour] != MISS))
    return edges


def has_model_edges(building: BuildingModel) -> bool:
    """Whether edges of the surface may be drawn: those of an as-built surface are noise and resemble cracks."""
    return building.surface_kind is not SurfaceKind.AS_BUILT


def find_relief_edges(relief: FacadeRelief, building: BuildingModel) -> BoolArray:
    """Mask (rows, columns) of the model's edges in an elevation; empty for an as-built surface."""
    rows, columns = relief.shape
    if not has_model_edges(building):
        return np.zeros((rows, columns), dtype=bool)
    u = (np.arange(columns, dtype=np.float32) + np.float32(0.5)) * np.float32(relief.cell_m)
    v = -(np.arange(rows, dtype=np.float32) + np.float32(0.5)) * np.float32(relief.cell_m)
    w = np.nan_to_num(relief.w_m - np.float32(relief.facade.far_w_m))
    uvw = np.stack(np.broadcast_arrays(u[None, :], v[:, None], w), axis=-1)
    normal_uvw = relief.normal @ relief.facade.axes_site.T.astype(np.float32)
    return find_edges(uvw, normal_uvw, relief.element, find_openings(building))


def render_shaded_relief(relief: FacadeRelief, building: BuildingModel) -> UInt8Image:
    """Shaded view of the model (rows, columns, RGB): light from the upper left, openings bluish, background white."""
    axes = relief.facade.axes_site
    light = np.array([-0.45, 0.55, 0.70]) @ axes
    shade = np.clip(relief.normal @ light.astype(np.float32), 0.0, 1.0)
    picture = np.full((*relief.shape, 3), 255, dtype=np.uint8)
    value = (196 + 44 * shade)[..., None]
    met = relief.element != MISS
    opening = np.append(find_openings(building), False)[relief.element]
    tint = np.where(opening[..., None], np.array([0.90, 0.95, 1.0]), np.array([1.0, 1.0, 0.985])).astype(np.float32)
    picture[met] = (value * tint)[met].astype(np.uint8)
    return picture
