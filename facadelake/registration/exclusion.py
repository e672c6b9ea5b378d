"""Exclusion of detections that are not of the building: masked, occluded, or on an element that is not part of it.

Every exclusion is an outcome with its reason; no detection is dropped.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.building import mask_target_elements
from facadelake.building.surface import Surface
from facadelake.core.arrays import Float64Nx4
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.progress import report_progress
from facadelake.core.tables import table_from_rows
from facadelake.registration.exclusion_mask import compute_masked_shares
from facadelake.registration.occlusion import Occluders, OcclusionSettings
from facadelake.registration.tie_points import TiePoints
from schemas.vocabulary import ObservationOutcome

_log = logging.getLogger(__name__)
Row = dict[str, Any]

_ON_SURFACE = (ObservationOutcome.REGISTERED, ObservationOutcome.GRAZING)
_NOT_IN_PHOTOGRAPH = (ObservationOutcome.UNLOCALISED, ObservationOutcome.OUTSIDE)


@dataclass(frozen=True, kw_only=True)
class ExclusionSettings:
    """``masked_share_min``: share of a box that is black in the exclusion mask, from which it is masked."""

    masked_share_min: float = 0.5
    occlusion: OcclusionSettings = field(default_factory=OcclusionSettings)

    def __post_init__(self) -> None:
        if not 0 < self.masked_share_min <= 1:
            raise InputDataError(f"masked_share_min is {self.masked_share_min}; it must be in (0, 1]")


@dataclass(frozen=True, kw_only=True, eq=False)
class ExclusionEvidence:
    """What excludes detections of a campaign: tie points, where it has any, and exclusion masks by photo_id.

    ``placement_sigma_m``: one sigma of the campaign's position relative to the model.
    """

    tie_points: TiePoints | None = None
    masks: Mapping[str, Path] = field(default_factory=dict)
    placement_sigma_m: float = 0.0


def exclude_observations(
    observations: pa.Table,
    detections: pa.Table,
    posed: Mapping[str, PosedCamera],
    elements: pa.Table,
    surface: Surface,
    evidence: ExclusionEvidence,
    settings: ExclusionSettings,
) -> pa.Table:
    """Table ``observations`` with the outcomes of excluded detections, each with its reason; the order is kept.

    A mask overrides every other outcome of a detection that is inside its photograph. Occlusion is tested only for
    detections on the building.

    Args:
        observations: table ``observations``.
        detections: table ``detections``, for the boxes.
        posed: cameras of the localised photographs by photo_id.
        elements: table ``elements`` of the building.
        surface: the building's surface.
        evidence: tie points, masks and the placement of the campaign.
        settings: limits of masks and occlusion.
    """
    rows = observations.to_pylist()
    box_by_detection = {
        row["detection_id"]: [row[f"box_{name}_px"] for name in ("x", "y", "width", "height")]
        for row in detections.select(
            ["detection_id", "box_x_px", "box_y_px", "box_width_px", "box_height_px"]
        ).to_pylist()
    }
    _exclude_off_building(rows, elements)
    by_photo: dict[str, list[Row]] = {}
    for row in rows:
        if row["observation_outcome"] not in _NOT_IN_PHOTOGRAPH:
            by_photo.setdefault(row["photo_id"], []).append(row)
    occluders = None
    if evidence.tie_points is not None:
        occluders = Occluders(
            evidence.tie_points,
            posed,
            surface,
            placement_sigma_m=evidence.placement_sigma_m,
            settings=settings.occlusion,
        )
    with report_progress("Checking masks and occlusion", len(by_photo)) as step:
        for photo_id, photo_rows in sorted(by_photo.items()):
            boxes = np.array([box_by_detection[row["detection_id"]] for row in photo_rows], dtype=np.float64)
            if photo_id in evidence.masks:
                _exclude_masked(photo_rows, boxes, evidence.masks[photo_id], posed[photo_id], settings.masked_share_min)
            if occluders is not None:
                _exclude_occluded(photo_id, photo_rows, boxes, occluders, settings.occlusion.share_min)
            step.advance()
    _log.info("outcomes after exclusion: %s", Counter(str(row["observation_outcome"]) for row in rows))
    return table_from_rows("observations", rows)


def _exclude_off_building(rows: list[Row], elements: pa.Table) -> None:
    """What lies on an element that is not part of the building is off target."""
    non_target = {
        row["element_guid"]: f"{row['ifc_class']} '{row['element_name'] or row['element_guid']}'"
        for row, target in zip(elements.to_pylist(), mask_target_elements(elements), strict=True)
        if not target
    }
    for row in rows:
        if row["observation_outcome"] in _ON_SURFACE and row["element_guid"] in non_target:
            row["observation_outcome"] = str(ObservationOutcome.OFF_TARGET)
            row["reason"] = f"it lies on {non_target[row['element_guid']]}, which is not part of the building"


def _exclude_masked(rows: list[Row], boxes: Float64Nx4, mask: Path, posed: PosedCamera, share_min: float) -> None:
    """Set the outcome of the rows of one photograph that its exclusion mask covers; an unusable mask is logged.

    Args:
        rows: rows of table ``observations``; changed in place.
        boxes: their boxes (n, 4): x, y, width, height in pixels.
        mask: file of the exclusion mask.
        posed: the photograph's camera.
        share_min: share of a box that must be black.
    """
    try:
        shares = compute_masked_shares(mask, posed.camera, boxes)
    except InputDataError as error:
        _log.warning("%s; the mask is not used", error)
        return
    for row, share in zip(rows, shares, strict=True):
        if share >= share_min:
            row["observation_outcome"] = str(ObservationOutcome.MASKED)
            row["reason"] = f"{share:.0%} of the box is black in the mask {mask.name}; the limit is {share_min:.0%}"


def _exclude_occluded(
    photo_id: str, rows: list[Row], boxes: Float64Nx4, occluders: Occluders, share_min: float
) -> None:
    """Set the outcome of the rows of one photograph that are occluded.

    Args:
        photo_id: the photograph.
        rows: rows of table ``observations``; changed in place.
        boxes: their boxes (n, 4): x, y, width, height in pixels.
        occluders: the campaign's tie points in front of the model.
        share_min: share of a box that must be occluded.
    """
    on_surface = [i for i, row in enumerate(rows) if row["observation_outcome"] in _ON_SURFACE]
    if not on_surface:
        return
    occlusion = occluders.measure_occlusion(photo_id, boxes[on_surface])
    for k, i in enumerate(on_surface):
        if occlusion.occluded[k]:
            rows[i]["observation_outcome"] = str(ObservationOutcome.OCCLUDED)
            rows[i]["occluder_gap_m"] = float(occlusion.gap_m[k])
            rows[i]["reason"] = (
                f"tie points lie {occlusion.gap_m[k]:.2f} m in front of the model in {occlusion.share[k]:.0%} of the "
                f"box; the limits are {occlusion.limit_m[k]:.2f} m and {share_min:.0%}"
            )
