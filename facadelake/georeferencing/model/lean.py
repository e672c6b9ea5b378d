"""The lean of a block placed by the model: its estimate by plumb lines, its correction, and its remaining covariance.

A wall within tolerance of its model may deviate at the top and not at the foot. A block that is adjusted to walls
leans with them: the farther a camera stands from the wall, the more it rises or sinks. The adjustment has a deviation
for each wall as a whole, not for its lean; plumb lines in the photographs determine the vertical without the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from facadelake.core.arrays import Float64Array, Float64Nx3, Float64x3, Float64x3x3
from facadelake.georeferencing.adjustment.adjusted_block import AdjustedBlock
from facadelake.georeferencing.adjustment.linearise import build_skew_matrices
from facadelake.georeferencing.model.plumb_lines import VerticalDirection

_RIM_PERCENT = 2.0
_MIN_HALF_HEIGHT_M = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockLean:
    """The rotation about ``pivot_site_m`` (3,), the centre of the walls, that corrects a block's lean.

    ``rotation_rad`` (2,): about east and about north; ``sigma_rad``: one sigma of each after the correction.
    """

    pivot_site_m: Float64x3
    rotation_rad: Float64Array
    sigma_rad: float

    @property
    def rotation(self) -> Float64x3x3:
        """The rotation as a matrix (3, 3)."""
        matrix: Float64Array = Rotation.from_rotvec([*self.rotation_rad, 0.0]).as_matrix()
        return matrix

    def compute_covariance(self, adjusted: AdjustedBlock) -> Float64Array:
        """Covariance (n, 6, 6) that the lean adds to the photographs (centre in m, attitude in rad)."""
        state = adjusted.solution.state
        arm = state.centre_site_m - self.pivot_site_m
        # A rotation w moves a point by w cross arm = -(arm cross w), and a camera's axes by its own rotation of w.
        jacobian = np.concatenate([-build_skew_matrices(arm), state.site_from_cam.transpose(0, 2, 1)], axis=1)[:, :, :2]
        covariance: Float64Array = self.sigma_rad**2 * jacobian @ jacobian.transpose(0, 2, 1)
        return covariance


def estimate_lean(adjusted: AdjustedBlock, model_sigma_m: float, vertical: VerticalDirection | None) -> BlockLean:
    """The lean of a block adjusted to walls, from two observations: walls are plumb, and plumb lines.

    Walls are plumb to ``model_sigma_m`` over half the height of those in the adjustment. Without plumb lines the lean
    is zero with that sigma.
    """
    state = adjusted.solution.state
    on_walls = state.xyz_site_m[adjusted.problem.point_to_plane.point]
    if not len(on_walls):
        return BlockLean(pivot_site_m=np.zeros(3), rotation_rad=np.zeros(2), sigma_rad=0.0)
    low, high = np.percentile(on_walls[:, 2], [_RIM_PERCENT, 100.0 - _RIM_PERCENT])
    sigma_rad = model_sigma_m / max((high - low) / 2.0, _MIN_HALF_HEIGHT_M)
    pivot = np.median(on_walls, axis=0)
    if vertical is None:
        return BlockLean(pivot_site_m=pivot, rotation_rad=np.zeros(2), sigma_rad=sigma_rad)
    share = sigma_rad**2 / (sigma_rad**2 + vertical.sigma_rad**2)
    x, y, _ = vertical.up_site
    return BlockLean(
        pivot_site_m=pivot,
        rotation_rad=share * np.array([y, -x]),  # rotates ``up`` to the site's z
        sigma_rad=float(sigma_rad * np.sqrt(1.0 - share)),
    )


def correct_lean(adjusted: AdjustedBlock, lean: BlockLean) -> AdjustedBlock:
    """The block rotated by ``lean`` as a whole: cameras and points, so that its inner geometry does not change."""
    state, rotation = adjusted.solution.state, lean.rotation

    def rotate(points: Float64Nx3) -> Float64Nx3:
        rotated: Float64Array = (points - lean.pivot_site_m) @ rotation.T + lean.pivot_site_m
        return rotated

    corrected = replace(
        state,
        centre_site_m=rotate(state.centre_site_m),
        site_from_cam=rotation @ state.site_from_cam,
        xyz_site_m=rotate(state.xyz_site_m),
    )
    return replace(adjusted, solution=replace(adjusted.solution, state=corrected))


def describe_lean(vertical: VerticalDirection, lean: BlockLean) -> str:
    """The lean in words, for the passport."""
    deviation = float(np.degrees(np.linalg.norm(vertical.up_site[:2])))
    rotation = float(np.degrees(np.linalg.norm(lean.rotation_rad)))
    return (
        f"{vertical.lines} plumb lines in {vertical.photographs} photographs deviate by {deviation:.2f} deg from the "
        f"vertical of the model's walls: block rotated by {rotation:.2f} deg, "
        f"sigma {np.degrees(lean.sigma_rad):.2f} deg"
    )
