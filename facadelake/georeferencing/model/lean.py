"""A building that leans against its model: what upright lines say of it, and what is left in the cameras' covariance.

A wall within tolerance of its model may stand off at the top and not at the foot. A block that is held by walls leans
with them: the farther a camera stands from the wall, the more it rises or sinks. The adjustment knows walls that are
off as a whole, not walls that lean; upright lines in the photographs (plumb_lines) know the vertical without the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from facadelake.core.arrays import Float64Array
from facadelake.georeferencing.adjustment.adjusted_block import AdjustedBlock
from facadelake.georeferencing.adjustment.linearise import build_skew_matrices
from facadelake.georeferencing.model.plumb_lines import VerticalDirection

_RIM_PERCENT = 2.0
_MIN_HALF_HEIGHT_M = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockLean:
    """By what the block is turned about ``pivot_site_m`` (3,), the walls' middle, to stand upright.

    ``rotation_rad`` (2,): about east and about north. ``sigma_rad``: one sigma of each that is left.
    """

    pivot_site_m: Float64Array
    rotation_rad: Float64Array
    sigma_rad: float

    @property
    def rotation(self) -> Float64Array:
        """The turn as a matrix (3, 3)."""
        matrix: Float64Array = Rotation.from_rotvec([*self.rotation_rad, 0.0]).as_matrix()
        return matrix

    def compute_covariance(self, adjusted: AdjustedBlock) -> Float64Array:
        """What the lean adds to the photographs' covariance (n, 6, 6: centre in m, attitude in rad)."""
        state = adjusted.solution.state
        arm = state.centre_site_m - self.pivot_site_m
        # A turn w moves a point by w cross arm = -(arm cross w), and a camera's axes by its own rotation of w.
        by_turn = np.concatenate([-build_skew_matrices(arm), state.site_from_cam.transpose(0, 2, 1)], axis=1)[:, :, :2]
        covariance: Float64Array = self.sigma_rad**2 * by_turn @ by_turn.transpose(0, 2, 1)
        return covariance


def estimate_lean(adjusted: AdjustedBlock, model_sigma_m: float, vertical: VerticalDirection | None) -> BlockLean:
    """The lean of a block that walls hold, from two observations: that walls are plumb, and what upright lines say.

    Walls are plumb to ``model_sigma_m`` over half the height of those that hold the block. Without upright lines the
    lean is nought with that sigma.
    """
    state = adjusted.solution.state
    held = state.xyz_site_m[adjusted.problem.point_to_plane.point]
    if not len(held):
        return BlockLean(pivot_site_m=np.zeros(3), rotation_rad=np.zeros(2), sigma_rad=0.0)
    low, high = np.percentile(held[:, 2], [_RIM_PERCENT, 100.0 - _RIM_PERCENT])
    sigma_rad = model_sigma_m / max((high - low) / 2.0, _MIN_HALF_HEIGHT_M)
    pivot = np.median(held, axis=0)
    if vertical is None:
        return BlockLean(pivot_site_m=pivot, rotation_rad=np.zeros(2), sigma_rad=sigma_rad)
    share = sigma_rad**2 / (sigma_rad**2 + vertical.sigma_rad**2)
    x, y, _ = vertical.up_site
    return BlockLean(
        pivot_site_m=pivot,
        rotation_rad=share * np.array([y, -x]),  # what turns ``up`` into the site's z
        sigma_rad=float(sigma_rad * np.sqrt(1.0 - share)),
    )


def correct_lean(adjusted: AdjustedBlock, lean: BlockLean) -> AdjustedBlock:
    """The block turned by ``lean``: cameras, points and all, so that nothing within it changes."""
    state, turn = adjusted.solution.state, lean.rotation

    def turned(points: Float64Array) -> Float64Array:
        moved: Float64Array = (points - lean.pivot_site_m) @ turn.T + lean.pivot_site_m
        return moved

    moved = replace(
        state,
        centre_site_m=turned(state.centre_site_m),
        site_from_cam=turn @ state.site_from_cam,
        xyz_site_m=turned(state.xyz_site_m),
    )
    return replace(adjusted, solution=replace(adjusted.solution, state=moved))


def describe_lean(vertical: VerticalDirection, lean: BlockLean) -> str:
    """What upright lines said of the block, for the passport."""
    off = float(np.degrees(np.linalg.norm(vertical.up_site[:2])))
    turned = float(np.degrees(np.linalg.norm(lean.rotation_rad)))
    return (
        f"{vertical.lines} upright lines in {vertical.photographs} photographs lean by {off:.2f} deg against the "
        f"model's walls: turned by {turned:.2f} deg, sigma {np.degrees(lean.sigma_rad):.2f} deg"
    )
