"""Detections to observations: where each box or mask lies on the building, how surely, and on which of its elements.

The paper turns pixels to metres by one depth a photograph (``2 z tan(FOV/2) l / l_D``, in Algorithm 1), which is
exact only for a plane seen square-on; here each pixel's own ray meets the surface.
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
from facadelake.core.arrays import Float64Array, Int64Array
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
_NO_COVARIANCE: Mapping[str, Float64Array] = {}


@dataclass(frozen=True, kw_only=True)
class OutcomeDecision:
    """What becomes of a detection, and why in words (None where it is registered)."""

    outcome: ObservationOutcome
    reason: str | None = None


def observe_detections(
    detections: pa.Table,
    posed: Mapping[str, PosedCamera],
    building: BuildingModel,
    surface: Surface,
    settings: RegistrationSettings,
    covariances: Mapping[str, Float64Array] = _NO_COVARIANCE,
) -> pa.Table:
    """Table ``observations``: one row an accepted detection, with its outcome; ``defect_id`` is left to ``merge``.

    ``posed`` holds the localised photographs by photo_id, ``covariances`` their poses' (6, 6) as
    ``facadelake.core.pose_table.read_pose_covariances`` gives them; a pose without one is taken for exact. A surface that
    was measured stands off the building by its own ``surface_sigma_m`` instead of ``settings.model_sigma_m``.
    """
    if building.surface_sigma_m is not None:
        settings = replace(settings, model_sigma_m=building.surface_sigma_m)
    accepted = [row for row in detections.to_pylist() if row["detection_outcome"] == DetectionOutcome.ACCEPTED]
    rows: list[Row] = []
    on_photo: list[Row] = []
    for row in accepted:
        verdict = _decide_without_ray(row, posed)
        if verdict is None:
            on_photo.append(row)
        else:
            rows.append(_build_row(row, verdict, 0.0))
    on_photo.sort(key=lambda row: (row["photo_id"], row["detection_id"]))
    places = ObservationColumns(building, ElementAttribution(building, settings.model_sigma_m))
    with report_progress("Registering detections", len(on_photo)) as step:
        for start in range(0, len(on_photo), settings.detections_per_cast):
            casts = cast_detections(on_photo[start : start + settings.detections_per_cast], posed, surface, settings)
            rows.extend(_build_rows(casts, assign_outcomes(casts, settings), places, settings, covariances))
            step.advance(len(casts.detections))
    rows.sort(key=lambda row: str(row["detection_id"]))
    counts = {
        str(outcome): sum(row["observation_outcome"] == outcome for row in rows) for outcome in ObservationOutcome
    }
    _log.info("%d detections on the surface: %s", len(rows), counts)
    return table_from_rows("observations", rows)


def assign_outcomes(casts: RaycastBatch, settings: RegistrationSettings) -> list[OutcomeDecision]:
    """What becomes of each of the detections, by how much of it meets the building and how flat."""
    verdicts = []
    for share, angle in zip(casts.patches.target_share, casts.patches.incidence_deg, strict=True):
        if share < settings.target_share_min or not np.isfinite(angle):
            reason = f"{share:.1%} of its rays meet the building, the limit is {settings.target_share_min:.0%}"
            verdicts.append(OutcomeDecision(outcome=ObservationOutcome.OFF_TARGET, reason=reason))
        elif angle > settings.grazing_above_deg:
            reason = f"its ray meets the surface at {angle:.1f} deg, the limit is {settings.grazing_above_deg:g} deg"
            verdicts.append(OutcomeDecision(outcome=ObservationOutcome.GRAZING, reason=reason))
        else:
            verdicts.append(OutcomeDecision(outcome=ObservationOutcome.REGISTERED))
    return verdicts


def _decide_without_ray(row: Row, posed: Mapping[str, PosedCamera]) -> OutcomeDecision | None:
    camera = posed.get(row["photo_id"])
    if camera is None:
        reason = "the photograph has no measured pose; see table poses"
        return OutcomeDecision(outcome=ObservationOutcome.UNLOCALISED, reason=reason)
    if not (row["box_width_px"] > 0 and row["box_height_px"] > 0):
        reason = f"its box of {row['box_width_px']:g} x {row['box_height_px']:g} px has no area, so it shows nothing"
        return OutcomeDecision(outcome=ObservationOutcome.OUTSIDE, reason=reason)
    x, y = row["box_x_px"] + row["box_width_px"] / 2, row["box_y_px"] + row["box_height_px"] / 2
    if camera.camera.is_inside(np.array([[x, y]]))[0]:
        return None
    size = f"{camera.camera.width_px} x {camera.camera.height_px} px"
    reason = f"its middle at {x:.1f}, {y:.1f} px lies outside the photograph of {size}"
    return OutcomeDecision(outcome=ObservationOutcome.OUTSIDE, reason=reason)


def _build_row(detection: Row, verdict: OutcomeDecision, target_share: float, **found: Any) -> Row:
    kept = {name: detection[name] for name in ("detection_id", "photo_id", "defect_class")}
    outcome = {"observation_outcome": str(verdict.outcome), "reason": verdict.reason}
    return {**kept, **outcome, "target_share": target_share, **found}


def _build_rows(
    casts: RaycastBatch,
    verdicts: Sequence[OutcomeDecision],
    places: ObservationColumns,
    settings: RegistrationSettings,
    covariances: Mapping[str, Float64Array],
) -> list[Row]:
    """Rows of the detections, with their places where the building was met."""
    shares = casts.patches.target_share
    kept = np.array(
        [i for i, verdict in enumerate(verdicts) if verdict.outcome is not ObservationOutcome.OFF_TARGET],
        dtype=np.int64,
    )
    found: list[Row] = [{} for _ in verdicts]
    if len(kept):
        covariance = compute_position_covariance(casts, kept, settings, covariances)
        columns = places.build(casts, kept, covariance)
        for place, index in enumerate(kept.tolist()):
            found[index] = {name: values[place] for name, values in columns.items()}
    return [
        _build_row(row, verdict, float(share), **extra)
        for row, verdict, share, extra in zip(casts.detections, verdicts, shares, found, strict=True)
    ]


def compute_position_covariance(
    casts: RaycastBatch, kept: Int64Array, settings: RegistrationSettings, covariances: Mapping[str, Float64Array]
) -> Float64Array:
    """Covariance (m, 3, 3) in m2 of the positions of the detections ``kept`` (m,), by rays and surface together."""
    patches = casts.patches
    direction, normal = patches.ray.direction_site[kept], patches.normal_site[kept]
    sizes = np.array(
        [[casts.detections[i]["box_width_px"], casts.detections[i]["box_height_px"]] for i in kept], dtype=np.float64
    )
    poses = np.array([covariances.get(casts.detections[i]["photo_id"], np.zeros((6, 6))) for i in kept])
    by_ray = compute_ray_covariance(
        direction,
        patches.distance_m[kept],
        normal,
        patches.ray.direction_per_px[kept],
        np.hypot(settings.pixel_sigma_px, settings.box_sigma_share * sizes),
        np.array([casts.cameras[camera].site_from_cam.rotation for camera in casts.camera_index[kept]]),
        poses,
    )
    return by_ray + compute_surface_covariance(direction, normal, settings.model_sigma_m)
