"""Settings of merging; each limit states its reason."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from typing import Any

from facadelake.core.errors import InputDataError
from schemas.vocabulary import ControlKind

_CHECK_POINTS_MIN = 3
_MEAN_ERROR_3D = 1.596  # mean length of a vector of three errors of one sigma each
GPS_OFFSET_M = 2.0  # one sigma of the common error of uncorrected GPS positions over tens of minutes


@dataclass(frozen=True, kw_only=True)
class MergeSettings:
    """When two observations are of one defect.

    ``size_share``: one sigma of the box centres of one defect, as a share of the patch's extent: two photographs may
    show different parts of it; it sets the gate. ``centre_share``: the same for boxes that show the same part; it
    weighs the rays of the triangulation. ``floor_m``: one sigma of the residual error of the poses; the minimum width
    of the gate. ``relief_m``: one sigma of the distance of the real surface from the model. ``gate_sigma``: limit of
    the Mahalanobis distance; 3.03 contains 99 % of the errors in the plane of the surface (chi-square, two degrees of
    freedom). ``ceiling_m``: maximum distance of two observations of one defect, unless half their extents together are
    more. ``offset_m``: one sigma of the offset of the whole campaign from the model; 0 with control points or the model
    as control, the error of the GPS with GPS alone. ``agreement``: share of the pairs between two groups that must be
    in the gate to join them. ``block_sigma_m``: one sigma, mean of the axes, of the common error of all positions,
    where check points measured it; otherwise inf, and the covariances of the poses hold.
    """

    size_share: float = 0.15
    centre_share: float = 0.05
    floor_m: float = 0.015
    relief_m: float = 0.05
    gate_sigma: float = 3.03
    ceiling_m: float = 0.5
    offset_m: float = 0.0
    agreement: float = 0.5
    block_sigma_m: float = inf

    @classmethod
    def build_for_control(
        cls, control: ControlKind, *, checked_m: float | None = None, check_points: int = 0
    ) -> MergeSettings:
        """The settings for a campaign with this control; GPS alone leaves an offset of metres.

        ``checked_m``: mean residual at ``check_points`` check points.
        """
        is_checked = checked_m is not None and check_points >= _CHECK_POINTS_MIN
        return cls(
            offset_m=GPS_OFFSET_M if control is ControlKind.GPS else 0.0,
            block_sigma_m=(checked_m or 0.0) / _MEAN_ERROR_3D if is_checked else inf,
        )

    def __post_init__(self) -> None:
        values = (self.size_share, self.centre_share, self.floor_m, self.relief_m, self.gate_sigma, self.ceiling_m)
        if min(values) <= 0 or self.offset_m < 0 or not 0 < self.agreement <= 1:
            raise InputDataError(
                f"merge settings are out of range: {self}; required: size_share, centre_share, floor_m, relief_m, "
                "gate_sigma and ceiling_m > 0, offset_m >= 0, agreement in (0, 1]"
            )

    @property
    def reach_m(self) -> float:
        """Maximum distance of two observations of one small defect, in m."""
        return max(self.ceiling_m, 3 * self.offset_m)


def resolve_merge_settings(passport: Mapping[str, Any]) -> MergeSettings:
    """The settings for a campaign, from its row of table ``georeference``."""
    return MergeSettings.build_for_control(
        ControlKind(passport["control"]),
        checked_m=passport["check_residual_mean_m"],
        check_points=passport["check_points"],
    )
