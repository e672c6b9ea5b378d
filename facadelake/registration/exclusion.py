"""Detections that are not of the building: masked by a person, hidden behind something, or on what is no part of it.

Every exclusion is an outcome with its reason in words; no detection is dropped.
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
from facadelake.core.arrays import Float64Array
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
_NOT_IN_PICTURE = (ObservationOutcome.UNLOCALISED, ObservationOutcome.OUTSIDE)


@dataclass(frozen=True, kw_only=True)
class ExclusionSettings:
    """``masked_share_min``: a box of which this share is black in the photograph's mask is masked."""

    masked_share_min: float = 0.5
    occlusion: OcclusionSettings = field(default_factory=OcclusionSettings)

    def __post_init__(self) -> None:
        if not 0 < self.masked_share_min <= 1:
            raise InputDataError(f"masked_share_min is {self.masked_share_min}; it must lie in 0..1, above 0")


@dataclass(frozen=True, kw_only=True, eq=False)
class ExclusionEvidence:
    """What is known of the campaign beside its cameras: tie points, where it has any, and masks by photo_id.

    ``placement_sigma_m``: one sigma of where the campaign as a whole lies to the model.
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
    scene: ExclusionEvidence,
    settings: ExclusionSettings,
) -> pa.Table:
    """Table ``observations`` with those off target, masked or occluded that are, each with its reason, order kept.

    ``elements`` and ``surface`` are the building's. A mask outweighs what the ray met; an occluder is looked for only
    before what was placed on the building.
    """
    rows = observations.to_pylist()
    box_of = {
        row["detection_id"]: [row[f"box_{name}_px"] for name in ("x", "y", "width", "height")]
        for row in detections.select(
            ["detection_id", "box_x_px", "box_y_px", "box_width_px", "box_height_px"]
        ).to_pylist()
    }
    _exclude_off_building(rows, elements)
    by_photo: dict[str, list[Row]] = {}
    for row in rows:
        if row["observation_outcome"] not in _NOT_IN_PICTURE:
            by_photo.setdefault(row["photo_id"], []).append(row)
    occluders = None
    if scene.tie_points is not None:
        occluders = Occluders(
            scene.tie_points,
            posed,
            surface,
            placement_sigma_m=scene.placement_sigma_m,
            settings=settings.occlusion,
        )
    with report_progress("Looking for what stands before the building", len(by_photo)) as step:
        for photo_id, mine in sorted(by_photo.items()):
            boxes = np.array([box_of[row["detection_id"]] for row in mine], dtype=np.float64)
            if photo_id in scene.masks:
                _exclude_masked(mine, boxes, scene.masks[photo_id], posed[photo_id], settings.masked_share_min)
            if occluders is not None:
                _exclude_occluded(photo_id, mine, boxes, occluders, settings.occlusion.share_min)
            step.advance()
    _log.info("%s", Counter(str(row["observation_outcome"]) for row in rows))
    return table_from_rows("observations", rows)


def _exclude_off_building(rows: list[Row], elements: pa.Table) -> None:
    """What lies on an element that is no part of the building is off target."""
    beside = {
        row["element_guid"]: f"{row['ifc_class']} '{row['element_name'] or row['element_guid']}'"
        for row, target in zip(elements.to_pylist(), mask_target_elements(elements), strict=True)
        if not target
    }
    for row in rows:
        if row["observation_outcome"] in _ON_SURFACE and row["element_guid"] in beside:
            row["observation_outcome"] = str(ObservationOutcome.OFF_TARGET)
            row["reason"] = f"it lies on {beside[row['element_guid']]}, which is no part of the building"


def _exclude_masked(rows: list[Row], boxes: Float64Array, mask: Path, posed: PosedCamera, share_min: float) -> None:
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
    photo_id: str, rows: list[Row], boxes: Float64Array, occluders: Occluders, share_min: float
) -> None:
    placed = [i for i, row in enumerate(rows) if row["observation_outcome"] in _ON_SURFACE]
    if not placed:
        return
    hidden = occluders.measure_occlusion(photo_id, boxes[placed])
    for k, i in enumerate(placed):
        if hidden.share[k] >= share_min:
            rows[i]["observation_outcome"] = str(ObservationOutcome.OCCLUDED)
            rows[i]["occluder_gap_m"] = float(hidden.gap_m[k])
            rows[i]["reason"] = (
                f"tie points show something {hidden.gap_m[k]:.2f} m before the model in {hidden.share[k]:.0%} of the "
                f"box; the limits are {hidden.limit_m[k]:.2f} m and {share_min:.0%}"
            )
