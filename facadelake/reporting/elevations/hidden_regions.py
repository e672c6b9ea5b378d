"""The parts of an elevation that something hides, with their extents."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from facadelake.core.arrays import BoolArray
from facadelake.reporting.elevations.relief import FacadeRelief

_LISTED_MIN_M2 = 0.1


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
