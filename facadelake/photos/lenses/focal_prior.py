"""Focal length priors: the maker's calibration, else the values of EXIF, each with its sigma and evidence."""

from __future__ import annotations

import math
from dataclasses import dataclass

from facadelake.photos.drone_xmp import DroneMetadata
from facadelake.photos.exif import FULL_FRAME_DIAGONAL_MM, ExifMetadata

# Calibration of the individual camera; temperature and focus change it by tenths of a percent.
SHARE_CALIBRATED = 0.003
# Design value of the lens; individual lenses differ (a P4 Multispectral: 1913 px by design, 1973 and 1956 px
# calibrated).
SHARE_DESIGNED = 0.03
# Focal length divided by pixel pitch: the nominal focal length is rounded.
SHARE_FOCAL_PLANE = 0.02
# The 35 mm equivalent is rounded to millimetres and often refers to the full sensor where the photograph is cropped
# (16:9): 26 mm instead of 28.8 mm on a FC220.
SHARE_35MM = 0.06
# Largest absolute logarithm of the ratio of two values of one photograph; beyond it one of them is wrong (digital zoom,
# another lens, resizing).
MAX_LOG_RATIO = 0.25


@dataclass(frozen=True, kw_only=True)
class FocalPrior:
    """Focal length and its standard deviation in px of the stored size, NaN where unknown.

    ``calibration`` is that of the maker for the stored size: fx, fy, cx, cy in px, k1, k2, p1, p2, k3 (OpenCV's order);
    empty where there is none.
    """

    px: float = math.nan
    sigma_px: float = math.nan
    evidence: str = ""
    calibration: str = ""
    warning: str = ""


def derive_focal_prior(drone: DroneMetadata | None, exif: ExifMetadata, *, width_px: int, height_px: int) -> FocalPrior:
    """The most accurate focal length of the metadata: by calibration, by design, else by EXIF.

    Args:
        drone: XMP metadata; None where no drone wrote any.
        exif: EXIF metadata.
        width_px: width of the stored photograph.
        height_px: height of the stored photograph.

    Returns:
        The prior; its ``px`` is NaN where no focal length is stated.
    """
    by_exif = _read_exif_focal(exif, width_px, height_px)
    calibrated = derive_calibrated_focal(drone, width_px=width_px, height_px=height_px)
    if not math.isfinite(calibrated.px):
        return by_exif
    if math.isfinite(by_exif.px) and abs(math.log(calibrated.px / by_exif.px)) > MAX_LOG_RATIO:
        return FocalPrior(
            px=by_exif.px,
            sigma_px=by_exif.sigma_px,
            evidence=by_exif.evidence,
            warning=f"focal length: {calibrated.evidence} gives {calibrated.px:.0f} px, {by_exif.evidence} "
            f"{by_exif.px:.0f} px; the former belongs to another zoom or image size and is not used",
        )
    return calibrated


def derive_calibrated_focal(drone: DroneMetadata | None, *, width_px: int, height_px: int) -> FocalPrior:
    """The focal length by the maker's calibration or design alone; its ``px`` is NaN where none is stated."""
    return _read_drone_focal(drone, width_px, height_px) if drone is not None else FocalPrior()


def _read_exif_focal(exif: ExifMetadata, width_px: int, height_px: int) -> FocalPrior:
    by_plane = exif.focal_plane_focal_px
    by_35mm = exif.focal_length_35mm_mm * math.hypot(width_px, height_px) / FULL_FRAME_DIAGONAL_MM
    # The focal plane resolution has more digits, but some phones write wrong values: it must agree with the equivalent.
    plane_is_consistent = math.isnan(by_35mm) or abs(math.log(by_plane / by_35mm)) < MAX_LOG_RATIO
    if math.isfinite(by_plane) and plane_is_consistent:
        evidence = "EXIF FocalLength and FocalPlaneXResolution"
        return FocalPrior(px=by_plane, sigma_px=SHARE_FOCAL_PLANE * by_plane, evidence=evidence)
    if math.isnan(by_35mm):
        return FocalPrior()
    warning = (
        f"focal length: EXIF FocalPlaneXResolution gives {by_plane:.0f} px, FocalLengthIn35mmFilm {by_35mm:.0f} px; "
        "the latter is used"
    )
    return FocalPrior(
        px=by_35mm,
        sigma_px=SHARE_35MM * by_35mm,
        evidence=f"EXIF FocalLengthIn35mmFilm {exif.focal_length_35mm_mm:g} mm",
        warning=warning if math.isfinite(by_plane) else "",
    )


def _read_drone_focal(drone: DroneMetadata, width_px: int, height_px: int) -> FocalPrior:
    # The stated centre implies the image size of the values; makers state it for the full photograph.
    scale = width_px / drone.calibrated_width_px if drone.calibrated_width_px > 0 else 1.0
    scale = 1.0 if abs(scale - 1) < 0.01 else scale
    resized = "" if scale == 1.0 else f", scaled by {scale:.4f} to the stored size"
    dewarp = drone.dewarp
    if dewarp is not None:
        px = scale * (dewarp.fx_px + dewarp.fy_px) / 2
        if drone.dewarped:
            # The camera matrix of the dewarped photograph is not stated; DJI's guides keep fx and fy.
            evidence = f"XMP DewarpData of a photograph dewarped in the camera{resized}"
            return FocalPrior(px=px, sigma_px=SHARE_FOCAL_PLANE * px, evidence=evidence)
        centre = (width_px / 2 + scale * dewarp.centre_x_px, height_px / 2 + scale * dewarp.centre_y_px)
        numbers = (
            scale * dewarp.fx_px,
            scale * dewarp.fy_px,
            *centre,
            dewarp.k1,
            dewarp.k2,
            dewarp.p1,
            dewarp.p2,
            dewarp.k3,
        )
        return FocalPrior(
            px=px,
            sigma_px=SHARE_CALIBRATED * px,
            evidence=f"XMP DewarpData{resized}",
            calibration=", ".join(f"{number:.10g}" for number in numbers),
        )
    px = scale * drone.calibrated_focal_px
    if not px > 0:
        return FocalPrior()
    share = SHARE_CALIBRATED if drone.factory_calibrated else SHARE_DESIGNED
    return FocalPrior(px=px, sigma_px=share * px, evidence=f"XMP CalibratedFocalLength{resized}")
