"""Where a photograph shows the building, and at which GSD: input of the detector."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa

from facadelake.building import BuildingModel, mask_target_elements
from facadelake.building.surface import Surface
from facadelake.core.arrays import BoolArray
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.pose_table import read_posed_cameras
from facadelake.detection import SearchRegion
from facadelake.registration.exclusion_mask import read_mask
from schemas.vocabulary import SurfaceKind

_log = logging.getLogger(__name__)

WITHOUT_POSE = "the photograph has no pose: the whole photograph was processed, at its own resolution"
_WIDTH_PX = 480  # of the target image: the smallest tile of a photograph of 48 Mpx is 20 of its pixels
_MARGIN = 0.02  # of the width: how far the building may be from its model in the photograph


@dataclass(frozen=True, kw_only=True, eq=False)
class TargetView:
    """Where a photograph shows the building.

    ``target`` (h, w), reduced in size: true where the photograph shows the building and its exclusion mask is not
    black. ``gsd_mm``: median size of a pixel over the building, perpendicular to the line of sight; NaN where the
    photograph does not show it.
    """

    target: BoolArray
    gsd_mm: float


def render_target_view(
    posed: PosedCamera, surface: Surface, elements: pa.Table, mask: Path | None = None
) -> TargetView:
    """Where a photograph shows the building.

    Args:
        posed: the photograph's camera.
        surface: the building's surface.
        elements: table ``elements``, the rows that the surface's triangles refer to.
        mask: the photograph's exclusion mask, if there is one; an unusable one is logged and not used.
    """
    camera = posed.camera
    depth, element = surface.render_depth(posed, min(1.0, _WIDTH_PX / camera.width_px))
    is_target = np.append(mask_target_elements(elements), False)[element]  # the last entry stands for a miss
    gsd_mm = float(np.median(depth[is_target])) / camera.fx_px * 1000 if is_target.any() else float("nan")
    margin_px = max(1, round(_MARGIN * is_target.shape[1]))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * margin_px + 1, 2 * margin_px + 1))
    target = cv2.dilate(is_target.astype(np.uint8), kernel) > 0
    if mask is not None:
        try:
            black = read_mask(mask, camera).astype(np.float32)
            target &= cv2.resize(black, target.shape[::-1], interpolation=cv2.INTER_AREA) < 1.0
        except InputDataError as error:
            _log.warning("%s; the mask is not used", error)
    return TargetView(target=target, gsd_mm=gsd_mm)


def prepare_search_regions(
    building: BuildingModel, poses: pa.Table, masks: Mapping[str, Path]
) -> Callable[[str], SearchRegion]:
    """A function that returns the search region of a photograph by its photo_id.

    ``poses`` is table ``poses``; ``masks`` are exclusion masks by photo_id.
    """
    posed, surface = read_posed_cameras(poses), Surface(building)

    def find_region(photo_id: str) -> SearchRegion:
        if photo_id not in posed:
            return SearchRegion(remark=WITHOUT_POSE)
        view = render_target_view(posed[photo_id], surface, building.elements, masks.get(photo_id))
        # The as-built surface has holes where a wall has no texture, so it cannot limit the search.
        target = None if building.surface_kind is SurfaceKind.AS_BUILT else view.target
        return SearchRegion(gsd_mm=None if math.isnan(view.gsd_mm) else view.gsd_mm, target=target)

    return find_region
