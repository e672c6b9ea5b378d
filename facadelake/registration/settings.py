"""What registration is told; every limit has its reason here."""

from __future__ import annotations

from dataclasses import dataclass

from facadelake.core.errors import InputDataError
from facadelake.registry import Building
from schemas.vocabulary import SurfaceKind

# Beyond this a place on a surface of tie points slides by twice what the surface is off, and bridges over what was not
# photographed are met: with them as the only surface, a sighting would be metres off.
TIE_POINTS_GRAZING_DEG = 60.0


@dataclass(frozen=True, kw_only=True)
class RegistrationSettings:
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


def resolve_registration_settings(building: Building) -> RegistrationSettings:
    """The registry's tolerances, as registration takes them."""
    limits = building.tolerances
    on_tie_points = building.surface_kind is SurfaceKind.AS_BUILT
    return RegistrationSettings(
        grazing_above_deg=min(limits.grazing_above_deg, TIE_POINTS_GRAZING_DEG if on_tie_points else 90.0),
        target_share_min=limits.target_share_min,
        model_sigma_m=limits.model_sigma_m,
    )
