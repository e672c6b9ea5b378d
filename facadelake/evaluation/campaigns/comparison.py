"""A campaign's tables beside truth: every error with its sample, in the run's own site frame."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64Array
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError, SchemaError
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.pose_table import read_posed_cameras
from facadelake.evaluation.campaigns.cameras import CameraErrors, compare_cameras
from facadelake.evaluation.campaigns.samples import PositionSamples, Row, collect_position_samples
from facadelake.evaluation.campaigns.truth import Truth, read_truth
from schemas.vocabulary import DetectionOutcome, ObservationOutcome

_COCO_PREFIX = "coco:"
POSITION_TOLERANCE_M = 0.001


@dataclass(frozen=True, kw_only=True, eq=False)
class TruthComparison:
    """What figures and plots are made of.

    ``ray_error_m`` (n,): of accepted detections that show a check point. ``roundtrip_px``, ``roundtrip_cm`` (m, 2):
    registered position re-projected minus box centre, right and down, in the photograph and by its GSD on the surface;
    nought by construction where a box is registered by its centre's ray. ``roundtrip_defects_*``: the same of the
    merged position, in every photograph that shows it.
    ``members``: registered sightings of defects as (defect, check point). ``element_pairs``: (found, true) of
    observations, and of defects.
    ``check_point_by_defect``: each defect's check point. ``detected_check_points``: check points of accepted detections. ``registered_without_check_point``:
    registered detections that show none; None where the detections name no annotations.
    """

    photographs_total: int
    photographs_localised: int
    cameras: CameraErrors
    xyz_camera_m: Float64Array
    ray_error_m: Float64Array
    observations: PositionSamples
    defects: PositionSamples
    roundtrip_px: Float64Array
    roundtrip_cm: Float64Array
    roundtrip_defects_px: Float64Array
    roundtrip_defects_cm: Float64Array
    members: tuple[tuple[str, str], ...]
    element_pairs: tuple[tuple[str | None, str], ...]
    element_pairs_defects: tuple[tuple[str | None, str], ...]
    check_point_by_defect: tuple[str | None, ...]
    detected_check_points: frozenset[str]
    xyz_true_site_m: Mapping[str, Float64Array]
    registered_without_check_point: int | None


@dataclass(frozen=True, kw_only=True, eq=False)
class _CampaignRows:
    """The rows that figures are made of, and truth in the run's own site frame."""

    cameras: Mapping[str, PosedCamera]
    detections: Mapping[str, Row]
    registered: Sequence[Row]
    defects: Sequence[Row]
    check_point_of_detection: Mapping[str, str | None]
    xyz_true_site_m: Mapping[str, Float64Array]


def compare_with_truth(
    *,
    poses: pa.Table,
    detections: pa.Table,
    observations: pa.Table,
    defects: pa.Table,
    photos: pa.Table,
    truth: Path,
    origin: SiteOrigin,
    map_crs: str,
) -> TruthComparison:
    """One campaign's tables (as a stage or the lake gives them) beside the folder ``truth``.

    ``origin`` is the run's site origin and ``map_crs`` the CRS of its map columns: truth comes in EPSG:4979 and is
    brought into the run's site frame, so the tables' site and map columns must tell the same places. Detections
    meet check points by the annotation they were imported from (truth/detections.csv), never by nearness; those of a
    model have no annotation, so only the camera error and the round trip are available for them.
    Raises InputDataError where truth is missing, ill-formed or of another campaign, SchemaError where the tables are
    not of this origin.
    """
    known = read_truth(truth)
    photo_ids = photos.column("photo_id").to_pylist()
    points = sorted(known.checkpoints)
    geo = np.array([known.checkpoints[name].geo for name in points]).reshape(-1, 3)
    campaign = _CampaignRows(
        cameras=read_posed_cameras(poses),
        detections={row["detection_id"]: row for row in detections.to_pylist()},
        registered=[
            row for row in observations.to_pylist() if row["observation_outcome"] == ObservationOutcome.REGISTERED
        ],
        defects=defects.to_pylist(),
        check_point_of_detection=_match_detections(detections, known, truth),
        xyz_true_site_m=dict(zip(points, origin.site_from_geo(geo), strict=True)),
    )
    _check_positions([*campaign.registered, *campaign.defects], origin, map_crs)
    matched = [
        (row, target)
        for row in campaign.registered
        if (target := campaign.check_point_of_detection.get(row["detection_id"])) is not None
    ]
    shown_by_defect = _match_defects(campaign)
    merged = [
        (row, target) for row, target in zip(campaign.defects, shown_by_defect, strict=True) if target is not None
    ]
    compared = compare_cameras(poses, photo_ids, known, origin, truth)
    imported = any(detector.startswith(_COCO_PREFIX) for detector in detections.column("detector").to_pylist())
    accepted = _select_accepted(campaign)
    roundtrip_px, roundtrip_cm = _compute_round_trip(
        campaign, {row["detection_id"]: row for row in campaign.registered}
    )
    defect_of = {row["defect_id"]: row for row in campaign.defects}
    merged_px, merged_cm = _compute_round_trip(
        campaign,
        {
            row["detection_id"]: defect_of[row["defect_id"]]
            for row in campaign.registered
            if row["defect_id"] in defect_of
        },
    )
    return TruthComparison(
        photographs_total=len(photo_ids),
        photographs_localised=len(campaign.cameras),
        cameras=compared,
        xyz_camera_m=np.array([campaign.cameras[name].centre_site_m for name in compared.photo_ids]).reshape(-1, 3),
        ray_error_m=_compute_ray_errors(campaign, accepted),
        observations=collect_position_samples(matched, campaign.xyz_true_site_m, key="detection_id"),
        defects=collect_position_samples(merged, campaign.xyz_true_site_m, key="defect_id"),
        roundtrip_px=roundtrip_px,
        roundtrip_cm=roundtrip_cm,
        roundtrip_defects_px=merged_px,
        roundtrip_defects_cm=merged_cm,
        members=tuple((row["defect_id"], target) for row, target in matched if row["defect_id"]),
        element_pairs=_pair_elements(matched, known),
        element_pairs_defects=_pair_elements(merged, known),
        check_point_by_defect=tuple(shown_by_defect),
        detected_check_points=frozenset(target for _, target in accepted),
        xyz_true_site_m=campaign.xyz_true_site_m,
        registered_without_check_point=len(campaign.registered) - len(matched) if imported else None,
    )


