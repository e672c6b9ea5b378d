"""Rectified view of a defect and its surroundings, true to scale: the photograph projected onto the surface."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from facadelake.building.surface import Surface, check_visibility, project_points
from facadelake.core.arrays import BoolArray, Float64Nx2, Float64Nx3, Float64x3, Float64x3x3, UInt8Image
from facadelake.core.camera import PosedCamera
from facadelake.core.frames import axes_from_normal
from facadelake.reporting.drawing.photograph import choose_reduction
from facadelake.reporting.elevations.marks import DefectMark
from facadelake.reporting.elevations.rectification import sample_bilinear

_MIN_SIDE_M, _MAX_SIDE_M = 0.3, 8.0
_SIDE_FACTOR = 1.8  # size of the view relative to the defect
_VIEW_DISTANCE_M = 0.3  # from view plane to surface: includes jambs and sills, excludes balconies
_MAX_SHIFT_M = 0.3
_VISIBILITY_TOLERANCE_M = 0.08
_MAX_INCIDENCE_DEG = 88.0
EMPTY_GREY = 225  # grey level of cells that are not visible in the photograph


@dataclass(frozen=True, kw_only=True, eq=False)
class PatchView:
    """``picture`` (cells, cells, RGB) around a defect with cells of ``cell_m``; ``visible`` (cells, cells).

    ``rings_m``: the defect's outlines, metres to the right and up of the picture's centre.
    """

    picture: UInt8Image
    visible: BoolArray
    cell_m: float
    rings_m: tuple[Float64Nx2, ...]

    @property
    def side_m(self) -> float:
        """Width and height of the picture, metres."""
        return self.cell_m * int(self.picture.shape[1])


def choose_patch_side_m(mark: DefectMark) -> float:
    """Width and height of a defect's view, metres."""
    flat = (mark.corners_site_m - mark.centre_site_m) @ axes_from_normal(mark.normal_site)[:2].T
    return float(np.clip(2.0 * np.abs(flat).max() * _SIDE_FACTOR, _MIN_SIDE_M, _MAX_SIDE_M))


def rectify_patch(
    mark: DefectMark, posed: PosedCamera, pixels: UInt8Image, surface: Surface, cells: int, pixel_m: float
) -> PatchView:
    """Rectify a photograph onto the surface around a defect.

    A ray along the defect's normal finds the surface point of each cell, so that parts in front of or behind the
    defect's plane, such as sills and reveals, appear at their true positions. The surface is shifted along the normal
    to the defect's position, which may have been triangulated off the model.

    Args:
        mark: the defect.
        posed: camera and pose of the photograph.
        pixels: the photograph (h, w, 3), RGB, full resolution.
        surface: surface of the model.
        cells: width and height of the view in cells.
        pixel_m: size of a pixel on the surface, metres.
    """
    axes = axes_from_normal(mark.normal_site)
    rings = tuple((ring - mark.centre_site_m) @ axes[:2].T for ring in mark.outlines_site_m)
    cell_m = choose_patch_side_m(mark) / cells
    xyz, normal, shift = _cast_patch(mark, axes, surface, cell_m, cells)
    visibility = check_visibility(
        posed, surface, xyz, normal, tolerance_m=_VISIBILITY_TOLERANCE_M, max_incidence_deg=_MAX_INCIDENCE_DEG
    )
    xy, inside = project_points(posed, xyz + shift)
    visible = visibility.visible & inside
    picture = np.full((cells * cells, 3), EMPTY_GREY, dtype=np.uint8)
    if visible.any():
        picture[visible] = _sample_colours(pixels, xy[visible], choose_reduction(pixel_m, cell_m))
    return PatchView(
        picture=picture.reshape(cells, cells, 3), visible=visible.reshape(cells, cells), cell_m=cell_m, rings_m=rings
    )


def _cast_patch(
    mark: DefectMark, axes: Float64x3x3, surface: Surface, cell_m: float, cells: int
) -> tuple[Float64Nx3, Float64Nx3, Float64x3]:
    """Surface points and normals (cells * cells, 3) from the top left, and the shift of the defect off the surface.

    The defect's plane is used instead where no surface is met within ``_MAX_SHIFT_M`` of the defect's position.
    """
    along = (np.arange(cells) + 0.5 - cells / 2) * cell_m
    right, up = np.meshgrid(along, -along)
    flat = mark.centre_site_m + np.column_stack([right.ravel(), up.ravel()]) @ axes[:2]
    origins = np.vstack([mark.centre_site_m, flat]) + _VIEW_DISTANCE_M * axes[2]
    hits = surface.cast(origins, np.broadcast_to(-axes[2], origins.shape))
    height = _VIEW_DISTANCE_M - hits.distance_m
    if not hits.hit[0] or abs(height[0]) > _MAX_SHIFT_M:
        return flat, np.broadcast_to(axes[2], flat.shape), np.zeros(3)
    height = np.where(hits.hit, height, height[0])[1:]
    normal = np.where(hits.hit[1:, None], hits.normal_site[1:], axes[2])
    return flat + height[:, None] * axes[2], normal, -float(_VIEW_DISTANCE_M - hits.distance_m[0]) * axes[2]


def _sample_colours(pixels: UInt8Image, xy: Float64Nx2, reduction: int) -> UInt8Image:
    """Colours (n, 3) of a photograph at pixels, from blocks of ``reduction`` by ``reduction`` pixels averaged."""
    first = np.maximum(np.floor(xy.min(axis=0)).astype(int) - reduction, 0)
    first -= first % reduction
    size = np.ceil((xy.max(axis=0) - first) / reduction).astype(int) + 1
    region = pixels[first[1] : first[1] + size[1] * reduction, first[0] : first[0] + size[0] * reduction]
    if reduction > 1:
        # Blocks cut by the photograph's border are completed with its last pixels.
        below, beside = -region.shape[0] % reduction, -region.shape[1] % reduction
        region = cv2.copyMakeBorder(region, 0, below, 0, beside, cv2.BORDER_REPLICATE).astype(np.uint8)
        size_px = (region.shape[1] // reduction, region.shape[0] // reduction)
        region = np.asarray(cv2.resize(region, size_px, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    colours: UInt8Image = np.clip(sample_bilinear(region, (xy - first) / reduction) + 0.5, 0, 255).astype(np.uint8)
    return colours
