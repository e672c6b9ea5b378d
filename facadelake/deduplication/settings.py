"""What merging is told; every limit has its reason here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot, inf
from typing import Any

from facadelake.core.errors import InputDataError
from schemas.vocabulary import ControlKind

_CHECK_POINTS_MIN = 3
_MEAN_ERROR_3D = 1.596  # mean length of a vector of three errors of one sigma each
GPS_OFFSET_M = 2.0  # one sigma of what all positions of an uncorrected receiver share, after tens of minutes


@dataclass(frozen=True, kw_only=True)
class MergeSettings:
    """When two sightings are of one defect.

    ``size_share``: one sigma of where boxes of one defect have their centres, as a share of the patch's extent: two
    photographs may show different parts of it. ``centre_share``: the same for boxes that show the same part, which
    places the defect. ``floor_m``: one sigma of what is left of the pose; no gate is narrower. ``relief_m``: one sigma
    of how far the real surface stands off the model's. ``gate_sigma``: the normalised distance within which two
    sightings may be one; 3.03 holds 99 % in the plane of the surface. ``ceiling_m``: no two sightings further apart
    than this, or than half their extents together, are one. ``offset_m``: one sigma of how far the whole campaign may
    stand off the model; 0 where control points or the model placed it, the GPS's own error where GPS alone did.
    ``agreement``: share of the pairs between two groups that must lie in the gate to join them. ``block_sigma_m``: one
    sigma, in the mean of the axes, of what moves all places alike, where it was measured; the poses' own covariances
    state more.
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
        """The settings for a campaign placed by ``control``: GPS alone leaves it metres off the model.

        ``checked_m``: mean distance that ``check_points`` held-out points came out from where they were surveyed.
        """
        checked = checked_m is not None and check_points >= _CHECK_POINTS_MIN
        return cls(
            offset_m=GPS_OFFSET_M if control is ControlKind.GPS else 0.0,
            block_sigma_m=(checked_m or 0.0) / _MEAN_ERROR_3D if checked else inf,
        )

    def __post_init__(self) -> None:
        values = (self.size_share, self.centre_share, self.floor_m, self.relief_m, self.gate_sigma, self.ceiling_m)
        if min(values) <= 0 or self.offset_m < 0 or not 0 < self.agreement <= 1:
            raise InputDataError(f"merge settings {self} are out of range: all positive, agreement at most 1")

    @property
    def stand_off_m(self) -> float:
        """One sigma of how far the real surface stands off the model as this campaign sees it."""
        return hypot(self.relief_m, self.offset_m)

    @property
    def reach_m(self) -> float:
        """How far apart two sightings of one small defect may be registered."""
        return max(self.ceiling_m, 3 * self.offset_m)


def resolve_merge_settings(passport: Mapping[str, Any]) -> MergeSettings:
    """What the campaign's row of table ``georeference`` tells the merging."""
    return MergeSettings.build_for_control(
        ControlKind(passport["control"]),
        checked_m=passport["check_residual_mean_m"],
        check_points=passport["check_points"],
    )