def _get_position(row: Row) -> Float64Array:
    return np.array([row["x_site_m"], row["y_site_m"], row["z_site_m"]], dtype=np.float64)


def _pair_elements(rows: Sequence[tuple[Row, str]], known: Truth) -> tuple[tuple[str | None, str], ...]:
    """(found, true) elements of rows whose check point has one."""
    pairs = ((row["element_guid"], known.checkpoints[target].element_guid) for row, target in rows)
    return tuple((found, true) for found, true in pairs if true)


def _check_positions(rows: Sequence[Row], origin: SiteOrigin, map_crs: str) -> None:
    """Refuse tables whose site columns, with this origin, are not the places that their map columns tell."""
    if not rows:
        return
    expected = origin.map_from_site(np.array([_get_position(row) for row in rows]), map_crs)[:, :2]
    written = np.array([[row["east_map_m"], row["north_map_m"]] for row in rows], dtype=np.float64)
    apart = float(np.abs(expected - written).max())
    if not apart <= POSITION_TOLERANCE_M:
        raise SchemaError(
            f"positions in the site frame and in {map_crs} are {apart:.3f} m apart ({POSITION_TOLERANCE_M} m allowed); "
            "the site origin or the CRS is not that of the run: take both from the campaign's row of table buildings"
        )


def _compute_box_centre(row: Row) -> Float64Array:
    """Centre (1, 2) of a detection's box in pixels."""
    x, y = row["box_x_px"] + row["box_width_px"] / 2, row["box_y_px"] + row["box_height_px"] / 2
    return np.array([[x, y]], dtype=np.float64)


def _match_detections(detections: pa.Table, known: Truth, folder: Path) -> dict[str, str | None]:
    """The check point of every imported detection by its id; None for one that shows none."""
    shown: dict[str, str | None] = {}
    taken: dict[tuple[str, str], str] = {}
    for row in detections.select(["detection_id", "detector", "source_annotation"]).to_pylist():
        if not row["detector"].startswith(_COCO_PREFIX):
            continue
        key = (row["detector"].removeprefix(_COCO_PREFIX), row["source_annotation"])
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
        shown[row["detection_id"]] = known.check_point_of_annotation.get(key)
    return shown


def _select_accepted(campaign: _CampaignRows) -> list[tuple[Row, str]]:
    """Accepted detections with the check point they show."""
    rows = (
        (campaign.detections[detection_id], target)
        for detection_id, target in campaign.check_point_of_detection.items()
    )
    return [
        (row, target)
        for row, target in rows
        if target is not None and row["detection_outcome"] == DetectionOutcome.ACCEPTED
    ]


def _compute_ray_errors(campaign: _CampaignRows, accepted: Sequence[tuple[Row, str]]) -> Float64Array:
    """Distance (n,) of check points from the rays of their boxes' centres, in localised photographs."""
    distances = []
    for row, target in accepted:
        camera = campaign.cameras.get(row["photo_id"])
        if camera is None:
            continue
        origins, directions = camera.rays_site_from_img(_compute_box_centre(row))
        offset = campaign.xyz_true_site_m[target] - origins[0]
        along = max(float(offset @ directions[0]), 0.0)  # a ray has a beginning
        distances.append(float(np.linalg.norm(offset - along * directions[0])))
    return np.array(distances, dtype=np.float64)


def _match_defects(campaign: _CampaignRows) -> list[str | None]:
    """The check point that most of each defect's sightings show; of equally many, the first by name.

    A defect most of whose sightings show no check point has none.
    """
    sightings: dict[str, Counter[str | None]] = defaultdict(Counter)
    for row in campaign.registered:
        if row["defect_id"]:
            sightings[row["defect_id"]][campaign.check_point_of_detection.get(row["detection_id"])] += 1
    shown = []
    for defect in campaign.defects:
        counts = sightings[defect["defect_id"]]
        shown.append(min(counts, key=lambda name: (-counts[name], name is None, name or ""), default=None))
    return shown


def _compute_round_trip(campaign: _CampaignRows, places: Mapping[str, Row]) -> tuple[Float64Array, Float64Array]:
    """``places`` (by detection_id) re-projected against their boxes' centres (n, 2), in pixels and in cm on the
    surface."""
    pixels, centimetres = [], []
    for row in campaign.registered:
        place = places.get(row["detection_id"])
        if place is None:
            continue
        projected = campaign.cameras[row["photo_id"]].project_site(_get_position(place)[None])
        apart_px = (projected - _compute_box_centre(campaign.detections[row["detection_id"]]))[0]
        if not np.isfinite(apart_px).all():
            raise SchemaError(
                f"observation {row['detection_id']} is registered behind the camera of {row['photo_id']}; its "
                "position or the pose is wrong: run the campaign again"
            )
        pixels.append(apart_px)
        centimetres.append(apart_px * row["gsd_mm"] / 10)
    return np.array(pixels).reshape(-1, 2), np.array(centimetres).reshape(-1, 2)
