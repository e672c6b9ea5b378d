"""Limits that a placed campaign must meet; one that exceeds them commits nothing."""

from __future__ import annotations

import numpy as np

from facadelake.core.arrays import Float64N, Float64x3
from facadelake.core.errors import GeoreferenceError
from facadelake.core.geodesy import SITE_AXES
from schemas.vocabulary import ControlKind

# Tolerance of control points (median) in a block placed by an earlier campaign: in its own sigmas, and at least.
_MAX_FRAME_SIGMAS, _MIN_FRAME_TOLERANCE_M = 3.0, 0.05


def require_accuracy(
    *, control: ControlKind, sigma_m: Float64x3, limit_m: float, held_out_m: Float64N, remedy: str
) -> None:
    """Refuse a placement that is not accurate enough; the campaign then commits nothing.

    Args:
        control: the kind of control.
        sigma_m: one sigma (3,) of the campaign's position: east, north, up.
        limit_m: limit of the largest sigma, and a third of the limit of the median held-out residual.
        held_out_m: residual lengths (k,) at held-out and check points.
        remedy: what to do about a sigma beyond the limit, for the message.

    Raises:
        GeoreferenceError: a limit is exceeded.
    """
    largest = float(np.max(sigma_m))
    if largest > limit_m:
        axis = SITE_AXES[int(np.argmax(sigma_m))]
        raise GeoreferenceError(
            f"placed by {control}, the campaign's position is known to {largest:.2f} m {axis} (one sigma), the limit "
            f"is {limit_m:g} m (tolerances.placement_sigma_max_m); {remedy}"
        )
    if len(held_out_m) and float(np.median(held_out_m)) > 3 * limit_m:
        raise GeoreferenceError(
            f"placed by {control}, held-out points lie {np.median(held_out_m):.2f} m (median) from their surveyed "
            f"positions, the limit is {3 * limit_m:g} m (three times tolerances.placement_sigma_max_m); check the "
            "coordinates, CRS and marks of the control points"
        )


def require_consistent_frame(held_out_m: Float64N, sigma_m: float, method: str) -> None:
    """Refuse a placement by an earlier campaign with which the control points of this one do not agree.

    Args:
        held_out_m: residual lengths (k,) at the control points, which have no weight.
        sigma_m: largest sigma of the campaign's position.
        method: the control in words, for the message.

    Raises:
        GeoreferenceError: the median residual exceeds three sigmas and 5 cm.
    """
    limit_m = max(_MAX_FRAME_SIGMAS * sigma_m, _MIN_FRAME_TOLERANCE_M)
    if float(np.median(held_out_m)) > limit_m:
        raise GeoreferenceError(
            f"placed by {method}, control points deviate by {np.median(held_out_m):.2f} m (median, limit "
            f"{limit_m:.2f} m): the control of the two campaigns does not agree; check both files of control points"
        )
