"""Width of a crack from all its observations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64N, RowIndices
from facadelake.deduplication.group_statistics import compute_weighted_medians
from facadelake.deduplication.observations import read_column
from schemas.vocabulary import CrackWidthOutcome

# A measured width this far above the resolution limit of a better photograph is the blur of a coarse one.
_BLUR_SIGMAS = 2.0
_SIGNIFICANT_SIGMAS = 3.0
_REDUNDANCY_MIN = 5  # repeated measurements of a campaign from which they tell an unknown blur
_OUTCOMES = tuple(str(outcome) for outcome in CrackWidthOutcome)  # the best first


@dataclass(frozen=True, kw_only=True, eq=False)
class CrackWidthEstimate:
    """Widths of g groups in mm, NaN where there is none.

    ``width_mm``, ``width_max_mm``, one sigma ``sigma_mm`` and resolution limit ``limit_mm`` (g,); ``blur_mm`` (g,) is
    the part of the sigma by which the width may be overstated; ``outcome`` (g,) text.
    """

    width_mm: Float64N
    width_max_mm: Float64N
    sigma_mm: Float64N
    limit_mm: Float64N
    blur_mm: Float64N
    outcome: pa.Array


def estimate_crack_widths(
    registered_rows: pa.Table, group: RowIndices, weight: Float64N, groups: int
) -> CrackWidthEstimate:
    """Combine the crack widths of observations.

    Stated widths take precedence over measured ones. Measured widths are weighted by their variance; one above the
    resolution limit of a photograph that could not resolve the width is discarded as blur. Where none is left, the
    smallest limit is the upper bound. Observations share the errors of blur and scale, so their combination is never
    more accurate than the best, and less accurate where they disagree. Where the widths of one crack grow with the size
    of the pixels, blur that the photographs do not tell is measured as width: its estimate in pixels
    (``estimate_unknown_blur``) is a part of the error of every width of the campaign.

    Args:
        registered_rows: registered rows (n) of table ``observations``.
        group: group (n,) of each.
        weight: weight (n,) of each, for stated widths.
        groups: number of groups.
    """
    names = ("crack_width_mm", "crack_width_max_mm", "crack_width_sigma_mm", "crack_width_limit_mm")
    width, largest, sigma, limit = (read_column(registered_rows, name) for name in names)
    outcomes = registered_rows.column("crack_width_outcome").to_pylist()
    rank = np.array(
        [_OUTCOMES.index(outcome) if outcome is not None else len(_OUTCOMES) for outcome in outcomes], dtype=np.int64
    )
    stated, measured, below_limit = (
        rank == _OUTCOMES.index(outcome)
        for outcome in (CrackWidthOutcome.STATED, CrackWidthOutcome.MEASURED, CrackWidthOutcome.BELOW_LIMIT)
    )
    bound = _compute_minima(group, np.where(below_limit, limit, np.nan), groups)
    with np.errstate(invalid="ignore"):
        is_blur = measured & (width - _BLUR_SIGMAS * sigma > bound[group])
    rank = np.where(is_blur, len(_OUTCOMES), rank)
    measured = measured & ~is_blur
    best_rank = np.full(groups, len(_OUTCOMES), dtype=np.int64)
    np.minimum.at(best_rank, group, rank)
    gsd_mm = read_column(registered_rows, "gsd_mm")
    blur_px = estimate_unknown_blur(group[measured], width[measured], sigma[measured], gsd_mm[measured])
    combined_weight = np.where(measured, 1 / np.maximum(np.where(measured, sigma, 1.0), 1e-6) ** 2, weight)
    used = np.where(best_rank[group] == rank, stated | measured, False)
    used_width = np.where(used, width, np.nan)
    width_mm = compute_weighted_medians(group, used_width, combined_weight, groups)
    return CrackWidthEstimate(
        width_mm=width_mm,
        width_max_mm=compute_weighted_medians(group, np.where(used, largest, np.nan), combined_weight, groups),
        sigma_mm=_combine_sigmas(
            group,
            np.where(used & measured, width - width_mm[group], np.nan),
            np.hypot(sigma, blur_px * gsd_mm),
            combined_weight,
            groups,
        ),
        limit_mm=np.where(
            best_rank == _OUTCOMES.index(CrackWidthOutcome.BELOW_LIMIT), bound, _compute_minima(group, limit, groups)
        ),
        blur_mm=_compute_minima(group, np.where(used & measured & (blur_px > 0), blur_px * gsd_mm, np.nan), groups),
        outcome=pa.array([*_OUTCOMES, None], pa.string()).take(pa.array(best_rank)),
    )


def describe_width_blur(blur_mm: Sequence[float | None]) -> str:
    """Warning where widths may be overstated, from column ``crack_width_blur_mm``; empty where none is."""
    known = [value for value in blur_mm if value is not None]
    if not known:
        return ""
    return (
        f"the widths of {len(known)} cracks may be overstated, by about {min(known):.0f} to {max(known):.0f} mm: they "
        "grow with the size of the pixels, so blur that the photographs do not tell (a soft rim, sharpening, a steep "
        "tone curve) is measured as width; it is in their sigmas: photograph the cracks from nearer to measure them"
    )


def estimate_unknown_blur(group: RowIndices, width_mm: Float64N, sigma_mm: Float64N, gsd_mm: Float64N) -> float:
    """Growth of the measured width of one crack with the size of a pixel, in pixels; 0 where it is not significant.

    The true width of a crack is one number, whatever the photograph. Least squares over the cracks of a campaign, each
    with its own width; the errors are scaled to the residuals.

    Args:
        group: crack (n,) of each measured width.
        width_mm: measured widths (n,).
        sigma_mm: one sigma (n,) of each.
        gsd_mm: size of a pixel on the surface (n,).
    """
    if len(group) == 0:
        return 0.0
    weight = 1 / np.maximum(sigma_mm, 1e-6) ** 2
    count = int(group.max()) + 1
    total = np.maximum(np.bincount(group, weight, minlength=count), 1e-300)
    centred_width, centred_gsd = (
        values - (np.bincount(group, weight * values, minlength=count) / total)[group] for values in (width_mm, gsd_mm)
    )
    information = float(np.sum(weight * centred_gsd**2))
    redundancy = len(group) - len(np.unique(group)) - 1
    if information <= 0 or redundancy < _REDUNDANCY_MIN:
        return 0.0
    slope = float(np.sum(weight * centred_gsd * centred_width)) / information
    variance_factor = float(np.sum(weight * (centred_width - slope * centred_gsd) ** 2)) / redundancy
    slope_sigma = np.sqrt(max(variance_factor, 1.0) / information)
    return slope if slope > _SIGNIFICANT_SIGMAS * slope_sigma else 0.0


def _combine_sigmas(group: RowIndices, residual: Float64N, sigma: Float64N, weight: Float64N, groups: int) -> Float64N:
    """One sigma of the combined widths: the smallest of the observations', and the standard error of their scatter.

    Args:
        group: group (n,) of each observation.
        residual: difference (n,) from the combined width; NaN where not used.
        sigma: one sigma (n,).
        weight: weight (n,).
        groups: number of groups.

    Returns:
        One sigma (groups,).
    """
    used = np.isfinite(residual)
    owner = group[used]
    number = np.bincount(owner, minlength=groups)
    total = np.bincount(owner, weights=weight[used], minlength=groups)
    square = np.bincount(owner, weights=weight[used] * residual[used] ** 2, minlength=groups)
    with np.errstate(invalid="ignore", divide="ignore"):
        scatter = square / total / number
    out: Float64N = np.sqrt(_compute_minima(group, np.where(used, sigma, np.nan), groups) ** 2 + scatter)
    return out


def _compute_minima(group: RowIndices, value: Float64N, groups: int) -> Float64N:
    """The smallest value (groups,) that is not NaN; NaN where there is none."""
    out = np.full(groups, np.inf)
    np.minimum.at(out, group, np.where(np.isfinite(value), value, np.inf))
    return np.where(np.isfinite(out), out, np.nan)
