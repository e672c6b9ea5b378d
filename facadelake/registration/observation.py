"""Detections to observations: position on the surface, covariance, element and outcome of each box or mask.

The paper's Algorithm 1 converts pixels to metres by one depth per photograph (``2 z tan(FOV/2) l / l_D``), which is
exact only for a plane seen square-on; here the ray of each sample intersects the surface.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.building import BuildingModel
from facadelake.building.surface import Surface
from facadelake.core.arrays import Float64Nx3x3, Float64x6x6, RowIndices
from facadelake.core.camera import PosedCamera
from facadelake.core.progress import report_progress
from facadelake.core.tables import table_from_rows
from facadelake.registration.attribution import ElementAttribution
from facadelake.registration.observation_columns import ObservationColumns
from facadelake.registration.raycast import RaycastBatch, cast_detections
from facadelake.registration.rays import compute_ray_covariance, compute_surface_covariance
from facadelake.registration.settings import RegistrationSettings
from schemas.vocabulary import DetectionOutcome, ObservationOutcome

_log = logging.getLogger(__name__)
Row = dict[str, Any]
_NO_COVARIANCE: Mapping[str, Float64x6x6] = {}


@dataclass(frozen=True, kw_only=True)
class OutcomeDecision:
    """Outcome of a detection, and its reason in words (None where it is registered)."""

    outcome: ObservationOutcome
    reason: str | None = None


def observe_detections(
    detections: pa.Table,
    posed: Mapping[str, PosedCamera],
    building: BuildingModel,
    surface: Surface,
    settings: RegistrationSettings,
    covariances: Mapping[str, Float64x6x6] = _NO_COVARIANCE,
) -> pa.Table:
    """Table ``observations``: one row per accepted detection, with its outcome.

    Args:
        detections: table ``detections``.
        posed: cameras of the localised photographs by photo_id.
        building: the building's elements, storeys and frames. Where its surface was measured (as built), its
            ``surface_sigma_m`` replaces ``settings.model_sigma_m``.
        surface: the building's surface.
        settings: sampling, limits and sigmas.
        covariances: covariances (6, 6) of poses by photo_id, as ``facadelake.core.pose_table.read_pose_covariances``
            gives them; a pose without one counts as exact.

    Returns:
        Rows in the order of detection_id; column ``defect_id`` is empty until the observations are merged.
    """
    if building.surface_sigma_m is not None:
        settings = replace(settings, model_sigma_m=building.surface_sigma_m)
    accepted = [row for row in detections.to_pylist() if row["detection_outcome"] == DetectionOutcome.ACCEPTED]
    rows: list[Row] = []
    castable: list[Row] = []
    for row in accepted:
        decision = _decide_without_ray(row, posed)
        if decision is None:
            castable.append(row)
        else:
            rows.append(_build_row(row, decision, 0.0))
    castable.sort(key=lambda row: (row["photo_id"], row["detection_id"]))
    columns = ObservationColumns(building, ElementAttribution(building, settings.model_sigma_m))
    with report_progress("Registering detections", len(castable)) as step:
        for start in range(0, len(castable), settings.detections_per_cast):
            batch = cast_detections(castable[start : start + settings.detections_per_cast], posed, surface, settings)
            rows.extend(_build_rows(batch, assign_outcomes(batch, settings), columns, settings, covariances))
            step.advance(len(batch.detections))
    rows.sort(key=lambda row: str(row["detection_id"]))
    counts = {
        str(outcome): sum(row["observation_outcome"] == outcome for row in rows) for outcome in ObservationOutcome
    }
    _log.info("registered %d detections: %s", len(rows), counts)
    return table_from_rows("observations", rows)


def assign_outcomes(batch: RaycastBatch, settings: RegistrationSettings) -> list[OutcomeDecision]:
    """Outcome of each detection, by the share of its rays that hit the building and by the incidence."""
    decisions = []
    for target_share, incidence_deg in zip(batch.patches.target_share, batch.patches.incidence_deg, strict=True):
        if target_share < settings.target_share_min or not np.isfinite(incidence_deg):
            reason = f"{target_share:.1%} of the rays hit the building; the limit is {settings.target_share_min:.0%}"
            decisions.append(OutcomeDecision(outcome=ObservationOutcome.OFF_TARGET, reason=reason))
        elif incidence_deg > settings.grazing_above_deg:
            reason = f"the incidence is {incidence_deg:.1f} deg; the limit is {settings.grazing_above_deg:g} deg"
            decisions.append(OutcomeDecision(outcome=ObservationOutcome.GRAZING, reason=reason))
        else:
            decisions.append(OutcomeDecision(outcome=ObservationOutcome.REGISTERED))
    return decisions


def _decide_without_ray(row: Row, posed: Mapping[str, PosedCamera]) -> OutcomeDecision | None:
    """The outcome of a detection that has no ray (no pose, no area, centre outside); None where it has one."""
    camera = posed.get(row["photo_id"])
    if camera is None:
        reason = "the photograph has no measured pose; see table poses"
        return OutcomeDecision(outcome=ObservationOutcome.UNLOCALISED, reason=reason)
    if not (row["box_width_px"] > 0 and row["box_height_px"] > 0):
        reason = f"the box of {row['box_width_px']:g} x {row['box_height_px']:g} px has no area"
        return OutcomeDecision(outcome=ObservationOutcome.OUTSIDE, reason=reason)
    x, y = row["box_x_px"] + row["box_width_px"] / 2, row["box_y_px"] + row["box_height_px"] / 2
    if camera.camera.is_inside(np.array([[x, y]]))[0]:
        return None
    size = f"{camera.camera.width_px} x {camera.camera.height_px} px"
    reason = f"the box's centre at ({x:.1f}, {y:.1f}) px is outside the photograph of {size}"
    return OutcomeDecision(outcome=ObservationOutcome.OUTSIDE, reason=reason)


def _build_row(detection: Row, decision: OutcomeDecision, target_share: float, **values: Any) -> Row:
    """A row of table ``observations``: keys of the detection, its outcome, and the columns ``values``."""
    identity = {name: detection[name] for name in ("detection_id", "photo_id", "defect_class")}
    outcome = {"observation_outcome": str(decision.outcome), "reason": decision.reason}
    return {**identity, **outcome, "target_share": target_share, **values}


def _build_rows(
    batch: RaycastBatch,
    decisions: Sequence[OutcomeDecision],
    columns: ObservationColumns,
    settings: RegistrationSettings,
    covariances: Mapping[str, Float64x6x6],
) -> list[Row]:
    """Rows of the detections of a batch; those that hit the building have a position.

    Args:
        batch: the detections on the surface.
        decisions: outcome of each.
        columns: builds the columns of a position.
        settings: sigmas of pixel, box and model.
        covariances: covariances (6, 6) of poses by photo_id.
    """
    shares = batch.patches.target_share
    kept = np.array(
        [i for i, decision in enumerate(decisions) if decision.outcome is not ObservationOutcome.OFF_TARGET],
        dtype=np.int64,
    )
    position_values: list[Row] = [{} for _ in decisions]
    if len(kept):
        covariance = compute_position_covariance(batch, kept, settings, covariances)
        column_values = columns.build(batch, kept, covariance)
        for number, index in enumerate(kept.tolist()):
            position_values[index] = {name: values[number] for name, values in column_values.items()}
    return [
        _build_row(row, decision, float(share), **position)
        for row, decision, share, position in zip(batch.detections, decisions, shares, position_values, strict=True)
    ]


def compute_position_covariance(
    batch: RaycastBatch, kept: RowIndices, settings: RegistrationSettings, covariances: Mapping[str, Float64x6x6]
) -> Float64Nx3x3:
    """Covariance of the positions of detections, due to rays and surface.

    Args:
        batch: the detections (n) on the surface.
        kept: rows (m,) of the detections, all of which hit the building.
        settings: sigmas of pixel, box and model.
        covariances: covariances (6, 6) of poses by photo_id; a pose without one counts as exact.

    Returns:
        Covariances (m, 3, 3) in m2, in site.
    """
    patches = batch.patches
    direction, normal = patches.ray.direction_site[kept], patches.normal_site[kept]
    sizes = np.array(
        [[batch.detections[i]["box_width_px"], batch.detections[i]["box_height_px"]] for i in kept], dtype=np.float64
    )
    poses = np.array([covariances.get(batch.detections[i]["photo_id"], np.zeros((6, 6))) for i in kept])
    ray_covariance = compute_ray_covariance(
        direction,
        patches.distance_m[kept],
        normal,
        patches.ray.direction_per_px[kept],
        np.hypot(settings.pixel_sigma_px, settings.box_sigma_share * sizes),
        np.array([batch.cameras[camera].site_from_cam.rotation for camera in batch.camera_index[kept]]),
        poses,
    )
    return ray_covariance + compute_surface_covariance(direction, normal, settings.model_sigma_m)
