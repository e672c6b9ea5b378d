"""Comparison of a campaign's tables with truth: every error with its sample, in the run's site frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64N, Float64Nx2, Float64Nx3, Float64x3
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import SchemaError
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.pose_table import read_posed_cameras
from facadelake.evaluation.campaigns.association import COCO_PREFIX, match_defects, match_detections
from facadelake.evaluation.campaigns.cameras import CameraErrors, compare_cameras
from facadelake.evaluation.campaigns.samples import PositionSamples, Row, collect_position_samples
from facadelake.evaluation.campaigns.truth import Truth, read_truth
from schemas.vocabulary import DetectionOutcome, ObservationOutcome

POSITION_TOLERANCE_M = 0.001


@dataclass(frozen=True, kw_only=True, eq=False)
class TruthComparison:
    """Samples of the errors of a campaign; input of figures and plots.

    ``xyz_camera_m`` (k, 3): centres of the compared cameras in site. ``ray_error_m`` (n,): distance of check points
    from the rays of accepted detections that show them. ``roundtrip_px``, ``roundtrip_cm`` (m, 2): registered position
    re-projected minus box centre, right and down, in the photograph and by its GSD on the surface; zero by construction
    where a box is registered by its centre's ray. ``roundtrip_defects_*``: the same of the defect's position, in every
    photograph that shows it. ``members``: registered observations of defects as (defect, check point).
    ``element_pairs``, ``element_pairs_defects``: (found, true) of observations and of defects.
    ``check_point_by_defect``: the check point of each defect. ``detected_check_points``: those of accepted detections.
    ``registered_without_check_point``: number of registered detections that show no check point; None where the
    detections are not from a COCO file.
    """

    photographs_total: int
    photographs_localised: int
    cameras: CameraErrors
    xyz_camera_m: Float64Nx3
    ray_error_m: Float64N
    observations: PositionSamples
    defects: PositionSamples
    roundtrip_px: Float64Nx2
    roundtrip_cm: Float64Nx2
    roundtrip_defects_px: Float64Nx2
    roundtrip_defects_cm: Float64Nx2
    members: tuple[tuple[str, str], ...]
    element_pairs: tuple[tuple[str | None, str], ...]
    element_pairs_defects: tuple[tuple[str | None, str], ...]
    check_point_by_defect: tuple[str | None, ...]
    detected_check_points: frozenset[str]
    xyz_true_site_m: Mapping[str, Float64x3]
    registered_without_check_point: int | None


@dataclass(frozen=True, kw_only=True, eq=False)
class _CampaignRows:
    """Rows of the campaign's tables, their check points, and the check points in the run's site frame."""

    cameras: Mapping[str, PosedCamera]
    detections: Mapping[str, Row]
    registered: Sequence[Row]
    defects: Sequence[Row]
    check_point_of_detection: Mapping[str, str | None]
    xyz_true_site_m: Mapping[str, Float64x3]


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
    """Compare one campaign's tables with a truth folder.

    A detection is matched with its check point by the annotation that it was imported from (``detections.csv`` of
    truth), never by distance. Detections of a model have no annotation: only camera errors and the round trip are
    available for them.

    Args:
        poses: Table ``poses`` of the run.
        detections: Table ``detections``.
        observations: Table ``observations``.
        defects: Table ``defects``.
        photos: Table ``photos``.
        truth: The truth folder; its positions are in EPSG:4979 and are transformed into the run's site frame.
        origin: The run's site origin.
        map_crs: CRS of the tables' map columns, against which the site columns are checked.

    Raises:
        InputDataError: Truth is missing, invalid or of another campaign.
        SchemaError: The tables are not of this origin and CRS, or a covariance or position is invalid.
    """
    content = read_truth(truth)
    photo_ids = photos.column("photo_id").to_pylist()
    names = sorted(content.checkpoints)
    geo = np.array([content.checkpoints[name].geo for name in names]).reshape(-1, 3)
    campaign = _CampaignRows(
        cameras=read_posed_cameras(poses),
        detections={row["detection_id"]: row for row in detections.to_pylist()},
        registered=[
            row for row in observations.to_pylist() if row["observation_outcome"] == ObservationOutcome.REGISTERED
        ],
        defects=defects.to_pylist(),
        check_point_of_detection=match_detections(
            detections, content.check_point_of_annotation, truth / "detections.csv"
        ),
        xyz_true_site_m=dict(zip(names, origin.site_from_geo(geo), strict=True)),
    )
    _check_positions([*campaign.registered, *campaign.defects], origin, map_crs)
    matched_observations = [
        (row, point)
        for row in campaign.registered
        if (point := campaign.check_point_of_detection.get(row["detection_id"])) is not None
    ]
    check_point_by_defect = match_defects(
        [row["defect_id"] for row in campaign.defects], campaign.registered, campaign.check_point_of_detection
    )
    matched_defects = [
        (row, point) for row, point in zip(campaign.defects, check_point_by_defect, strict=True) if point is not None
    ]
    cameras = compare_cameras(poses, photo_ids, content, origin, truth)
    imported = any(detector.startswith(COCO_PREFIX) for detector in detections.column("detector").to_pylist())
    accepted = _select_accepted(campaign)
    roundtrip_px, roundtrip_cm = _compute_round_trip(
        campaign, {row["detection_id"]: row for row in campaign.registered}
    )
    defect_by_id = {row["defect_id"]: row for row in campaign.defects}
    defects_px, defects_cm = _compute_round_trip(
        campaign,
        {
            row["detection_id"]: defect_by_id[row["defect_id"]]
            for row in campaign.registered
            if row["defect_id"] in defect_by_id
        },
    )
    return TruthComparison(
        photographs_total=len(photo_ids),
        photographs_localised=len(campaign.cameras),
        cameras=cameras,
        xyz_camera_m=np.array([campaign.cameras[name].centre_site_m for name in cameras.photo_ids]).reshape(-1, 3),
        ray_error_m=_compute_ray_errors(campaign, accepted),
        observations=collect_position_samples(matched_observations, campaign.xyz_true_site_m, key="detection_id"),
        defects=collect_position_samples(matched_defects, campaign.xyz_true_site_m, key="defect_id"),
        roundtrip_px=roundtrip_px,
        roundtrip_cm=roundtrip_cm,
        roundtrip_defects_px=defects_px,
        roundtrip_defects_cm=defects_cm,
        members=tuple((row["defect_id"], point) for row, point in matched_observations if row["defect_id"]),
        element_pairs=_pair_elements(matched_observations, content),
        element_pairs_defects=_pair_elements(matched_defects, content),
        check_point_by_defect=tuple(check_point_by_defect),
        detected_check_points=frozenset(point for _, point in accepted),
        xyz_true_site_m=campaign.xyz_true_site_m,
        registered_without_check_point=len(campaign.registered) - len(matched_observations) if imported else None,
    )


def _get_position(row: Row) -> Float64x3:
    return np.array([row["x_site_m"], row["y_site_m"], row["z_site_m"]], dtype=np.float64)


def _pair_elements(rows: Sequence[tuple[Row, str]], truth: Truth) -> tuple[tuple[str | None, str], ...]:
    """Elements (found, true) of the rows whose check point has an element."""
    pairs = ((row["element_guid"], truth.checkpoints[point].element_guid) for row, point in rows)
    return tuple((found, true) for found, true in pairs if true)


def _check_positions(rows: Sequence[Row], origin: SiteOrigin, map_crs: str) -> None:
    """Raise SchemaError where the site columns, with this origin, and the map columns are different positions."""
    if not rows:
        return
    expected = origin.map_from_site(np.array([_get_position(row) for row in rows]), map_crs)[:, :2]
    stated = np.array([[row["east_map_m"], row["north_map_m"]] for row in rows], dtype=np.float64)
    deviation_m = float(np.abs(expected - stated).max())
    if not deviation_m <= POSITION_TOLERANCE_M:
        raise SchemaError(
            f"positions in the site frame and in {map_crs} are {deviation_m:.3f} m apart ({POSITION_TOLERANCE_M} m "
            "allowed); the site origin or the CRS is not that of the run: take both from the campaign's row of table "
            "buildings"
        )


def _compute_box_centre(row: Row) -> Float64Nx2:
    """Centre (1, 2) of a detection's box, px."""
    x, y = row["box_x_px"] + row["box_width_px"] / 2, row["box_y_px"] + row["box_height_px"] / 2
    return np.array([[x, y]], dtype=np.float64)


