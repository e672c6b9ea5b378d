"""One row a view: does the as-built surface look like the building model from there?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.building.surface import Surface
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.progress import track
from facadelake.core.tables import table_from_rows
from facadelake.integrity.depth import DepthComparison, compare_depth
from schemas.vocabulary import IntegrityOutcome


@dataclass(frozen=True, kw_only=True)
class IntegritySettings:
    """``width_px``: depth images are made this wide. A view counts only if the model fills ``model_share_min`` of it,
    the as-built surface covers ``compared_share_min`` of that, and ``windows_min`` SSIM windows are whole.
    """

    width_px: int = 480
    model_share_min: float = 0.02
    compared_share_min: float = 0.1
    windows_min: int = 200

    def __post_init__(self) -> None:
        if self.width_px < 32 or not (0 <= self.model_share_min <= 1 and 0 <= self.compared_share_min <= 1):
            raise InputDataError(f"integrity settings {self} are out of range: width_px from 32, shares 0..1")


def compare_views(
    posed: Mapping[str, PosedCamera],
    surface: Surface,
    as_built: Surface,
    settings: IntegritySettings | None = None,
) -> pa.Table:
    """Table ``integrity_views``: one row each localised photograph of ``posed`` (by photo_id)."""
    settings = settings or IntegritySettings()
    rows = []
    for photo_id in track(sorted(posed), label="Checking the model", total=len(posed)):
        camera = posed[photo_id]
        scale = min(1.0, settings.width_px / camera.camera.width_px)
        model, _ = surface.render_depth(camera, scale)
        built, _ = as_built.render_depth(camera, scale)
        seen = float(np.isfinite(model).mean())
        rows.append(_build_row(photo_id, seen, compare_depth(model, built), settings))
    return table_from_rows("integrity_views", rows)


def record_uncompared_views(
    posed: Mapping[str, PosedCamera],
    reason: str,
    outcome: IntegrityOutcome = IntegrityOutcome.TOO_LITTLE_SURFACE,
) -> pa.Table:
    """Table ``integrity_views`` where model or as-built surface is missing: each view says why it was not compared."""
    return table_from_rows(
        "integrity_views",
        [
            {"photo_id": photo_id, "compared_share": 0.0, "integrity_outcome": str(outcome), "reason": reason}
            for photo_id in sorted(posed)
        ],
    )


def _build_row(photo_id: str, seen: float, found: DepthComparison, settings: IntegritySettings) -> dict[str, Any]:
    reason = _check_coverage(seen, found, settings)
    row: dict[str, Any] = {"photo_id": photo_id, "compared_share": found.compared_share}
    if reason:
        return {**row, "integrity_outcome": str(IntegrityOutcome.TOO_LITTLE_SURFACE), "reason": reason}
    return {
        **row,
        "integrity_outcome": str(IntegrityOutcome.COMPARED),
        "ssim": found.ssim,
        "depth_difference_median_m": found.difference_median_m,
        "depth_difference_p95_m": found.difference_p95_m,
    }


def _check_coverage(seen: float, found: DepthComparison, settings: IntegritySettings) -> str:
    """Why a view cannot be compared; empty where it can."""
    if seen < settings.model_share_min:
        return f"the model fills {seen:.1%} of the view, less than {settings.model_share_min:.0%}"
    if found.compared_share < settings.compared_share_min:
        return (
            f"the as-built surface covers {found.compared_share:.1%} of the model in the view, "
            f"less than {settings.compared_share_min:.0%}"
        )
    if found.windows < settings.windows_min:
        return f"only {found.windows} whole windows of {settings.windows_min} needed: the common surface is in shreds"
    return ""
