"""Comparison of as-built surface and building model from the poses of the photographs, one row per view."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from facadelake.building.surface import Surface
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.progress import track
from facadelake.core.tables import Row, table_from_rows
from facadelake.integrity.depth import DepthComparison, compare_depth
from schemas.vocabulary import IntegrityOutcome


@dataclass(frozen=True, kw_only=True)
class IntegritySettings:
    """Settings of the comparison.

    ``width_px``: width of the depth images. A view is compared only if the model covers ``model_share_min`` of it, the
    as-built surface covers ``compared_share_min`` of that, and ``windows_min`` SSIM windows are complete.
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
    """Compare the as-built surface with the building model in the view of each localised photograph.

    Args:
        posed: cameras of the localised photographs by photo_id.
        surface: surface of the building model.
        as_built: surface of the tie points of the campaign.
        settings: settings of the comparison; None: the defaults.

    Returns:
        Table ``integrity_views``, one row per photograph.
    """
    settings = settings or IntegritySettings()
    rows = []
    for photo_id in track(sorted(posed), label="Comparing depth images", total=len(posed)):
        camera = posed[photo_id]
        scale = min(1.0, settings.width_px / camera.camera.width_px)
        model, _ = surface.render_depth(camera, scale)
        built, _ = as_built.render_depth(camera, scale)
        model_share = float(np.isfinite(model).mean())
        rows.append(_build_row(photo_id, model_share, compare_depth(model, built), settings))
    return table_from_rows("integrity_views", rows)


def record_uncompared_views(
    posed: Mapping[str, PosedCamera],
    reason: str,
    outcome: IntegrityOutcome = IntegrityOutcome.TOO_LITTLE_SURFACE,
) -> pa.Table:
    """Table ``integrity_views`` where the model or the as-built surface is missing, with the reason in each row."""
    return table_from_rows(
        "integrity_views",
        [
            {"photo_id": photo_id, "compared_share": 0.0, "integrity_outcome": str(outcome), "reason": reason}
            for photo_id in sorted(posed)
        ],
    )


def _build_row(photo_id: str, model_share: float, comparison: DepthComparison, settings: IntegritySettings) -> Row:
    reason = _check_coverage(model_share, comparison, settings)
    row: Row = {"photo_id": photo_id, "compared_share": comparison.compared_share}
    if reason:
        return {**row, "integrity_outcome": str(IntegrityOutcome.TOO_LITTLE_SURFACE), "reason": reason}
    return {
        **row,
        "integrity_outcome": str(IntegrityOutcome.COMPARED),
        "ssim": comparison.ssim,
        "depth_difference_median_m": comparison.difference_median_m,
        "depth_difference_p95_m": comparison.difference_p95_m,
    }


def _check_coverage(model_share: float, comparison: DepthComparison, settings: IntegritySettings) -> str:
    """Why a view cannot be compared; empty where it can."""
    if model_share < settings.model_share_min:
        return f"the model covers {model_share:.1%} of the view, less than {settings.model_share_min:.0%}"
    if comparison.compared_share < settings.compared_share_min:
        return (
            f"the as-built surface covers {comparison.compared_share:.1%} of the model in the view, "
            f"less than {settings.compared_share_min:.0%}"
        )
    if comparison.windows < settings.windows_min:
        return (
            f"only {comparison.windows} complete SSIM windows, {settings.windows_min} are needed: "
            "the common surface is fragmented"
        )
    return ""
