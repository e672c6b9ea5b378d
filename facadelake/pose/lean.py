"""What a building that leans against its model adds to the cameras' covariance.

A wall within tolerance of its model may stand off at the top and not at the foot. A block that is held by walls leans
with them: the farther a camera stands from the wall, the more it rises or sinks. The adjustment knows walls that are
off as a whole, not walls that lean.
"""

from __future__ import annotations

import numpy as np

from facadelake.frames import Array
from facadelake.pose.adjustment.adjust import Adjusted
from facadelake.pose.adjustment.linearise import cross_matrices

_RIM_PERCENT = 2.0
_LEAST_HALF_HEIGHT_M = 1.0


def lean_covariance(adjusted: Adjusted, model_sigma_m: float) -> Array:
    """Covariance (n, 6, 6) of the photographs (centre in m, attitude in rad about the camera's axes) by a lean.

    One sigma of the lean about east and about north is ``model_sigma_m`` over half the height of the walls that hold
    the block; it turns the block about their middle.
    """
    state = adjusted.solution.state
    held = state.node_m[adjusted.problem.walls.node]
    if not len(held):
        return np.zeros((len(state.centre_site_m), 6, 6))
    low, high = np.percentile(held[:, 2], [_RIM_PERCENT, 100.0 - _RIM_PERCENT])
    sigma_rad = model_sigma_m / max((high - low) / 2.0, _LEAST_HALF_HEIGHT_M)
    arm = state.centre_site_m - np.median(held, axis=0)
    # A turn w moves a point by w cross arm, that is by -(arm cross w), and a camera's axes by its own rotation of w.
    by_turn = np.concatenate([-cross_matrices(arm), state.site_from_cam.transpose(0, 2, 1)], axis=1)[:, :, :2]
    covariance: Array = sigma_rad**2 * by_turn @ by_turn.transpose(0, 2, 1)
    return covariance
