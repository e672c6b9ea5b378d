"""What registration and merging are told; every limit has its reason here."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, inf

from facadelake.core.errors import InputDataError
from schemas.vocabulary import ControlKind

_CHECK_POINTS_LEAST = 3
_MEAN_OF_3D = 1.596  # mean length of a vector of three errors of one sigma each
# Beyond this a place on a surface of tie points slides by twice what the surface is off, and bridges over what was not
# photographed are met: with them as the only surface, a sighting would be metres off.
TIE_POINTS_GRAZING_DEG = 60.0
GPS_OFFSET_M = 2.0  # one sigma of what all positions of an uncorrected receiver share, after tens of minutes


@dataclass(frozen=True, kw_only=True)
class RegisterSettings:
    """How detections are put on the surface.

    ``rays_per_side``: each box is sampled by that many rays squared; odd, so that one is the centre.
    ``grazing_above_deg``: beyond this incidence a pixel smears over the wall and the position with it.
    ``target_share_min``: a box of which less meets the building is off target. ``step_m``: neighbouring hits whose
    surfaces lie further apart belong to different surfaces. ``near_m``: a surface nearer to the camera is not what the
    photograph shows (nobody flies that close): the camera stands beside or, by its pose's error, inside the model.
    ``pixel_sigma_px``: one sigma of a pixel's own place, each axis. ``box_sigma_share``: one sigma of a box's middle
    about what it was drawn around, as a share of its size. People agree on boxes to an IoU of about 0.9, which is 3 %;
    a detector's box counts as right from an IoU of 0.5 up, which, spread evenly up to 1, is 6 %. ``model_sigma_m``: one
    sigma of how far the building stands off its model.
    """

    rays_per_side: int = 11
    grazing_above_deg: float = 80.0
    target_share_min: float = 0.5
    step_m: float = 0.05
    near_m: float = 0.5
    pixel_sigma_px: float = 0.5
    box_sigma_share: float = 0.06
    model_sigma_m: float = 0.03
    detections_per_cast: int = 4096

    def __post_init__(self) -> None:
        if self.rays_per_side < 3 or self.rays_per_side % 2 == 0:
            raise InputDataError(f"rays_per_side is {self.rays_per_side}; it must be an odd number of 3 or more")
        if not (
            0 < self.grazing_above_deg <= 90
            and 0 <= self.target_share_min <= 1
            and self.step_m > 0
            and self.near_m >= 0
            and self.pixel_sigma_px > 0
            and self.box_sigma_share >= 0
            and self.model_sigma_m > 0
        ):
            raise InputDataError(
                f"registration settings {self} are out of range: grazing_above_deg 0..90, target_share_min 0..1, "
                "step_m, pixel_sigma_px and model_sigma_m above 0, near_m and box_sigma_share not below"
            )


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
    def under(cls, control: ControlKind, *, checked_m: float | None = None, check_points: int = 0) -> MergeSettings:
        """The settings for a campaign placed by ``control``: GPS alone leaves it metres off the model.

        ``checked_m``: mean distance that ``check_points`` held-out points came out from where they were surveyed.
        """
        checked = checked_m is not None and check_points >= _CHECK_POINTS_LEAST
        return cls(
            offset_m=GPS_OFFSET_M if control is ControlKind.GPS else 0.0,
            block_sigma_m=(checked_m or 0.0) / _MEAN_OF_3D if checked else inf,
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
