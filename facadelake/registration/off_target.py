"""Whether so many detections lie beside the building that model, poses or detector may be wrong."""

from __future__ import annotations

from collections.abc import Mapping

from schemas.vocabulary import ObservationOutcome, SurfaceKind

# Detections beside the building are rare where photographs show little else; below ten, chance decides.
_MIN_DETECTIONS, _OFF_TARGET_SHARE_MAX = 10, 1 / 3
_NOT_SEEN = (ObservationOutcome.UNLOCALISED, ObservationOutcome.MASKED, ObservationOutcome.OUTSIDE)


def describe_off_target(counts: Mapping[str, int], surface_kind: SurfaceKind) -> str:
    """Warning where more than a third of a campaign's detections are not on the building; empty where they are few.

    ``counts``: observations by outcome. ``surface_kind``: for a mesh the keys that may be wrong are named.
    """
    seen = sum(counts.values()) - sum(counts.get(outcome, 0) for outcome in _NOT_SEEN)
    off_target = counts.get(ObservationOutcome.OFF_TARGET, 0)
    if seen < _MIN_DETECTIONS or off_target <= _OFF_TARGET_SHARE_MAX * seen:
        return ""
    mesh = " (crs.axes and crs.unit of the mesh)" if surface_kind is SurfaceKind.MESH else ""
    share = f"{off_target / seen:.0%}, limit {_OFF_TARGET_SHARE_MAX:.0%}"
    return (
        f"{off_target} of {seen} detections ({share}) are not on the building: the model may be another, turned or "
        f"mirrored{mesh}, the poses may be wrong, or the detector finds much beside the building; look at a photograph "
        "beside the model with facadelake view"
    )
