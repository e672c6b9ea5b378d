"""Sizes of a campaign's defects with their sigmas: from pixels, incidence, distance and the jitter of boxes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64N, RowIndices
from facadelake.tracking.size_change import DefectSizes, compute_medians, summarise_sizes
from schemas.vocabulary import CrackWidthOutcome, TrendQuantity

_EDGE_SIGMA_PX = 0.5  # one sigma of a box's edge by the pixels, as of a position in registration
_SLOPE_SIGMA_RAD = np.radians(1.0)  # of a wall against its model, as for crack widths in registration
# Of a width, in pixels: what differs between photographs in the reading of one crack (its scatter on brickwork), and
# the blur that no photograph tells where a campaign cannot estimate it (half of the widths of real cracks are within a
# pixel of those drawn by hand): docs/measuring.md.
_WIDTH_SIGMA_PX, _UNKNOWN_BLUR_PX = 0.3, 1.0
SIZE_COLUMNS = (
    "defect_id", "length_m", "width_m", "height_m", "area_m2", "gsd_mm", "incidence_deg", "distance_m", "normal_x",
    "normal_y", "normal_z", "covariance_site", "crack_width_mm",
)  # fmt: skip
_MEASURED = (CrackWidthOutcome.MEASURED, CrackWidthOutcome.STATED)


def read_sizes(defects: pa.Table, observations: pa.Table) -> dict[TrendQuantity, DefectSizes]:
    """Sizes of the defects of one campaign, in the order of ``defects``: length and area as medians of the sightings;
    measured crack widths. ``observations`` with ``SIZE_COLUMNS``."""
    row_of = {defect_id: row for row, defect_id in enumerate(defects.column("defect_id").to_pylist())}
    owner = [row_of.get(defect_id, -1) for defect_id in observations.column("defect_id").to_pylist()]
    defect = np.array(owner, dtype=np.int64)
    found = {
        quantity: _read_extents(observations, quantity, defect, len(row_of))
        for quantity in (TrendQuantity.LENGTH, TrendQuantity.AREA)
    }
    found[TrendQuantity.CRACK_WIDTH] = _read_widths(defects, observations, defect)
    return found


def share_blur(campaigns: Sequence[Mapping[TrendQuantity, DefectSizes]]) -> list[dict[TrendQuantity, DefectSizes]]:
    """Sizes of a building's campaigns, with the largest unknown blur of widths that one of them tells.

    The cracks, and mostly the camera, are the same; a campaign whose photographs are all from one distance cannot tell.
    """
    width = TrendQuantity.CRACK_WIDTH
    blur_px = max((float(one[width].blur_px.max(initial=0.0)) for one in campaigns), default=0.0)
    return [{**one, width: replace(one[width], blur_px=np.full_like(one[width].blur_px, blur_px))} for one in campaigns]


def _read_extents(observations: pa.Table, quantity: TrendQuantity, defect: RowIndices, count: int) -> DefectSizes:
    """Medians of the sightings. What they share: the scale, by the distance and the slope of the wall."""
    size = _read_column(observations, quantity)
    usable = (defect >= 0) & (size > 0)
    edge_m = _EDGE_SIGMA_PX * _read_column(observations, "gsd_mm") / 1000 / _read_cosine(observations)
    extents = [_read_column(observations, name) for name in ("width_m", "height_m")]
    if quantity is TrendQuantity.LENGTH:
        pixel = np.sqrt(2) * edge_m / size
    else:
        pixel = np.sqrt(2) * edge_m * np.hypot(1 / extents[0], 1 / extents[1])
    pooled = summarise_sizes(np.log(size[usable]), np.nan_to_num(pixel[usable]), defect[usable], count)
    shared = compute_medians(_compute_scale_sigma(observations, quantity)[usable], defect[usable], count)
    return replace(pooled, sigma=np.hypot(pooled.sigma, shared))


def _read_widths(defects: pa.Table, observations: pa.Table, defect: RowIndices) -> DefectSizes:
    """Measured widths. Blur that the campaign has told (``crack_width_blur_mm``, a part of the stated sigma) is kept
    apart, since it is common to the campaigns; where none is told, a pixel of it cannot be excluded."""
    count = len(defects)
    width, sigma = _read_column(defects, "crack_width_mm"), _read_column(defects, "crack_width_sigma_mm")
    blur_mm = np.nan_to_num(_read_column(defects, "crack_width_blur_mm"))
    gsd_mm = _read_column(observations, "gsd_mm")
    seen = (defect >= 0) & np.isfinite(_read_column(observations, "crack_width_mm"))
    # A nearer photograph counts more, in proportion to the squared size of its pixel, as when widths are combined.
    weight = np.where(seen, 1 / gsd_mm**2, 0.0)
    pixel_mm = _divide(
        _sum_by_defect((weight * gsd_mm)[seen], defect[seen], count),
        _sum_by_defect(weight[seen], defect[seen], count),
    )
    smallest_mm = np.full(count, np.inf)
    np.minimum.at(smallest_mm, defect[seen], gsd_mm[seen])
    told_px = float(np.max(blur_mm / smallest_mm, initial=0.0))
    own_mm = np.sqrt(np.maximum(sigma**2 - blur_mm**2, 0.0))
    usable = np.isin(defects.column("crack_width_outcome").to_pylist(), _MEASURED) & (width > 0) & (sigma > 0)
    scale = compute_medians(_compute_scale_sigma(observations, TrendQuantity.CRACK_WIDTH)[seen], defect[seen], count)
    share = np.hypot(_divide(np.hypot(own_mm, _WIDTH_SIGMA_PX * np.nan_to_num(pixel_mm)), width), np.nan_to_num(scale))
    return DefectSizes(
        log_size=np.log(width, out=np.full(count, np.nan), where=usable),
        sigma=np.where(usable, share, np.nan),
        per_blur_px=np.nan_to_num(pixel_mm),
        blur_px=np.full(count, max(told_px, _UNKNOWN_BLUR_PX)),
    )


def _compute_scale_sigma(observations: pa.Table, quantity: TrendQuantity) -> Float64N:
    """One sigma (n,) of the logarithm of a size by the scale of each sighting: the error of the distance, and the slope
    of the wall, which foreshortens one extent."""
    normal = np.column_stack([_read_column(observations, f"normal_{axis}") for axis in "xyz"])
    covariance = np.array(
        [np.full(9, np.nan) if one is None else one for one in observations.column("covariance_site").to_pylist()]
    ).reshape(-1, 3, 3)
    depth_m = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", normal, covariance, normal), 0.0))
    cosine = _read_cosine(observations)
    by_distance = np.nan_to_num(depth_m / cosine / _read_column(observations, "distance_m"))
    by_slope = np.nan_to_num(_SLOPE_SIGMA_RAD * np.sqrt(1 / cosine**2 - 1))
    sigma: Float64N = np.hypot((2 if quantity is TrendQuantity.AREA else 1) * by_distance, by_slope)
    return sigma


def _read_cosine(observations: pa.Table) -> Float64N:
    """Cosine of the incidence (n,), as of 85 degrees at most."""
    cosine: Float64N = np.cos(np.radians(np.minimum(_read_column(observations, "incidence_deg"), 85.0)))
    return cosine


def _sum_by_defect(value: Float64N, defect: RowIndices, count: int) -> Float64N:
    total: Float64N = np.bincount(defect, weights=value, minlength=count).astype(np.float64)
    return total


def _divide(value: Float64N, by: Float64N) -> Float64N:
    """Quotients; NaN where the divisor is not positive."""
    quotient: Float64N = np.divide(value, by, out=np.full(len(value), np.nan), where=by > 0)
    return quotient


def _read_column(table: pa.Table, name: str) -> Float64N:
    values: Float64N = table.column(name).to_numpy(zero_copy_only=False).astype(np.float64)
    return values
