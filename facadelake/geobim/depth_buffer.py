"""Depth buffer values to metres before the eye."""

from __future__ import annotations

from facadelake.core.frames import Array


def eye_depth(z_s: Array, near_m: float, far_m: float) -> Array:
    """Depth along the camera's z of depth buffer values ``z_s`` in [0, 1] (any shape), metres.

    The paper's Eq. 7 reads ``n / (z_s (f - n) + f)``, which is n / f at the near plane and has no unit; its own Eqs. 5
    and 6 give ``f n / (f - z_s (f - n))``: n at z_s = 0 and f at z_s = 1.
    """
    depth: Array = far_m * near_m / (far_m - z_s * (far_m - near_m))
    return depth


def buffer_step(depth_m: Array, near_m: float, far_m: float, bits: int = 24) -> Array:
    """How far apart two neighbouring values of the buffer lie at ``depth_m``, metres: the buffer's resolution there."""
    step: Array = depth_m**2 * (far_m - near_m) / (far_m * near_m) / 2**bits
    return step
