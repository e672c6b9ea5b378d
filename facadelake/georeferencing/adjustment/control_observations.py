"""The control of a block in its adjustment: marked points, GPS, tie points of an earlier campaign, building model."""

from __future__ import annotations

from dataclasses import dataclass

from facadelake.core.arrays import Float64Nx2, Float64Nx3, Float64Nx3x3, RowIndices
from facadelake.georeferencing.adjustment.point_to_plane import RaySurface
from facadelake.georeferencing.adjustment.problem import AttitudeTerms, PositionTerms


@dataclass(frozen=True, kw_only=True, eq=False)
class MarkedPoints:
    """Control and check points with their image marks.

    ``names`` (p), ``xyz_site_m`` (p, 3) as surveyed, ``sigma_m`` (p, 3; infinite for a check point, which has no weight
    in the adjustment). Mark k: photograph ``photo[k]`` shows ``point[k]`` at ``xy_img[k]``, within ``sigma_px``.
    ``initial_xyz_site_m`` (p, 3): where the marks intersect in the initial placement, from which the adjustment starts;
    None: as surveyed. A check point may be surveyed tens of metres from there.
    """

    names: tuple[str, ...]
    xyz_site_m: Float64Nx3
    sigma_m: Float64Nx3
    photo: RowIndices
    point: RowIndices
    xy_img: Float64Nx2
    sigma_px: float
    initial_xyz_site_m: Float64Nx3 | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class SharedTiePoints:
    """Tie points that an earlier campaign determined too.

    ``point`` (k,) rows of the reconstruction's points; ``xyz_site_m`` (k, 3) and ``covariance_m2`` (k, 3, 3) of the
    earlier campaign.
    """

    point: RowIndices
    xyz_site_m: Float64Nx3
    covariance_m2: Float64Nx3x3


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceConstraint:
    """The surface of the building model, and one sigma of the building's deviation from it."""

    surface: RaySurface
    sigma_m: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ControlObservations:
    """Everything the block is adjusted to besides its own tie points."""

    positions: PositionTerms
    attitudes: AttitudeTerms
    marked: MarkedPoints | None = None
    shared: SharedTiePoints | None = None
    model: SurfaceConstraint | None = None
