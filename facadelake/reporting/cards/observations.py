"""Observations of each defect: its detections in photographs, the best view first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from shapely.errors import ShapelyError

from facadelake.core.arrays import Float64Array, Float64Nx2
from facadelake.reporting.inspection import Inspection

_MIN_INCIDENCE_COS = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class DetectionOutline:
    """The box of a detection, and the rings of its mask where it has one; pixels."""

    left_px: float
    top_px: float
    width_px: float
    height_px: float
    rings_px: tuple[Float64Nx2, ...]

    @property
    def centre_px(self) -> Float64Array:
        """Centre (2,) of the box."""
        return np.array([self.left_px + self.width_px / 2, self.top_px + self.height_px / 2])


@dataclass(frozen=True, kw_only=True, eq=False)
class DefectObservation:
    """One observation of a defect; ``incidence_deg`` and ``gsd_mm`` are None where it is not on the surface."""

    detection_id: str
    photo_id: str
    outline: DetectionOutline
    incidence_deg: float | None
    gsd_mm: float | None
    score: float

    @property
    def pixel_mm(self) -> float:
        """Longest side of a pixel on the surface, millimetres; inf where unknown. The smallest is the best view."""
        if self.gsd_mm is None or self.incidence_deg is None:
            return np.inf
        return self.gsd_mm / max(float(np.cos(np.radians(self.incidence_deg))), _MIN_INCIDENCE_COS)


def read_outline(detection: Mapping[str, Any]) -> DetectionOutline:
    """The outline of a row of table ``detections``; an invalid mask is ignored."""
    rings: tuple[Float64Nx2, ...] = ()
    if detection.get("mask"):
        try:
            parts = shapely.get_parts(shapely.from_wkt(detection["mask"])).tolist()
        except ShapelyError:
            parts = []
        rings = tuple(shapely.get_coordinates(part.exterior) for part in parts if hasattr(part, "exterior"))
    return DetectionOutline(
        left_px=detection["box_x_px"],
        top_px=detection["box_y_px"],
        width_px=detection["box_width_px"],
        height_px=detection["box_height_px"],
        rings_px=rings,
    )


def group_observations(inspection: Inspection) -> dict[str, list[DefectObservation]]:
    """Observations by defect_id: those in the defect's best photograph first, then by pixel size on the surface."""
    detections = {row["detection_id"]: row for row in inspection.detections.to_pylist()}
    best = dict(
        zip(
            inspection.defects.column("defect_id").to_pylist(),
            inspection.defects.column("best_photo_id").to_pylist(),
            strict=True,
        )
    )
    groups: dict[str, list[DefectObservation]] = {defect_id: [] for defect_id in best}
    for row in inspection.observations.to_pylist():
        box = detections.get(row["detection_id"])
        if box is None or row["defect_id"] not in groups:
            continue
        groups[row["defect_id"]].append(
            DefectObservation(
                detection_id=row["detection_id"],
                photo_id=row["photo_id"],
                outline=read_outline(box),
                incidence_deg=row["incidence_deg"],
                gsd_mm=row["gsd_mm"],
                score=box["score"],
            )
        )
    for defect_id, observations in groups.items():
        observations.sort(
            key=lambda item: (item.photo_id != best[defect_id], item.pixel_mm, -item.score, item.detection_id)
        )
    return groups
