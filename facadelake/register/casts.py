"""Detections of localised photographs, cast onto the building's surface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facadelake.camera import PosedCamera
from facadelake.geobim.surface import Hits, Surface
from facadelake.register.outline import Outlines, outlines_of
from facadelake.register.patch import Patches, patches_of
from facadelake.register.rays import PixelRays, rays_of
from facadelake.register.settings import RegisterSettings

Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class Casts:
    """Detections of localised photographs on the surface: rows of table ``detections`` (n), the photographs' cameras,
    ``camera_of`` (n,) in them, the pixels of their outlines (k), these pixels' rays and hits, and the patches (n)."""

    detections: Sequence[Row]
    cameras: list[PosedCamera]
    camera_of: NDArray[np.int64]
    outlines: Outlines
    rays: PixelRays
    hits: Hits
    patches: Patches


def cast(
    detections: Sequence[Row], posed: Mapping[str, PosedCamera], surface: Surface, settings: RegisterSettings
) -> Casts:
    """The rays of accepted ``detections`` on localised photographs, and the patches they make."""
    names = sorted({row["photo_id"] for row in detections})
    cameras = [posed[name] for name in names]
    number = {name: i for i, name in enumerate(names)}
    camera_of = np.array([number[row["photo_id"]] for row in detections], dtype=np.int64)
    outlines = outlines_of(detections, settings.rays_per_side)
    rays = rays_of(cameras, camera_of[outlines.detection], outlines.xy_img)
    seen = surface.cast(rays.origin_site_m + settings.near_m * rays.direction_site, rays.direction_site)
    hits = replace(seen, distance_m=seen.distance_m + settings.near_m)
    patches = patches_of(outlines, hits, rays, cameras, camera_of, settings.step_m)
    return Casts(
        detections=detections,
        cameras=cameras,
        camera_of=camera_of,
        outlines=outlines,
        rays=rays,
        hits=hits,
        patches=patches,
    )
