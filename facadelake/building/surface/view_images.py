"""Render depth, element and target mask of the model in a photograph's pixels.

The images coincide with the photograph, including lens distortion, at a fraction of its size. On disk they are one
NumPy archive ``NAME.npz``: ``depth_m`` float32, along the camera's z, inf where there is no surface; ``element`` int32,
row of the legend, -1 where there is none; ``target`` bool; and the columns ``element_guid``, ``ifc_class``,
``element_name`` and ``storey`` of the legend.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from facadelake.building.model import mask_target_elements
from facadelake.building.surface.raycasting import Surface
from facadelake.core.arrays import BoolArray, Float32Array
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError

_LEGEND = ("element_guid", "ifc_class", "element_name", "storey")


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewImages:
    """Images (h, w) ``depth_m``, ``element`` and ``target``.

    ``legend`` has one row per element with the columns element_guid, ifc_class, element_name, storey.
    """

    depth_m: Float32Array
    element: NDArray[np.int32]
    target: BoolArray
    legend: pa.Table

    def save(self, path: Path) -> None:
        """Write the archive ``path``, whose suffix is .npz."""
        guid, kind, name, storey = (
            np.array([value or "" for value in self.legend.column(column).to_pylist()]) for column in _LEGEND
        )
        np.savez_compressed(
            path,
            depth_m=self.depth_m,
            element=self.element,
            target=self.target,
            element_guid=guid,
            ifc_class=kind,
            element_name=name,
            storey=storey,
        )


def render_view_images(posed: PosedCamera, surface: Surface, elements: pa.Table, scale: float) -> ViewImages:
    """Render the images by a ray through the centre of each pixel.

    Args:
        posed: the photograph's camera.
        surface: the model's surface.
        elements: table ``elements``, whose rows the surface's triangles refer to.
        scale: size of the images relative to the photograph, above 0 and at most 1.

    Returns:
        The images.

    Raises:
        InputDataError: ``scale`` is out of range.
    """
    if not 0 < scale <= 1:
        raise InputDataError(f"the scale of view images is {scale}; it must be above 0 and at most 1")
    depth, element = surface.render_depth(posed, scale)
    is_target = np.append(mask_target_elements(elements), False)  # the last entry is for MISS (-1)
    return ViewImages(
        depth_m=depth.astype(np.float32),
        element=element.astype(np.int32),
        target=is_target[element],
        legend=elements.select(list(_LEGEND)),
    )
