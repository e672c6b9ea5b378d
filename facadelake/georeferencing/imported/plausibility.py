"""Whether imported poses can be right: near the building, with it in view, and as the photographs say of themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from facadelake.building.surface import Hits
from facadelake.core.arrays import Float64Array
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.georeferencing.gps.priors import rotation_from_attitude
from facadelake.georeferencing.imported.attitude import list_alternative_conventions
from facadelake.georeferencing.site_frame import SiteFrame
from schemas.vocabulary import PositionSource

# Facades are photographed from tens of metres; a pose a kilometre off is of another CRS, unit or building.
MAX_DISTANCE_M = 1000.0
# A gimbal's compass errs by some degrees, near steel by tens; wrong conventions turn cameras by 90 degrees and more.
MAX_ROTATION_DEG = 45.0
_MIN_ATTITUDES = 3
_RAYS_PER_AXIS = 7  # rays each way over a photograph
_DEFAULT_HINT = "check rotation, camera_axes, pitch_zero and north in the head (docs/poses-csv.md)"


class SurfaceLike(Protocol):
    """Anything that rays can be cast at."""

    vertices_site_m: Float64Array

    def cast(self, origins_site_m: Float64Array, directions_site: Float64Array) -> Hits:
        """First hits of rays."""
        ...


def check_plausibility(
    posed: Mapping[str, PosedCamera],
    photos: Sequence[Mapping[str, Any]],
    surface: SurfaceLike,
    place: SiteFrame,
    *,
    source: str,
) -> list[str]:
    """Raise GeoreferenceError for poses that cannot be right; returns what is odd about the others, in words.

    ``posed`` by photo_id, ``photos`` the accepted rows of table ``photos``.
    """
    cameras = list(posed.values())
    _refuse_far(np.array([camera.centre_site_m for camera in cameras]), surface, place, source)
    seeing = _find_cameras_seeing_model(cameras, surface)
    if not seeing.any():
        raise GeoreferenceError(
            f"by the poses of {source} none of {len(cameras)} photographs shows the building model, though they stand "
            f"near it: the convention of their rotations is another than stated; {_suggest_convention(cameras, surface)}"
        )
    _refuse_rotated(posed, photos, source)
    remarks = []
    if not seeing.all():
        remarks.append(f"{int((~seeing).sum())} of {len(cameras)} photographs do not show the building model")
    return remarks


def _refuse_far(centres_site_m: Float64Array, surface: SurfaceLike, place: SiteFrame, source: str) -> None:
    low, high = surface.vertices_site_m.min(axis=0), surface.vertices_site_m.max(axis=0)
    away_m = np.linalg.norm(np.maximum(np.maximum(low - centres_site_m, centres_site_m - high), 0.0), axis=1)
    if float(np.median(away_m)) <= MAX_DISTANCE_M:
        return
    lon, lat, height = place.origin.geo_from_site(np.median(centres_site_m, axis=0)[None])[0].tolist()
    raise GeoreferenceError(
        f"the poses of {source} lie {np.median(away_m) / 1000:.0f} km from the building model (limit "
        f"{MAX_DISTANCE_M / 1000:g} km), near lon {lon:.4f}, lat {lat:.4f}, height {height:.0f} m; the building stands "
        f"near lon {place.origin.lon_deg:.4f}, lat {place.origin.lat_deg:.4f}: are lon and lat (or east and north) "
        "swapped, is an offset or a transform missing (COLMAP: georeference.txt), or is the CRS or zone another?"
    )


def _find_cameras_seeing_model(
    cameras: Sequence[PosedCamera], surface: SurfaceLike
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which cameras (n,) have the surface somewhere in view, within the farthest distance."""
    seen = []
    for camera in cameras:
        columns = (np.arange(_RAYS_PER_AXIS) + 0.5) * camera.camera.width_px / _RAYS_PER_AXIS
        rows = (np.arange(_RAYS_PER_AXIS) + 0.5) * camera.camera.height_px / _RAYS_PER_AXIS
        origins, directions = camera.rays_site_from_img(np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2))
        hits = surface.cast(origins, directions)
        seen.append(bool((hits.hit & (hits.distance_m < MAX_DISTANCE_M)).any()))
    return np.array(seen, dtype=np.bool_)


def _suggest_convention(cameras: Sequence[PosedCamera], surface: SurfaceLike) -> str:
    """Under which other readings of the rotations most photographs would show the model."""
    readings = [list_alternative_conventions(camera.site_from_cam.rotation) for camera in cameras]
    shown = {}
    for name in readings[0]:
        turned = [
            PosedCamera(
                camera=camera.camera,
                site_from_cam=Similarity(rotation=reading[name], translation=camera.centre_site_m),
            )
            for camera, reading in zip(cameras, readings, strict=True)
        ]
        shown[name] = int(_find_cameras_seeing_model(turned, surface).sum())
    most = max(shown.values())
    if not most:
        return _DEFAULT_HINT
    return f"with {', or '.join(name for name in shown if shown[name] == most)}, {most} would"


def _refuse_rotated(posed: Mapping[str, PosedCamera], photos: Sequence[Mapping[str, Any]], source: str) -> None:
    """The photographs' own attitudes (gimbal) against the poses: no compass errs by what a wrong convention turns."""
    stated = {
        row["photo_id"]: rotation_from_attitude(row["prior_yaw_deg"], row["prior_pitch_deg"], row["prior_roll_deg"])
        for row in photos
        if row["photo_id"] in posed
        and row["prior_source"] != PositionSource.NONE
        and None not in (row["prior_yaw_deg"], row["prior_pitch_deg"], row["prior_roll_deg"])
    }
    if len(stated) < _MIN_ATTITUDES:
        return
    turned = {photo_id: posed[photo_id].site_from_cam.rotation for photo_id in stated}
    off_deg = _compute_median_angle(turned, stated)
    if off_deg <= MAX_ROTATION_DEG:
        return
    readings = {photo_id: list_alternative_conventions(rotation) for photo_id, rotation in turned.items()}
    names = next(iter(readings.values()))
    others = {
        name: _compute_median_angle({photo_id: reading[name] for photo_id, reading in readings.items()}, stated)
        for name in names
    }
    best = min(others, key=lambda name: others[name])
    hint = f"with {best}, {others[best]:.0f} deg would be left" if others[best] <= MAX_ROTATION_DEG else _DEFAULT_HINT
    raise GeoreferenceError(
        f"the poses of {source} are turned by {off_deg:.0f} deg (median, limit {MAX_ROTATION_DEG:g} deg) against the "
        f"attitudes that {len(stated)} photographs state themselves; {hint}"
    )


def _compute_median_angle(turned: Mapping[str, Float64Array], stated: Mapping[str, Float64Array]) -> float:
    angles = []
    for photo_id, rotation in stated.items():
        cosine = (np.trace(rotation.T @ turned[photo_id]) - 1) / 2
        angles.append(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    return float(np.median(angles))
