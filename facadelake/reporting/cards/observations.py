"""The sightings of each defect: its boxes in the photographs, the best first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from shapely.errors import ShapelyError

from facadelake.core.arrays import Float64Array
from facadelake.reporting.inspection import Inspection

_FLATTEST_COS = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class DetectionOutline:
    """A detection in its photograph: its box, and the rings (n, 2) of its mask where it has one; pixels."""

    left_px: float
    top_px: float
    width_px: float
    height_px: float
    rings_px: tuple[Float64Array, ...]

    @property
    def centre_px(self) -> Float64Array:
        """The middle (2,) of the box."""
        return np.array([self.left_px + self.width_px / 2, self.top_px + self.height_px / 2])


@dataclass(frozen=True, kw_only=True, eq=False)
class DefectObservation:
    """One detection of a defect; angles and pixel sizes are None where the surface was not met."""

    detection_id: str
    photo_id: str
    outline: DetectionOutline
    incidence_deg: float | None
    gsd_mm: float | None
    score: float

    @property
    def pixel_mm(self) -> float:
        """The longest side of a pixel on the surface: what tells how well it is shown; inf where unknown."""
        if self.gsd_mm is None or self.incidence_deg is None:
            return np.inf
        return self.gsd_mm / max(float(np.cos(np.radians(self.incidence_deg))), _FLATTEST_COS)


def read_outline(detection: Mapping[str, Any]) -> DetectionOutline:
    """The box and mask of a row of ``detections``; a mask that cannot be read is left out."""
    rings: tuple[Float64Array, ...] = ()
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
    """The sightings of each defect by defect_id: those in its best photograph first, then by pixel size."""
    detections = {row["detection_id"]: row for row in inspection.detections.to_pylist()}
    best = dict(
        zip(
            inspection.defects.column("defect_id").to_pylist(),
            inspection.defects.column("best_photo_id").to_pylist(),
            strict=True,
        )
    )
    found: dict[str, list[DefectObservation]] = {defect_id: [] for defect_id in best}
    for row in inspection.observations.to_pylist():
        box = detections.get(row["detection_id"])
        if box is None or row["defect_id"] not in found:
            continue
        found[row["defect_id"]].append(
            DefectObservation(
                detection_id=row["detection_id"],
                photo_id=row["photo_id"],
                outline=read_outline(box),
                incidence_deg=row["incidence_deg"],
                gsd_mm=row["gsd_mm"],
                score=box["score"],
            )
        )
    for defect_id, own in found.items():
        own.sort(key=lambda one: (one.photo_id != best[defect_id], one.pixel_mm, -one.score, one.detection_id))
    return found
