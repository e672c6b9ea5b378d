"""Focal length priors of zoomed photographs: calibrations and 35 mm equivalents, with or without the zoom in them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from facadelake.photos.exif import FULL_FRAME_DIAGONAL_MM
from facadelake.photos.lenses.focal_prior import MAX_LOG_RATIO, SHARE_35MM, SHARE_DESIGNED, FocalPrior

# Two statements of one zoom are equal within the rounding of the 35 mm equivalent and of the factor.
_SAME_SHARE = 0.06
_ROUNDING_35MM_MM = 1.0


@dataclass(frozen=True, kw_only=True)
class ZoomReading:
    """What one photograph states of its zoom, and its focal length without it: by calibration, and by all metadata.

    ``camera`` is the same for photographs by one body, lens and focal length of the lens. ``digital_zooms`` are the
    factors above 1 that the tags state, by tag.
    """

    camera: tuple[object, ...]
    size_px: tuple[int, int]
    digital_zooms: tuple[tuple[str, float], ...]
    focal_length_35mm_mm: float
    calibrated: FocalPrior
    prior: FocalPrior

    @property
    def factor(self) -> float:
        """The largest factor stated, 1 for none."""
        return max((factor for _, factor in self.digital_zooms), default=1.0)


def apply_zooms(readings: Sequence[ZoomReading]) -> list[FocalPrior]:
    """The focal length priors with the digital zoom of each photograph.

    Whether a maker's FocalLengthIn35mmFilm includes the digital zoom follows from the camera's other photographs, or
    from its calibration; where nothing tells, the focal length is unknown, which is better than one of two guesses.
    """
    usual_35mm = _find_usual_35mm(readings)
    return [_apply_zoom(reading, usual_35mm.get(_get_group(reading), math.nan)) for reading in readings]


def _get_group(reading: ZoomReading) -> tuple[object, ...]:
    return (*map(str, reading.camera), reading.size_px)


def _find_usual_35mm(readings: Sequence[ZoomReading]) -> dict[tuple[object, ...], float]:
    """The most frequent FocalLengthIn35mmFilm of each camera's photographs without a stated zoom."""
    stated: dict[tuple[object, ...], Counter[float]] = {}
    for reading in readings:
        if reading.factor == 1.0 and math.isfinite(reading.focal_length_35mm_mm):
            stated.setdefault(_get_group(reading), Counter())[reading.focal_length_35mm_mm] += 1
    return {group: max(counts, key=lambda mm: (counts[mm], -mm)) for group, counts in stated.items()}


def _apply_zoom(reading: ZoomReading, usual_35mm_mm: float) -> FocalPrior:
    prior, factor = reading.prior, reading.factor
    by_35mm = reading.focal_length_35mm_mm
    if factor == 1.0:
        return _apply_unstated_zoom(reading, usual_35mm_mm)
    tags = ", ".join(f"{tag} {value:g}" for tag, value in reading.digital_zooms)
    values = [value for _, value in reading.digital_zooms]
    if len(values) > 1 and not _are_equal(min(values), max(values)):
        return _forget(prior, f"digital zoom: {tags} disagree; the focal length is taken as unknown and estimated")
    by_35mm_px = by_35mm * math.hypot(*reading.size_px) / FULL_FRAME_DIAGONAL_MM
    if not math.isfinite(prior.px):
        return prior
    calibrated = reading.calibrated
    if math.isfinite(calibrated.px):  # of the full sensor
        zoomed = _multiply(
            calibrated, factor, f"{calibrated.evidence} times digital zoom {factor:g} ({tags})", SHARE_DESIGNED
        )
        expected_px = (calibrated.px, zoomed.px)
        if math.isnan(by_35mm_px) or any(abs(math.log(by_35mm_px / px)) < MAX_LOG_RATIO for px in expected_px):
            return zoomed
        return _forget(
            FocalPrior(),
            f"focal length: {calibrated.evidence} gives {calibrated.px:.0f} px, {zoomed.px:.0f} px with digital zoom "
            f"{factor:g} ({tags}), FocalLengthIn35mmFilm {by_35mm_px:.0f} px; it is taken as unknown and estimated",
        )
    if "FocalPlane" in prior.evidence:
        if math.isfinite(by_35mm_px) and _are_equal(by_35mm_px, prior.px * factor):
            return _multiply(prior, factor, f"{prior.evidence} times digital zoom {factor:g} ({tags})", SHARE_DESIGNED)
        return _forget(prior, f"digital zoom {factor:g} ({tags}): unknown whether {prior.evidence} includes it; "
                       "the focal length is estimated")  # fmt: skip
    if math.isfinite(usual_35mm_mm) and _are_equal(by_35mm, usual_35mm_mm * factor):
        return replace(prior, evidence=f"{prior.evidence}, which includes digital zoom {factor:g} ({tags})")
    if math.isfinite(usual_35mm_mm) and _are_equal(by_35mm, usual_35mm_mm):
        return _multiply(prior, factor, f"{prior.evidence} times digital zoom {factor:g} ({tags})", SHARE_35MM)
    return _forget(
        prior,
        f"digital zoom {factor:g} ({tags}): unknown whether FocalLengthIn35mmFilm {by_35mm:g} mm includes it; "
        "the focal length is estimated",
    )


def _apply_unstated_zoom(reading: ZoomReading, usual_35mm_mm: float) -> FocalPrior:
    """A 35 mm equivalent other than the camera's usual one, beside the same focal length or calibration, is a zoom."""
    prior, by_35mm = reading.prior, reading.focal_length_35mm_mm
    if not math.isfinite(usual_35mm_mm) or not math.isfinite(by_35mm) or not math.isfinite(prior.px):
        return prior
    if abs(by_35mm - usual_35mm_mm) <= _ROUNDING_35MM_MM or "FocalLengthIn35mmFilm" in prior.evidence:
        return prior
    factor = by_35mm / usual_35mm_mm
    zoomed = _multiply(
        prior, factor, f"{prior.evidence} times {factor:.3g} (FocalLengthIn35mmFilm {by_35mm:g} mm)", SHARE_35MM
    )
    return replace(
        zoomed,
        warning=f"focal length: FocalLengthIn35mmFilm is {by_35mm:g} mm, {usual_35mm_mm:g} mm in the other photographs "
        f"of the camera with the same {prior.evidence}; taken as a zoom of {factor:.3g}",
    )


def _multiply(prior: FocalPrior, factor: float, evidence: str, share: float) -> FocalPrior:
    """The prior at a zoom; a calibration is not valid for it, and the factor is rounded."""
    px = prior.px * factor
    return FocalPrior(
        px=px, sigma_px=max(share * px, prior.sigma_px * factor), evidence=evidence, warning=prior.warning
    )


def _forget(prior: FocalPrior, warning: str) -> FocalPrior:
    return FocalPrior(warning="; ".join(part for part in (prior.warning, warning) if part))


def _are_equal(one: float, other: float) -> bool:
    return abs(math.log(one / other)) < _SAME_SHARE
