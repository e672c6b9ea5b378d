"""How small a defect a campaign's detector finds, in pixels, and in which photographs it searched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64N
from facadelake.registry import RecallBySize

RECALL = 0.9  # the smallest defect is the one that is found with this probability


@dataclass(frozen=True, kw_only=True)
class DetectorReach:
    """The reach of a detector, or of the person who drew boxes.

    ``searched``: photo_ids of the photographs that it processed. ``crack_width_px``, ``patch_px``: the smallest width
    of a crack, and root of the area of a patch, found with 90 % probability; None: unknown or never. ``input_gsd_mm``:
    GSD to which photographs are resampled for it at the finest; None: they are processed as they are.
    """

    searched: frozenset[str]
    crack_width_px: float | None = None
    patch_px: float | None = None
    input_gsd_mm: float | None = None

    def compute_crack_width_mm(self, pixel_mm: Float64N) -> Float64N:
        """The smallest crack width (n,) found where a pixel has the size ``pixel_mm`` (n,); NaN where unknown."""
        return self._scale(self.crack_width_px, pixel_mm)

    def compute_patch_mm(self, pixel_mm: Float64N) -> Float64N:
        """The root of the area (n,) of the smallest patch found at pixels of ``pixel_mm`` (n,); NaN where unknown."""
        return self._scale(self.patch_px, pixel_mm)

    def _scale(self, size_px: float | None, pixel_mm: Float64N) -> Float64N:
        size: Float64N = np.full(len(pixel_mm), np.nan)
        if size_px is not None:
            size = size_px * np.maximum(pixel_mm, self.input_gsd_mm or 0.0)
        return size


def resolve_reach(
    recall: RecallBySize | None, searched: frozenset[str], input_gsd_mm: Sequence[float] = ()
) -> DetectorReach:
    """The reach from a declared recall by size.

    Args:
        recall: recall by size in pixels; None: unknown.
        searched: photo_ids of the photographs that were processed.
        input_gsd_mm: the scales of a detector's input, millimetres per pixel; empty: photographs as they are.
    """
    return DetectorReach(
        searched=searched,
        crack_width_px=None if recall is None else find_size_px(recall.crack_width_px),
        patch_px=None if recall is None else find_size_px(recall.patch_px),
        input_gsd_mm=min(input_gsd_mm, default=None),
    )


def find_size_px(recall: Sequence[tuple[float, float]]) -> float | None:
    """The size from which on the recall is at least 0.9, interpolated between the pairs (size in pixels, recall).

    A size that is found is not smaller than one that is not, although measured recalls fluctuate. None where the
    largest size is not found, or nothing is declared; beyond the smallest pair nothing is extrapolated.
    """
    size: float | None = None
    above: tuple[float, float] | None = None
    for here, found in reversed(recall):
        if found < RECALL:
            if above is not None:
                size = here + (RECALL - found) / (above[1] - found) * (above[0] - here)
            break
        size, above = here, (here, found)
    return size