def _select_accepted(campaign: _CampaignRows) -> list[tuple[Row, str]]:
    """Accepted detections with the check point that they show."""
    rows = (
        (campaign.detections[detection_id], point) for detection_id, point in campaign.check_point_of_detection.items()
    )
    return [
        (row, point)
        for row, point in rows
        if point is not None and row["detection_outcome"] == DetectionOutcome.ACCEPTED
    ]


def _compute_ray_errors(campaign: _CampaignRows, accepted: Sequence[tuple[Row, str]]) -> Float64N:
    """Distances (n,) of check points from the rays of their boxes' centres, in localised photographs."""
    distances = []
    for row, point in accepted:
        camera = campaign.cameras.get(row["photo_id"])
        if camera is None:
            continue
        origins, directions = camera.rays_site_from_img(_compute_box_centre(row))
        offset = campaign.xyz_true_site_m[point] - origins[0]
        along = max(float(offset @ directions[0]), 0.0)  # a ray starts at its origin
        distances.append(float(np.linalg.norm(offset - along * directions[0])))
    return np.array(distances, dtype=np.float64)


def _compute_round_trip(campaign: _CampaignRows, positions: Mapping[str, Row]) -> tuple[Float64Nx2, Float64Nx2]:
    """Re-projected ``positions`` (by detection_id) minus the centres of their boxes (n, 2), right and down: in pixels,
    and in cm on the surface."""
    pixels, centimetres = [], []
    for row in campaign.registered:
        position = positions.get(row["detection_id"])
        if position is None:
            continue
        projected = campaign.cameras[row["photo_id"]].project_site(_get_position(position)[None])
        difference_px = (projected - _compute_box_centre(campaign.detections[row["detection_id"]]))[0]
        if not np.isfinite(difference_px).all():
            raise SchemaError(
                f"observation {row['detection_id']} is registered behind the camera of {row['photo_id']}; its "
                "position or the pose is wrong: run the campaign again"
            )
        pixels.append(difference_px)
        centimetres.append(difference_px * row["gsd_mm"] / 10)
    return np.array(pixels).reshape(-1, 2), np.array(centimetres).reshape(-1, 2)
