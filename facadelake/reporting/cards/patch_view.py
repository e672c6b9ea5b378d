"""A defect's place on the facade seen square-on, true to scale: the photograph rectified onto the model's surface."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from facadelake.building.surface import Surface
from facadelake.core.arrays import BoolArray, Float64Array, UInt8Image
from facadelake.core.camera import PosedCamera
from facadelake.reporting.drawing.photograph import choose_reduction
from facadelake.reporting.elevations.marks import DefectMark, axes_from_normal
from facadelake.reporting.elevations.rectification import sample_bilinear
from facadelake.reporting.elevations.visibility import check_visibility, project_points

_LEAST_SIDE_M, _LARGEST_SIDE_M = 0.3, 8.0
_SIDE_FACTOR = 1.8  # the patch is this much wider than the defect
_BEFORE_M = 0.3  # the view begins so far before the surface: jambs and sills stay in it, balconies do not
_LARGEST_SHIFT_M = 0.3
_VISIBLE_M = 0.08
_FLATTEST_DEG = 88.0
_EMPTY = 225  # grey of what the photograph does not show


@dataclass(frozen=True, kw_only=True, eq=False)
class PatchView:
    """``picture`` (cells, cells, RGB) round a defect, ``cell_m`` a cell in both directions; ``shown`` (cells, cells).

    ``rings_m``: the defect's outlines (n, 2) from the picture's middle, metres to the right and up.
    """

    picture: UInt8Image
    shown: BoolArray
    cell_m: float
    rings_m: tuple[Float64Array, ...]

    @property
    def side_m(self) -> float:
        """Width and height of the picture."""
        return self.cell_m * int(self.picture.shape[1])


def choose_patch_side_m(mark: DefectMark) -> float:
    """Width and height of a defect's surroundings."""
    flat = (mark.corners_site_m - mark.centre_site_m) @ axes_from_normal(mark.normal_site)[:2].T
    return float(np.clip(2.0 * np.abs(flat).max() * _SIDE_FACTOR, _LEAST_SIDE_M, _LARGEST_SIDE_M))


def rectify_patch(
    mark: DefectMark, posed: PosedCamera, pixels: UInt8Image, surface: Surface, cells: int, pixel_m: float
) -> PatchView:
    """The surroundings of a defect, ``cells`` wide, from a photograph (RGB, full size).

    Each cell's ray along the defect's normal finds the model's surface; what stands before or behind it (a reveal, a
    sill) is thereby seen in its place. The surface is moved along the normal so that it holds the defect's position,
    which may have been triangulated off the model. ``pixel_m`` is the size of a pixel there.
    """
    axes = axes_from_normal(mark.normal_site)
    rings = tuple((ring - mark.centre_site_m) @ axes[:2].T for ring in mark.outlines_site_m)
    cell_m = choose_patch_side_m(mark) / cells
    xyz, normal, off = _cast_patch(mark, axes, surface, cell_m, cells)
    sight = check_visibility(posed, surface, xyz, normal, tolerance_m=_VISIBLE_M, max_incidence_deg=_FLATTEST_DEG)
    xy, inside = project_points(posed, xyz + off)
    shown = sight.visible & inside
    picture = np.full((cells * cells, 3), _EMPTY, dtype=np.uint8)
    if shown.any():
        picture[shown] = _sample_colours(pixels, xy[shown], choose_reduction(pixel_m, cell_m))
    return PatchView(
        picture=picture.reshape(cells, cells, 3), shown=shown.reshape(cells, cells), cell_m=cell_m, rings_m=rings
    )


def _cast_patch(
    mark: DefectMark, axes: Float64Array, surface: Surface, cell_m: float, cells: int
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Points and normals (cells * cells, 3) of the model's surface, from the top left, and the defect's shift (3,) off
    it; the defect's plane where there is no surface.

    A surface more than ``_LARGEST_SHIFT_M`` off the defect's position is none of its own: the plane stands in.
    """
    along = (np.arange(cells) + 0.5 - cells / 2) * cell_m
    right, up = np.meshgrid(along, -along)
    flat = mark.centre_site_m + np.column_stack([right.ravel(), up.ravel()]) @ axes[:2]
    origins = np.vstack([mark.centre_site_m, flat]) + _BEFORE_M * axes[2]
    hits = surface.cast(origins, np.broadcast_to(-axes[2], origins.shape))
    height = _BEFORE_M - hits.distance_m
    if not hits.hit[0] or abs(height[0]) > _LARGEST_SHIFT_M:
        return flat, np.broadcast_to(axes[2], flat.shape), np.zeros(3)
    height = np.where(hits.hit, height, height[0])[1:]
    normal = np.where(hits.hit[1:, None], hits.normal_site[1:], axes[2])
    return flat + height[:, None] * axes[2], normal, -float(_BEFORE_M - hits.distance_m[0]) * axes[2]


def _sample_colours(pixels: UInt8Image, xy: Float64Array, reduction: int) -> UInt8Image:
    """Colours (n, 3) of a photograph at pixels (n, 2), averaged over ``reduction`` squared of them."""
    first = np.maximum(np.floor(xy.min(axis=0)).astype(int) - reduction, 0)
    first -= first % reduction
    size = np.ceil((xy.max(axis=0) - first) / reduction).astype(int) + 1
    piece = pixels[first[1] : first[1] + size[1] * reduction, first[0] : first[0] + size[0] * reduction]
    if reduction > 1:
        # The last row and column may be cut short by the photograph's border; they are filled up by its last pixels.
        below, beside = -piece.shape[0] % reduction, -piece.shape[1] % reduction
        piece = cv2.copyMakeBorder(piece, 0, below, 0, beside, cv2.BORDER_REPLICATE).astype(np.uint8)
        half = (piece.shape[1] // reduction, piece.shape[0] // reduction)
        piece = np.asarray(cv2.resize(piece, half, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    colours: UInt8Image = np.clip(sample_bilinear(piece, (xy - first) / reduction) + 0.5, 0, 255).astype(np.uint8)
    return colours
