"""What a photograph shows of the model, pixel by pixel: depth, element, and whether it is the building at all.

The images lie pixel on pixel over the photograph, lens distortion kept, at a fraction of its size. On disk they are
one NumPy archive ``NAME.npz``: ``depth_m`` float32, along the camera's z, inf where no surface is; ``element`` int32,
row of the legend, -1 where none is; ``target`` bool; and the legend's ``element_guid``, ``ifc_class``,
``element_name`` and ``storey``, row by row.
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
    """Images (h, w): ``depth_m`` float32, ``element`` int32 and ``target``; ``legend`` has a row an element, of columns
    element_guid, ifc_class, element_name, storey."""

    depth_m: Float32Array
    element: NDArray[np.int32]
    target: BoolArray
    legend: pa.Table

    def save(self, path: Path) -> None:
        """Write the archive ``path``, whose suffix is .npz."""
        guid, kind, name, storey = (
            np.array([word or "" for word in self.legend.column(column).to_pylist()]) for column in _LEGEND
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
    """The images at ``scale`` (0 to 1) times the photograph's size, by a ray through each pixel's centre.

    ``elements`` is the table whose rows the surface's triangles belong to.
    """
    if not 0 < scale <= 1:
        raise InputDataError(f"the scale of a view is {scale}; it must be above 0 and at most 1")
    depth, element = surface.render_depth(posed, scale)
    is_target = np.append(mask_target_elements(elements), False)  # the last answers for MISS
    return ViewImages(
        depth_m=depth.astype(np.float32),
        element=element.astype(np.int32),
        target=is_target[element],
        legend=elements.select(list(_LEGEND)),
    )


def read_view_images(path: Path) -> ViewImages:
    """What ``ViewImages.save`` wrote; raises InputDataError where ``path`` is no such archive."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            depth, element, target = archive["depth_m"], archive["element"], archive["target"]
            legend = pa.table({name: archive[name].tolist() for name in _LEGEND})
    except (OSError, ValueError, KeyError) as error:
        raise InputDataError(f"{path} holds no images of a view ({error}); make it anew") from error
    return ViewImages(depth_m=depth, element=element, target=target, legend=legend)
