"""Plausibility of imported poses: near the building, with it in view, and consistent with the metadata's attitudes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from facadelake.building.surface import Surface
from facadelake.core.arrays import Float64Nx3, Float64x3x3
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.georeferencing.gps.priors import rotation_from_attitude
from facadelake.georeferencing.imported.attitude import list_alternative_conventions
from facadelake.georeferencing.model_checks import MAX_VIEWING_DISTANCE_M, find_cameras_seeing_model
from facadelake.georeferencing.site_frame import SiteFrame
from schemas.vocabulary import PositionSource

# A gimbal's compass errs by some degrees, near steel by tens; wrong conventions rotate cameras by 90 degrees and more.
MAX_ROTATION_DEG = 45.0
_MIN_ATTITUDES = 3
_DEFAULT_HINT = "check rotation, camera_axes, pitch_zero and north in the header (docs/poses-csv.md)"


def check_plausibility(
    posed: Mapping[str, PosedCamera],
    photos: Sequence[Mapping[str, Any]],
    surface: Surface,
    site_frame: SiteFrame,
    *,
    source: str,
) -> list[str]:
    """Check that imported poses are plausible.

    Args:
        posed: the posed cameras in site, by photo_id.
        photos: the accepted rows of table ``photos``.
        surface: the building's surface.
        site_frame: the building's site frame.
        source: name of the file of poses, for messages.

    Returns:
        remarks on photographs that do not show the building.

    Raises:
        GeoreferenceError: the cameras are far from the building, none shows it, or they are rotated against the
            attitudes in the photographs' metadata.
    """
    cameras = list(posed.values())
    _refuse_far(np.array([camera.centre_site_m for camera in cameras]), surface, site_frame, source)
    seeing = find_cameras_seeing_model(cameras, surface)
    if not seeing.any():
        raise GeoreferenceError(
            f"by the poses of {source} none of {len(cameras)} photographs shows the building model, although they are "
            "near it: the convention of their rotations seems to differ from the one stated; "
            f"{_suggest_convention(cameras, surface)}"
        )
    _refuse_rotated(posed, photos, source)
    remarks = []
    if not seeing.all():
        remarks.append(f"{int((~seeing).sum())} of {len(cameras)} photographs do not show the building model")
    return remarks


def _refuse_far(centres_site_m: Float64Nx3, surface: Surface, site_frame: SiteFrame, source: str) -> None:
    low, high = surface.vertices_site_m.min(axis=0), surface.vertices_site_m.max(axis=0)
    distance_m = np.linalg.norm(np.maximum(np.maximum(low - centres_site_m, centres_site_m - high), 0.0), axis=1)
    if float(np.median(distance_m)) <= MAX_VIEWING_DISTANCE_M:
        return
    origin = site_frame.origin
    lon, lat, height = origin.geo_from_site(np.median(centres_site_m, axis=0)[None])[0].tolist()
    raise GeoreferenceError(
        f"the poses of {source} lie {np.median(distance_m) / 1000:.0f} km from the building model (limit "
        f"{MAX_VIEWING_DISTANCE_M / 1000:g} km), near lon {lon:.4f}, lat {lat:.4f}, height {height:.0f} m; the "
        f"building is near lon {origin.lon_deg:.4f}, lat {origin.lat_deg:.4f}: are lon and lat (or east and north) "
        "swapped, is an "
        "offset or a transform missing (COLMAP: georeference.txt), or is the CRS or zone wrong?"
    )


def _suggest_convention(cameras: Sequence[PosedCamera], surface: Surface) -> str:
    """The conventions under which most photographs would show the model, in words."""
    alternatives = [list_alternative_conventions(camera.site_from_cam.rotation) for camera in cameras]
    count = {}
    for name in alternatives[0]:
        rotated = [
            PosedCamera(
                camera=camera.camera,
                site_from_cam=Similarity(rotation=rotations[name], translation=camera.centre_site_m),
            )
            for camera, rotations in zip(cameras, alternatives, strict=True)
        ]
        count[name] = int(find_cameras_seeing_model(rotated, surface).sum())
    most = max(count.values())
    if not most:
        return _DEFAULT_HINT
    return f"with {', or '.join(name for name in count if count[name] == most)}, {most} would"


def _refuse_rotated(posed: Mapping[str, PosedCamera], photos: Sequence[Mapping[str, Any]], source: str) -> None:
    """Raise GeoreferenceError where the poses are rotated against the gimbal attitudes by more than compasses err."""
    stated = {
        row["photo_id"]: rotation_from_attitude(row["prior_yaw_deg"], row["prior_pitch_deg"], row["prior_roll_deg"])
        for row in photos
        if row["photo_id"] in posed
        and row["prior_source"] != PositionSource.NONE
        and None not in (row["prior_yaw_deg"], row["prior_pitch_deg"], row["prior_roll_deg"])
    }
    if len(stated) < _MIN_ATTITUDES:
        return
    imported = {photo_id: posed[photo_id].site_from_cam.rotation for photo_id in stated}
    angle_deg = _compute_median_angle(imported, stated)
    if angle_deg <= MAX_ROTATION_DEG:
        return
    alternatives = {photo_id: list_alternative_conventions(rotation) for photo_id, rotation in imported.items()}
    names = next(iter(alternatives.values()))
    angles = {
        name: _compute_median_angle({photo_id: rotations[name] for photo_id, rotations in alternatives.items()}, stated)
        for name in names
    }
    best = min(angles, key=lambda name: angles[name])
    hint = f"with {best}, {angles[best]:.0f} deg would remain" if angles[best] <= MAX_ROTATION_DEG else _DEFAULT_HINT
    raise GeoreferenceError(
        f"the poses of {source} are rotated by {angle_deg:.0f} deg (median, limit {MAX_ROTATION_DEG:g} deg) against "
        f"the attitudes in the metadata of {len(stated)} photographs; {hint}"
    )


def _compute_median_angle(imported: Mapping[str, Float64x3x3], stated: Mapping[str, Float64x3x3]) -> float:
    """Median angle (deg) between the rotations of the same photographs."""
    angles = []
    for photo_id, rotation in stated.items():
        cosine = (np.trace(rotation.T @ imported[photo_id]) - 1) / 2
        angles.append(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    return float(np.median(angles))
