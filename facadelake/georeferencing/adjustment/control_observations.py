"""What a block is adjusted to: control points, GPS, known points, the building's model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array, RowIndices
from facadelake.core.camera import Camera
from facadelake.georeferencing.adjustment.point_to_plane import RaySurface
from facadelake.georeferencing.adjustment.problem import AttitudeTerms, PositionTerms

# What is known of a lens before it is adjusted (LENS_TERMS' order); focal length and principal point are relative to
# the focal length and the image's width. Sensors' pixels are square to a fraction of a percent.
LENS_PRIOR_SIGMA = (0.05, 0.005, 0.02, 0.02, 0.3, 0.3, 0.02, 0.02)


@dataclass(frozen=True, kw_only=True, eq=False)
class MarkedPoints:
    """Surveyed points: ``names`` (p), ``xyz_site_m`` (p, 3), ``sigma_m`` (p, 3; inf: a check point, which holds
    nothing), and their marks: ``photo`` (k,), ``point`` (k,), ``xy_img`` (k, 2), within ``sigma_px``."""

    names: tuple[str, ...]
    xyz_site_m: Float64Array
    sigma_m: Float64Array
    photo: RowIndices
    point: RowIndices
    xy_img: Float64Array
    sigma_px: float


@dataclass(frozen=True, kw_only=True, eq=False)
class SharedTiePoints:
    """Tie points that another campaign knows: ``point`` (k,) rows of the reconstruction's points, ``xyz_site_m``
    (k, 3) and ``covariance_m2`` (k, 3, 3)."""

    point: RowIndices
    xyz_site_m: Float64Array
    covariance_m2: Float64Array


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceConstraint:
    """The building's model: its surface, and how far the building may stand off it (one sigma)."""

    surface: RaySurface
    sigma_m: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ControlObservations:
    """All that the block is adjusted to, besides its own tie points."""

    positions: PositionTerms
    attitudes: AttitudeTerms
    marked: MarkedPoints | None = None
    known: SharedTiePoints | None = None
    model: SurfaceConstraint | None = None


def build_lens_prior(cameras: Sequence[Camera], free: BoolArray) -> tuple[Float64Array, Float64Array]:
    """Mean and sigma (c, 8) of the lenses; terms not ``free`` (8,) are held at their mean."""
    mean = np.array(
        [[camera.fx_px, 1.0, camera.width_px / 2, camera.height_px / 2, 0.0, 0.0, 0.0, 0.0] for camera in cameras]
    )
    unit = np.array([[c.fx_px, 1.0, c.width_px, c.width_px, 1.0, 1.0, 1.0, 1.0] for c in cameras])
    return mean, np.where(free, np.array(LENS_PRIOR_SIGMA) * unit, 0.0)
