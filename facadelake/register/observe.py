"""Detections to observations: where each box lies on the building, and on which of its elements.

The paper turns pixels to metres by one depth a photograph (``2 z tan(FOV/2) l / l_D``, in Algorithm 1), which is
exact only for a plane seen square-on; here each pixel's own ray meets the surface.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow as pa
import shapely
from numpy.typing import NDArray

from facadelake.camera import PosedCamera
from facadelake.frames import Array
from facadelake.geobim.facade import facade_seen
from facadelake.geobim.model import BuildingModel
from facadelake.geobim.storeys import storeys_of_places
from facadelake.geobim.surface import MISS, Hits, Surface
from facadelake.progress import stage_progress
from facadelake.register.patch import Patches, patches_of
from facadelake.register.settings import RegisterSettings
from facadelake.tables import table_of_rows
from schemas.vocabulary import DetectionOutcome, ObservationOutcome

_log = logging.getLogger(__name__)
Row = dict[str, Any]


def observe(
    detections: pa.Table,
    posed: Mapping[str, PosedCamera],
    building: BuildingModel,
    surface: Surface,
    settings: RegisterSettings,
) -> pa.Table:
    """Table ``observations``: one row an accepted detection, with its outcome; ``defect_id`` is left to ``merge``.

    ``posed`` holds the localised photographs by photo_id. The position is the hit of the box centre's ray; extents,
    area and target share come from the rays of the whole box.
    """
    accepted = [row for row in detections.to_pylist() if row["detection_outcome"] == DetectionOutcome.ACCEPTED]
    rows: list[Row] = []
    on_photo: list[Row] = []
    for row in accepted:
        camera = posed.get(row["photo_id"])
        if camera is None:
            rows.append(_row(row, ObservationOutcome.UNLOCALISED, 0.0))
        elif not camera.camera.contains(_centre(row)[None])[0]:
            rows.append(_row(row, ObservationOutcome.OUTSIDE, 0.0))
        else:
            on_photo.append(row)
    on_photo.sort(key=lambda row: (row["photo_id"], row["detection_id"]))
    with stage_progress("Registering detections", len(on_photo)) as step:
        for start in range(0, len(on_photo), settings.detections_per_cast):
            batch = on_photo[start : start + settings.detections_per_cast]
            rows.extend(_registered(batch, posed, building, surface, settings))
            step.advance(len(batch))
    rows.sort(key=lambda row: str(row["detection_id"]))
    counts = {
        str(outcome): sum(row["observation_outcome"] == outcome for row in rows) for outcome in ObservationOutcome
    }
    _log.info("%d detections on the surface: %s", len(rows), counts)
    return table_of_rows("observations", rows)


def _centre(row: Row) -> Array:
    return np.array([row["box_x_px"] + row["box_width_px"] / 2, row["box_y_px"] + row["box_height_px"] / 2])


def _row(detection: Row, outcome: ObservationOutcome, target_share: float, **found: Any) -> Row:
    kept = {name: detection[name] for name in ("detection_id", "photo_id", "defect_class")}
    return {**kept, "observation_outcome": str(outcome), "target_share": target_share, **found}


def _rays(batch: Sequence[Row], posed: Mapping[str, PosedCamera], side: int) -> tuple[Array, Array]:
    """Origins and directions of each box's ``side`` x ``side`` pixels, box after box; ``batch`` comes by photograph."""
    share = np.linspace(0, 1, side)
    grid = np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2)
    names = [row["photo_id"] for row in batch]
    starts = [i for i in range(len(names)) if i == 0 or names[i] != names[i - 1]]
    origins, directions = [], []
    for start, stop in zip(starts, [*starts[1:], len(names)], strict=True):
        boxes = np.array(
            [[r["box_x_px"], r["box_y_px"], r["box_width_px"], r["box_height_px"]] for r in batch[start:stop]]
        )
        pixels = (boxes[:, None, :2] + grid[None] * boxes[:, None, 2:]).reshape(-1, 2)
        origin, direction = posed[names[start]].rays_site(pixels)
        origins.append(origin)
        directions.append(direction)
    return np.vstack(origins), np.vstack(directions)


