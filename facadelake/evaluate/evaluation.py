"""Evaluate a campaign's tables against a truth folder."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.camera import PosedCamera
from facadelake.errors import InputDataError, SchemaError
from facadelake.evaluate.cameras import coverage_2sigma, found_and_true
from facadelake.evaluate.figures import Figures
from facadelake.evaluate.merging import merging_of
from facadelake.evaluate.stats import Stats, SurfaceStats, position_stats, stats_of, surface_stats
from facadelake.evaluate.truth import Truth, read_truth
from facadelake.frames import Array
from facadelake.geodesy import SiteOrigin
from facadelake.posed import posed_cameras
from schemas.vocabulary import DetectionOutcome, ObservationOutcome

Row = Mapping[str, Any]
_COCO = "coco:"
PLACE_TOLERANCE_M = 0.001


@dataclass(frozen=True, kw_only=True, eq=False)
class _Campaign:
    """The rows that figures are made of, and truth in the run's own site frame."""

    cameras: Mapping[str, PosedCamera]
    detections: Mapping[str, Row]
    registered: Sequence[Row]
    defects: Sequence[Row]
    shown: Mapping[str, str | None]  # detection_id -> check point
    xyz_true_site_m: Mapping[str, Array]


def evaluate(
    *,
    poses: pa.Table,
    detections: pa.Table,
    observations: pa.Table,
    defects: pa.Table,
    photos: pa.Table,
    truth: Path,
    origin: SiteOrigin,
    map_crs: str,
) -> Figures:
    """The figures of one campaign's tables (as a stage or the lake gives them) against the folder ``truth``.

    ``origin`` is the run's site origin and ``map_crs`` the CRS of its map columns: truth comes in EPSG:4979 and is
    brought into the run's site frame, so the tables' site and map columns must tell the same places. Detections
    meet check points by the annotation they were imported from (truth/detections.csv), never by nearness; those of a
    model have no annotation, so only the camera error and the round trip are available for them.
    Raises InputDataError where truth is missing, ill-formed or of another campaign, SchemaError where the tables are
    not of this origin.
    """
    known = read_truth(truth)
    photo_ids = photos.column("photo_id").to_pylist()
    cameras = posed_cameras(poses)
    points = sorted(known.checkpoints)
    geo = np.array([known.checkpoints[name].geo for name in points]).reshape(-1, 3)
    campaign = _Campaign(
        cameras=cameras,
        detections={row["detection_id"]: row for row in detections.to_pylist()},
        registered=[
            row for row in observations.to_pylist() if row["observation_outcome"] == ObservationOutcome.REGISTERED
        ],
        defects=defects.to_pylist(),
        shown=_shown(detections, known, truth),
        xyz_true_site_m=dict(zip(points, origin.site_from_geo(geo), strict=True)),
    )
    _check_places([*campaign.registered, *campaign.defects], origin, map_crs)
    matched = [
        (row, target) for row in campaign.registered if (target := campaign.shown.get(row["detection_id"])) is not None
    ]
    pairs = [(row["element_guid"], known.checkpoints[target].element_guid) for row, target in matched]
    correct = [found == true for found, true in pairs if true]
    roundtrip_px, roundtrip_cm = _roundtrip(campaign)
    compared = found_and_true(poses, photo_ids, known, origin, truth)
    imported = any(detector.startswith(_COCO) for detector in detections.column("detector").to_pylist())
    return Figures(
        photographs_total=len(photo_ids),
        photographs_localised=len(cameras),
        camera_error=position_stats(compared.error_site_m),
        ray_error=_ray_error(campaign),
        observation_error=_position_error(campaign, matched),
        defect_error=_position_error(campaign, _defects_with_truth(campaign)),
        roundtrip_px=roundtrip_px,
        roundtrip_cm=roundtrip_cm,
        merge=merging_of([(row["defect_id"], target) for row, target in matched if row["defect_id"]]),
        element_correct_share=float(np.mean(correct)) if correct else None,
        off_truth=len(campaign.registered) - len(matched) if imported else None,
        coverage_2sigma=coverage_2sigma(compared),
    )


def _xyz(row: Row) -> Array:
    return np.array([row["x_site_m"], row["y_site_m"], row["z_site_m"]], dtype=np.float64)


