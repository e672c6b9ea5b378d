"""Photographs that are no central projection of visible light, or repeat another one: kept out of the block.

Thermal pictures, single spectral bands and panoramas do not match photographs, or follow another camera model; a lens
that fires together with another one of its body adds no viewpoint. Each is a row of ``photos`` with its reason.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta

from facadelake.photos.priors import PhotoMetadata
from schemas.vocabulary import PhotoOutcome

# Sizes of microbolometers, and of the pictures made of them in the camera (twice the size).
_THERMAL_SIZES_PX = frozenset(
    {(160, 120), (206, 156), (240, 180), (320, 240), (320, 256), (336, 256), (384, 288), (640, 480), (640, 512)}
    | {(1024, 768), (1280, 960), (1280, 1024)}
)
_THERMAL_MAKERS = ("FLIR", "INFIRAY", "HIKMICRO", "OPTRIS", "TESTO", "WORKSWELL", "GUIDE SENSMART")
_THERMAL_MODELS = re.compile(
    r"\b(FLIR|ZENMUSE XT|XT2|XT S|TAU ?2|VUE|BOSON|WIRIS|DUO PRO|THERMAL|LEPTON)\b", re.IGNORECASE
)
_LARGEST_SENSOR_PX = 640  # larger sizes alone are no sign of a thermal sensor
# A visible photograph of the campaign has at least so many times the width of a thermal one.
_THERMAL_WIDTH_RATIO = 2.5
# The widest screens and sensors are 2.22 : 1 (20:9); wider pictures are stitched. 2:1 is a full equirectangular one.
_WIDEST_RATIO = 2.3
_SPHERE_RATIO_TOLERANCE = 0.005
_MIN_PANORAMA_PX = 2000  # smaller pictures are crops
_SPHERE_MAKERS = ("RICOH", "INSTA360", "ARASHI VISION", "GOPRO MAX", "KANDAO", "GARMIN VIRB 360")
_TOGETHER = timedelta(seconds=1.5)
_SEVERAL_LENSES = re.compile(r"_(W|Z|T|THRM|IR|V|S)((?:_[^_]+)?\.[^.]+)$", re.IGNORECASE)
# Of lenses that fire together the first of these is used: it sees most.
_PREFERRED_SOURCES = ("wide", "visible", "zoom", "screen")


@dataclass(frozen=True, kw_only=True)
class KeptOut:
    """Outcome and reason of a photograph that is kept out of the block."""

    outcome: PhotoOutcome
    reason: str


def find_kept_out(photos: Sequence[PhotoMetadata], used_kinds: Collection[PhotoOutcome] = ()) -> dict[str, KeptOut]:
    """The photographs to keep out of the block, by photo_id.

    Args:
        photos: all readable photographs of the campaign.
        used_kinds: kinds that the portfolio uses nevertheless (key ``use_photographs``).

    Returns:
        Outcome and reason; photographs to use are absent.
    """
    widest_px = max((max(photo.width_px, photo.height_px) for photo in photos), default=0)
    found = {}
    for photo in photos:
        kept_out = _check_thermal(photo, widest_px) or _check_panorama(photo) or _check_spectral_band(photo)
        if kept_out is not None and kept_out.outcome not in used_kinds:
            found[photo.photo_id] = kept_out
    if PhotoOutcome.OTHER_LENS not in used_kinds:
        found |= _find_companions([photo for photo in photos if photo.photo_id not in found])
    return found


def _keep_out(outcome: PhotoOutcome, reason: str) -> KeptOut:
    return KeptOut(
        outcome=outcome,
        reason=f"{reason}; it is kept out of the block ('use_photographs: [{outcome}]' in the portfolio uses it)",
    )


def _check_thermal(photo: PhotoMetadata, widest_px: int) -> KeptOut | None:
    width, height = max(photo.width_px, photo.height_px), min(photo.width_px, photo.height_px)
    size = f"{photo.width_px} x {photo.height_px} px"
    thermal_size = (width, height) in _THERMAL_SIZES_PX
    evidence = ""
    if photo.lens.image_source == "thermal":
        evidence = photo.lens.evidence
    elif photo.exif.make.upper().startswith(_THERMAL_MAKERS):
        evidence = f"EXIF Make {photo.exif.make}"
    elif thermal_size and _THERMAL_MODELS.search(photo.exif.model):
        evidence = f"EXIF Model {photo.exif.model}, {size}"
    elif thermal_size and width <= _LARGEST_SENSOR_PX and widest_px >= _THERMAL_WIDTH_RATIO * width:
        evidence = f"{size}, the size of a thermal sensor, beside photographs of {widest_px} px"
    return _keep_out(PhotoOutcome.THERMAL, f"a thermal picture ({evidence})") if evidence else None


def _check_panorama(photo: PhotoMetadata) -> KeptOut | None:
    width, height = max(photo.width_px, photo.height_px), min(photo.width_px, photo.height_px)
    evidence = ""
    if photo.lens.projection and photo.lens.projection.lower() not in ("rectilinear", "perspective"):
        evidence = f"XMP GPano ProjectionType {photo.lens.projection}"
    elif width >= _MIN_PANORAMA_PX and width / height >= _WIDEST_RATIO:
        evidence = f"{photo.width_px} x {photo.height_px} px; no sensor is wider than {_WIDEST_RATIO} : 1"
    elif width >= _MIN_PANORAMA_PX and abs(width / height - 2) <= 2 * _SPHERE_RATIO_TOLERANCE:
        camera = photo.camera.upper()
        if "PANO" in photo.photo_id.upper() or any(maker in camera for maker in _SPHERE_MAKERS):
            evidence = f"{photo.width_px} x {photo.height_px} px, the 2 : 1 of a sphere, by {photo.camera.strip()}"
    return _keep_out(PhotoOutcome.PANORAMA, f"a panorama, no central projection ({evidence})") if evidence else None


def _check_spectral_band(photo: PhotoMetadata) -> KeptOut | None:
    if not photo.lens.band:
        return None
    return _keep_out(PhotoOutcome.SPECTRAL_BAND, f"a single spectral band ({photo.lens.band})")


def _find_companions(photos: Sequence[PhotoMetadata]) -> Mapping[str, KeptOut]:
    """Photographs that another lens of the same body took together with a preferred one: no viewpoint of their own."""
    found = {}
    by_body: dict[str, list[PhotoMetadata]] = {}
    for photo in photos:
        if photo.lens.image_source in _PREFERRED_SOURCES:
            by_body.setdefault(photo.body, []).append(photo)
    for members in by_body.values():
        timed = sorted((p.exif.taken_at, p.photo_id, p) for p in members if p.exif.taken_at is not None)
        for k, (taken_at, _, photo) in enumerate(timed):
            companion = next(
                (
                    other
                    for at, _, other in timed[max(0, k - 4) : k + 5]
                    if abs(at - taken_at) <= _TOGETHER
                    and _rank(other) < _rank(photo)
                    and _strip_lens(other.photo_id) in ("", _strip_lens(photo.photo_id))
                ),
                None,
            )
            if companion is not None:
                found[photo.photo_id] = _keep_out(
                    PhotoOutcome.OTHER_LENS,
                    f"taken by the {photo.lens.image_source} lens ({photo.lens.evidence}) together with "
                    f"{companion.photo_id} of the {companion.lens.image_source} lens, from the same place",
                )
    return found


def _rank(photo: PhotoMetadata) -> int:
    return _PREFERRED_SOURCES.index(photo.lens.image_source)


def _strip_lens(photo_id: str) -> str:
    """The sequence number in a name such as DJI_20260414100005_0007_W.JPG, which lenses of one exposure share."""
    stem = _SEVERAL_LENSES.sub("", photo_id)
    return stem.rpartition("_")[2] if stem != photo_id else ""
