"""Settings of registration; each limit states its reason."""

from __future__ import annotations

from dataclasses import dataclass

from facadelake.core.errors import InputDataError
from facadelake.registry import Building
from schemas.vocabulary import SurfaceKind

# Beyond this incidence a position on a surface of tie points shifts by more than twice the surface's error, and rays
# meet triangles that bridge parts which no photograph shows: an observation would be metres off.
AS_BUILT_GRAZING_DEG = 60.0


@dataclass(frozen=True, kw_only=True)
class RegistrationSettings:
    """How detections are registered on the surface.

    ``rays_per_side``: each box is sampled by the square of this many rays; odd, so that one is the centre.
    ``grazing_above_deg``: incidence above which an observation is rejected, as a pixel's footprint and the error of
    the position grow without bound. ``target_share_min``: a detection of which a smaller share of the rays meets the
    building is off target. ``step_m``: neighbouring hits farther than this from one another's tangent planes belong to
    different surfaces. ``near_m``: near clipping distance; a surface nearer to the camera is not what the photograph
    shows, as the camera then is inside or beside the model by the error of its pose.

    ``pixel_sigma_px``: one sigma of a pixel's position, each axis. ``box_sigma_share``: one sigma of a box's centre
    about the centre of the object, as a share of the box's size. Annotators agree on boxes to an IoU of about 0.9,
    which is 3 %; a detector's box counts as correct from an IoU of 0.5, which is 6 % if the IoU is uniform between 0.5
    and 1. ``model_sigma_m``: one sigma of the distance of the real surface from its model.
    ``detections_per_cast``: detections per batch of ray casting; limits memory.
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
                f"registration settings are out of range: {self}; required: grazing_above_deg in (0, 90], "
                "target_share_min in [0, 1], step_m, pixel_sigma_px and model_sigma_m > 0, near_m and "
                "box_sigma_share >= 0"
            )


def resolve_registration_settings(building: Building) -> RegistrationSettings:
    """The settings for a registered building, from the portfolio's tolerances.

    A building without a model is registered on its as-built surface, which lowers the limit of the incidence.
    """
    limits = building.tolerances
    is_as_built = building.surface_kind is SurfaceKind.AS_BUILT
    return RegistrationSettings(
        grazing_above_deg=min(limits.grazing_above_deg, AS_BUILT_GRAZING_DEG if is_as_built else 90.0),
        target_share_min=limits.target_share_min,
        model_sigma_m=limits.model_sigma_m,
    )