def _check_places(rows: Sequence[Row], origin: SiteOrigin, map_crs: str) -> None:
    """Refuse tables whose site columns, with this origin, are not the places that their map columns tell."""
    if not rows:
        return
    expected = origin.map_from_site(np.array([_xyz(row) for row in rows]), map_crs)[:, :2]
    written = np.array([[row["east_map_m"], row["north_map_m"]] for row in rows], dtype=np.float64)
    apart = float(np.abs(expected - written).max())
    if not apart <= PLACE_TOLERANCE_M:
        raise SchemaError(
            f"positions in the site frame and in {map_crs} are {apart:.3f} m apart ({PLACE_TOLERANCE_M} m allowed); "
            "the site origin or the CRS is not that of the run: take both from the campaign's row of table buildings"
        )


def _centre_img(row: Row) -> Array:
    """Centre (1, 2) of a detection's box in pixels."""
    x, y = row["box_x_px"] + row["box_width_px"] / 2, row["box_y_px"] + row["box_height_px"] / 2
    return np.array([[x, y]], dtype=np.float64)


def _shown(detections: pa.Table, known: Truth, folder: Path) -> dict[str, str | None]:
    """The check point of every imported detection by its id; None for one that shows none."""
    shown: dict[str, str | None] = {}
    taken: dict[tuple[str, str], str] = {}
    for row in detections.select(["detection_id", "detector", "source_annotation"]).to_pylist():
        if not row["detector"].startswith(_COCO):
            continue
        key = (row["detector"].removeprefix(_COCO), row["source_annotation"])
        if key[0] not in known.files:
            raise InputDataError(
                f"{folder / 'detections.csv'}, column file: nothing is listed for '{key[0]}', which the campaign's "
                f"detections came from (listed: {', '.join(sorted(known.files))}); evaluate one of these, "
                "or add the file"
            )
        if key in taken:
            raise InputDataError(
                f"annotation {key[1]} of {key[0]} was imported as {taken[key]} and {row['detection_id']}; truth names "
                "annotations by id, so give each annotation its own id"
            )
        taken[key] = row["detection_id"]
        shown[row["detection_id"]] = known.shown.get(key)
    return shown


def _ray_error(campaign: _Campaign) -> Stats:
    distances = []
    for detection_id, target in campaign.shown.items():
        row = campaign.detections[detection_id]
        camera = campaign.cameras.get(row["photo_id"])
        if target is None or camera is None or row["detection_outcome"] != DetectionOutcome.ACCEPTED:
            continue
        origins, directions = camera.rays_site(_centre_img(row))
        offset = campaign.xyz_true_site_m[target] - origins[0]
        along = max(float(offset @ directions[0]), 0.0)  # a ray has a beginning
        distances.append(float(np.linalg.norm(offset - along * directions[0])))
    return stats_of(np.array(distances))


def _position_error(campaign: _Campaign, rows: Sequence[tuple[Row, str]]) -> SurfaceStats:
    errors = [_xyz(row) - campaign.xyz_true_site_m[target] for row, target in rows]
    normals = [[row["normal_x"], row["normal_y"], row["normal_z"]] for row, _ in rows]
    return surface_stats(np.array(errors, dtype=np.float64), np.array(normals, dtype=np.float64))


def _defects_with_truth(campaign: _Campaign) -> list[tuple[Row, str]]:
    """Defects with the check point that most of their sightings show; of equally many, the first by name.

    A defect most of whose sightings show no check point has none.
    """
    sightings: dict[str, Counter[str | None]] = defaultdict(Counter)
    for row in campaign.registered:
        if row["defect_id"]:
            sightings[row["defect_id"]][campaign.shown.get(row["detection_id"])] += 1
    pairs = []
    for defect in campaign.defects:
        counts = sightings[defect["defect_id"]]
        target = min(counts, key=lambda name: (-counts[name], name is None, name or ""), default=None)
        if target is not None:
            pairs.append((defect, target))
    return pairs


def _roundtrip(campaign: _Campaign) -> tuple[Stats, Stats]:
    """Registered points re-projected against their boxes' centres, in pixels and in cm on the surface."""
    pixels, centimetres = [], []
    for row in campaign.registered:
        projected = campaign.cameras[row["photo_id"]].project_site(_xyz(row)[None])
        distance_px = float(np.linalg.norm(projected - _centre_img(campaign.detections[row["detection_id"]])))
        if not np.isfinite(distance_px):
            raise SchemaError(
                f"observation {row['detection_id']} is registered behind the camera of {row['photo_id']}; its "
                "position or the pose is wrong: run the campaign again"
            )
        pixels.append(distance_px)
        centimetres.append(distance_px * row["gsd_mm"] / 10)
    return stats_of(np.array(pixels)), stats_of(np.array(centimetres))
