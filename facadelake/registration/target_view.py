"""Where a photograph shows the building, and how fine: what a detector is told before it looks."""

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

WITHOUT_POSE = "the photograph has no pose: it was looked at everywhere, at its own pixels"
_WIDTH_PX = 480  # of the target image: a tile of the smallest detectors is 20 of its pixels in a photograph of 48 Mpx
_MARGIN = 0.02  # of the width: how far a building may stand beside its model in the photograph


@dataclass(frozen=True, kw_only=True, eq=False)
class TargetView:
    """``target`` (h, w), reduced: true where the photograph shows the building and no mask of the user's is black.

    ``gsd_mm``: the median of what a pixel of the photograph measures across the line of sight, over the building; NaN
    where the photograph does not show it.
    """

    target: BoolArray
    gsd_mm: float


def render_target_view(
    posed: PosedCamera, surface: Surface, elements: pa.Table, mask: Path | None = None
) -> TargetView:
    """What a photograph taken at ``posed`` shows of the building, whose ``elements`` the surface's triangles are.

    ``mask`` is the user's own, if there is one; one that cannot be used is left out with a warning.
    """
    camera = posed.camera
    depth, element = surface.render_depth(posed, min(1.0, _WIDTH_PX / camera.width_px))
    shown = np.append(mask_target_elements(elements), False)[element]  # the last answers for a miss
    gsd_mm = float(np.median(depth[shown])) / camera.fx_px * 1000 if shown.any() else float("nan")
    reach = max(1, round(_MARGIN * shown.shape[1]))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    target = cv2.dilate(shown.astype(np.uint8), kernel) > 0
    if mask is not None:
        try:
            black = read_mask(mask, camera).astype(np.float32)
            target &= cv2.resize(black, target.shape[::-1], interpolation=cv2.INTER_AREA) < 1.0
        except InputDataError as error:
            _log.warning("%s; the mask is not used", error)
    return TargetView(target=target, gsd_mm=gsd_mm)


def prepare_building_views(
    building: BuildingModel, poses: pa.Table, masks: Mapping[str, Path]
) -> Callable[[str], SearchRegion]:
    """What is known of each photograph, by its photo_id, from table ``poses`` and the user's masks."""
    posed, surface = read_posed_cameras(poses), Surface(building)

    def find_region(photo_id: str) -> SearchRegion:
        if photo_id not in posed:
            return SearchRegion(remark=WITHOUT_POSE)
        seen = render_target_view(posed[photo_id], surface, building.elements, masks.get(photo_id))
        # A surface made of tie points has holes where a wall is bare.
        target = None if building.surface_kind is SurfaceKind.AS_BUILT else seen.target
        return SearchRegion(gsd_mm=None if math.isnan(seen.gsd_mm) else seen.gsd_mm, target=target)

    return find_region
