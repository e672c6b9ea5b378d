"""Widths and lengths of cracks, from pixels to millimetres and metres on the surface.

A pixel covers more of a surface seen obliquely, and more along the slope than across it, so the scale of a crack's
width depends on the direction of the crack. Along its line, the Jacobian ``J`` takes a step in the photograph to a step
on the surface; the edges of a crack along ``u`` (unit, pixels) that is w pixels wide are ``w |J u x J v| / |J u|``
apart, where ``v`` is perpendicular to ``u``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from facadelake.core.arrays import Float64Nx3x3, Float64x3x3, RowIndices
from facadelake.registration.raycast import RaycastBatch
from facadelake.registration.rays import compute_pixel_rays
from schemas.vocabulary import CrackWidthOutcome

CRACK_COLUMNS = (
    "crack_width_mm",
    "crack_width_max_mm",
    "crack_width_sigma_mm",
    "crack_width_limit_mm",
    "crack_length_m",
    "crack_width_outcome",
)
# One sigma of the slope between surface and model: plaster, bulges, attitude of the pose.
_SLOPE_SIGMA_RAD = np.radians(1.0)
_LINE_PIECES_MAX = 400  # more do not change the mean along a line


@dataclass(frozen=True, kw_only=True)
class _CrackScale:
    """Metres on the surface per pixel across the crack, and the length of its line there (None: it has no line)."""

    across_m: float
    length_m: float | None


def compute_crack_columns(
    batch: RaycastBatch, kept: RowIndices, covariance_site: Float64Nx3x3
) -> dict[str, Sequence[Any]]:
    """Crack columns of table ``observations`` for detections ``kept`` (m,).

    ``covariance_site`` (m, 3, 3): covariances of their positions in m2. The error of a width combines those of the
    width in pixels, of the distance and of the slope of the surface. A width that a person stated has no error.
    """
    rows = [_compute_row(batch, int(row), covariance) for row, covariance in zip(kept, covariance_site, strict=True)]
    return {name: [row.get(name) for row in rows] for name in CRACK_COLUMNS}


def _compute_row(batch: RaycastBatch, row: int, covariance_site: Float64x3x3) -> dict[str, Any]:
    """Crack columns of one detection; empty where it is no crack."""
    detection = batch.detections[row]
    width_px, line = detection.get("crack_width_px"), detection.get("crack_line")
    outcome = detection.get("crack_width_outcome")
    if width_px is not None and outcome is None:
        outcome = str(CrackWidthOutcome.STATED)
    if outcome is None:
        return {}
    scale = _measure_scale_along_line(batch, row, line) if line is not None else _measure_scale_at_centre(batch, row)
    columns: dict[str, Any] = {"crack_width_outcome": outcome, "crack_length_m": scale.length_m}
    for name in ("", "_max", "_limit"):
        value = detection.get(f"crack_width{name}_px")
        columns[f"crack_width{name}_mm"] = None if value is None else 1000 * scale.across_m * value
    sigma_px = detection.get("crack_width_sigma_px")
    if sigma_px is not None and width_px is not None:
        share = _estimate_scale_sigma(batch, row, covariance_site)
        columns["crack_width_sigma_mm"] = 1000 * scale.across_m * float(np.hypot(sigma_px, share * width_px))
    return columns


def _estimate_scale_sigma(batch: RaycastBatch, row: int, covariance_site: Float64x3x3) -> float:
    """Relative one sigma of the size of a pixel on the surface, due to the distance and the slope."""
    patches = batch.patches
    ray = patches.ray.direction_site[row]
    by_distance = float(np.sqrt(max(float(ray @ covariance_site @ ray), 0.0))) / float(patches.distance_m[row])
    by_slope = float(np.tan(np.radians(min(float(patches.incidence_deg[row]), 85.0)))) * _SLOPE_SIGMA_RAD
    return float(np.hypot(by_distance, by_slope))


def _measure_scale_along_line(batch: RaycastBatch, row: int, line: str) -> _CrackScale:
    """Scale along the line (WKT, pixels) of a crack, on the tangent plane at the position."""
    patches = batch.patches
    shape = shapely.from_wkt(line)
    shape = shapely.segmentize(shape, max(shape.length / _LINE_PIECES_MAX, 1.0))
    corners = shapely.get_coordinates(shape)
    steps = np.diff(corners, axis=0)
    length = np.linalg.norm(steps, axis=1)
    valid = length > 0
    if not valid.any():
        return _measure_scale_at_centre(batch, row)
    steps, length, midpoint = steps[valid], length[valid], ((corners[1:] + corners[:-1]) / 2)[valid]
    rays = compute_pixel_rays(batch.cameras, np.full(len(midpoint), batch.camera_index[row]), midpoint)
    normal = patches.normal_site[row]
    facing = rays.direction_site @ normal
    distance = ((patches.xyz_site_m[row] - rays.origin_site_m) @ normal) / facing
    hit = (facing < -0.02) & (distance > 0)
    if not hit.any():
        return _measure_scale_at_centre(batch, row)
    derivative = (
        rays.direction_per_px
        - rays.direction_site[:, :, None] * (normal @ rays.direction_per_px / facing[:, None])[:, None, :]
    )
    jacobian = distance[:, None, None] * derivative
    along = np.einsum("nij,nj->ni", jacobian, steps / length[:, None])
    pixel_m2 = np.linalg.norm(np.cross(jacobian[:, :, 0], jacobian[:, :, 1]), axis=1)
    along_m = np.linalg.norm(along, axis=1)
    pieces_m = along_m * length
    across = np.average((pixel_m2 / along_m)[hit], weights=pieces_m[hit])
    return _CrackScale(across_m=float(across), length_m=float(pieces_m[hit].sum()))


def _measure_scale_at_centre(batch: RaycastBatch, row: int) -> _CrackScale:
    """Scale of a crack without a line: across the main axis of its mask; of a box, the root of a pixel's area."""
    patches, outlines = batch.patches, batch.outlines
    ray, normal = patches.ray.direction_site[row], patches.normal_site[row]
    step = patches.distance_m[row] * patches.ray.direction_per_px[row]
    step = step - np.outer(ray, normal @ step) / (normal @ ray)
    pixel_m2 = float(np.linalg.norm(np.cross(step[:, 0], step[:, 1])))
    if not outlines.has_mask[row]:
        return _CrackScale(across_m=float(np.sqrt(pixel_m2)), length_m=None)
    first, last = np.searchsorted(outlines.detection, (row, row + 1))
    _, axes = np.linalg.eigh(np.cov(outlines.xy_img[first:last].T))
    return _CrackScale(across_m=pixel_m2 / float(np.linalg.norm(step @ axes[:, 1])), length_m=None)
