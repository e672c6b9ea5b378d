"""Cracks on the surface: their widths and lengths in the photograph turned to millimetres and metres there.

A pixel covers more of a wall seen aslant, and more along the slant than across it: so a crack's width scales by the
direction it runs in. Along its line, ``J`` takes a step in the photograph to a step on the surface; a crack that runs
along ``u`` (unit, pixels) and is w pixels wide has edges ``w |J u x J v| / |J u|`` apart, where ``v`` is across ``u``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from facadelake.core.arrays import Float64Array, Int64Array
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
# One sigma of the surface's slope against the model's: plaster, bulges, a pose's attitude.
_SLOPE_SIGMA_RAD = np.radians(1.0)
_PIECES_MOST = 400  # of a line: more do not change a mean


@dataclass(frozen=True, kw_only=True)
class _CrackScale:
    """Metres on the surface across the crack for a pixel across it, and its line's length there (None: no line)."""

    across_m: float
    length_m: float | None


def compute_crack_columns(
    casts: RaycastBatch, kept: Int64Array, covariance_site: Float64Array
) -> dict[str, Sequence[Any]]:
    """Columns of table ``observations`` for detections ``kept`` (m,), whose places have ``covariance_site`` (m, 3, 3).

    The error of a width holds that in pixels, that of the distance, and that of the surface's slope. A width that a
    person stated has no error.
    """
    rows = [_compute_row(casts, int(row), covariance) for row, covariance in zip(kept, covariance_site, strict=True)]
    return {name: [row.get(name) for row in rows] for name in CRACK_COLUMNS}


def _compute_row(casts: RaycastBatch, row: int, covariance_site: Float64Array) -> dict[str, Any]:
    found = casts.detections[row]
    width_px, line = found.get("crack_width_px"), found.get("crack_line")
    outcome = found.get("crack_width_outcome")
    if width_px is not None and outcome is None:
        outcome = str(CrackWidthOutcome.STATED)
    if outcome is None:
        return {}
    scale = _measure_scale_along_line(casts, row, line) if line is not None else _measure_scale_at_centre(casts, row)
    columns: dict[str, Any] = {"crack_width_outcome": outcome, "crack_length_m": scale.length_m}
    for name in ("", "_max", "_limit"):
        value = found.get(f"crack_width{name}_px")
        columns[f"crack_width{name}_mm"] = None if value is None else 1000 * scale.across_m * value
    sigma_px = found.get("crack_width_sigma_px")
    if sigma_px is not None and width_px is not None:
        share = _estimate_scale_sigma(casts, row, covariance_site)
        columns["crack_width_sigma_mm"] = 1000 * scale.across_m * float(np.hypot(sigma_px, share * width_px))
    return columns


def _estimate_scale_sigma(casts: RaycastBatch, row: int, covariance_site: Float64Array) -> float:
    """One sigma, as a share, of the size of a pixel on the surface: by the distance and by the slope."""
    patches = casts.patches
    ray = patches.ray.direction_site[row]
    by_distance = float(np.sqrt(max(float(ray @ covariance_site @ ray), 0.0))) / float(patches.distance_m[row])
    by_slope = float(np.tan(np.radians(min(float(patches.incidence_deg[row]), 85.0)))) * _SLOPE_SIGMA_RAD
    return float(np.hypot(by_distance, by_slope))


def _measure_scale_along_line(casts: RaycastBatch, row: int, line: str) -> _CrackScale:
    """The scale along the crack's line, on the plane of the detection's place."""
    patches = casts.patches
    shape = shapely.from_wkt(line)
    shape = shapely.segmentize(shape, max(shape.length / _PIECES_MOST, 1.0))
    corners = shapely.get_coordinates(shape)
    steps = np.diff(corners, axis=0)
    length = np.linalg.norm(steps, axis=1)
    kept = length > 0
    if not kept.any():
        return _measure_scale_at_centre(casts, row)
    steps, length, middle = steps[kept], length[kept], ((corners[1:] + corners[:-1]) / 2)[kept]
    rays = compute_pixel_rays(casts.cameras, np.full(len(middle), casts.camera_index[row]), middle)
    normal = patches.normal_site[row]
    facing = rays.direction_site @ normal
    distance = ((patches.xyz_site_m[row] - rays.origin_site_m) @ normal) / facing
    met = (facing < -0.02) & (distance > 0)
    if not met.any():
        return _measure_scale_at_centre(casts, row)
    onto = (
        rays.direction_per_px
        - rays.direction_site[:, :, None] * (normal @ rays.direction_per_px / facing[:, None])[:, None, :]
    )
    jacobian = distance[:, None, None] * onto
    along = np.einsum("nij,nj->ni", jacobian, steps / length[:, None])
    pixel_m2 = np.linalg.norm(np.cross(jacobian[:, :, 0], jacobian[:, :, 1]), axis=1)
    along_m = np.linalg.norm(along, axis=1)
    pieces_m = along_m * length
    across = np.average((pixel_m2 / along_m)[met], weights=pieces_m[met])
    return _CrackScale(across_m=float(across), length_m=float(pieces_m[met].sum()))


def _measure_scale_at_centre(casts: RaycastBatch, row: int) -> _CrackScale:
    """The scale of a crack without a line: across the way its mask runs; of a box, the root of a pixel's area."""
    patches, outlines = casts.patches, casts.outlines
    ray, normal = patches.ray.direction_site[row], patches.normal_site[row]
    step = patches.distance_m[row] * patches.ray.direction_per_px[row]
    step = step - np.outer(ray, normal @ step) / (normal @ ray)
    pixel_m2 = float(np.linalg.norm(np.cross(step[:, 0], step[:, 1])))
    if not outlines.has_mask[row]:
        return _CrackScale(across_m=float(np.sqrt(pixel_m2)), length_m=None)
    first, last = np.searchsorted(outlines.detection, (row, row + 1))
    _, axes = np.linalg.eigh(np.cov(outlines.xy_img[first:last].T))
    return _CrackScale(across_m=pixel_m2 / float(np.linalg.norm(step @ axes[:, 1])), length_m=None)