def _registered(
    batch: Sequence[Row],
    posed: Mapping[str, PosedCamera],
    building: BuildingModel,
    surface: Surface,
    settings: RegisterSettings,
) -> list[Row]:
    """Rows of detections whose centre lies in a localised photograph."""
    side = settings.rays_per_side
    origins, directions = _rays(batch, posed, side)
    seen = surface.cast(origins + settings.near_m * directions, directions)
    hits = replace(seen, distance_m=seen.distance_m + settings.near_m)
    patches = patches_of(hits, len(batch), side, settings.step_m)
    centre = np.arange(len(batch)) * side * side + side * side // 2
    on_target = (hits.element[centre] != MISS) & (patches.target_share >= settings.target_share_min)
    rows = [
        _row(row, ObservationOutcome.OFF_TARGET, float(share))
        for row, share, good in zip(batch, patches.target_share, on_target, strict=True)
        if not good
    ]
    kept = np.flatnonzero(on_target)
    if len(kept):
        rows.extend(_placed(batch, kept, centre[kept], hits, directions, patches, posed, building, settings))
    return rows


def _placed(
    batch: Sequence[Row],
    kept: NDArray[np.int64],
    centre: NDArray[np.int64],
    hits: Hits,
    directions: Array,
    patches: Patches,
    posed: Mapping[str, PosedCamera],
    building: BuildingModel,
    settings: RegisterSettings,
) -> list[Row]:
    """Rows of detections on the building: registered, or grazing where the ray runs along the surface."""
    xyz, normal = hits.xyz_site_m[centre], hits.normal_site[centre]
    geo = building.origin.geo_from_site(xyz)
    on_map = building.map_from_site(xyz)
    cosine = np.clip(-np.einsum("ij,ij->i", directions[centre], normal), 0.0, 1.0)
    incidence = np.degrees(np.arccos(cosine))
    points = shapely.to_wkb(shapely.points(geo), output_dimension=3)
    guids, named, facades = (
        building.elements.column(name).to_pylist() for name in ("element_guid", "storey", "facade")
    )
    storeys = storeys_of_places(building.storeys, named, building.extents_site_m(), hits.element[centre], xyz[:, 2])
    rows = []
    for i, (index, ray) in enumerate(zip(kept, centre, strict=True)):
        camera = posed[batch[index]["photo_id"]]
        distance = float(hits.distance_m[ray])
        depth = distance * float(directions[ray] @ camera.site_from_cam.rotation[:, 2])
        element = int(hits.element[ray])
        grazing = incidence[i] > settings.grazing_above_deg
        rows.append(
            _row(
                batch[index],
                ObservationOutcome.GRAZING if grazing else ObservationOutcome.REGISTERED,
                float(patches.target_share[index]),
                **dict(zip(("x_site_m", "y_site_m", "z_site_m"), map(float, xyz[i]), strict=True)),
                **dict(zip(("lon_deg", "lat_deg", "height_ellipsoidal_m"), map(float, geo[i]), strict=True)),
                **dict(zip(("east_map_m", "north_map_m", "height_map_m"), map(float, on_map[i]), strict=True)),
                **dict(zip(("normal_x", "normal_y", "normal_z"), map(float, normal[i]), strict=True)),
                incidence_deg=float(incidence[i]),
                distance_m=distance,
                gsd_mm=1000 * depth / float(np.sqrt(camera.camera.fx_px * camera.camera.fy_px)),
                width_m=float(patches.width_m[index]),
                height_m=float(patches.height_m[index]),
                area_m2=float(patches.area_m2[index]),
                element_guid=guids[element],
                storey=storeys[i],
                facade=facade_seen(facades[element], normal[i]),
                geometry=points[i],
            )
        )
    return rows
