"""Comparison of a committed campaign with truth and the figures of that comparison."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from facadelake.building import read_registered_model
from facadelake.campaigns import read_committed_tables, register_on_committed_poses
from facadelake.core.errors import InputDataError
from facadelake.core.geodesy import SiteOrigin
from facadelake.detection.coco import import_coco
from facadelake.evaluation.campaigns.check_points import count_check_points
from facadelake.evaluation.campaigns.comparison import TruthComparison, compare_with_truth
from facadelake.evaluation.campaigns.covariance_consistency import compute_covariance_consistency
from facadelake.evaluation.campaigns.figures import CampaignFigures
from facadelake.evaluation.campaigns.merging import compute_merge_figures
from facadelake.evaluation.campaigns.paper_table2 import compute_table2
from facadelake.evaluation.campaigns.statistics import (
    compute_position_statistics,
    compute_statistics,
    compute_surface_statistics,
)
from facadelake.registry import Building, CocoDetectorSetting
from schemas.vocabulary import SurfaceKind


def compare_campaign(
    building: Building,
    campaign_id: str,
    *,
    lake: Path,
    truth: Path,
    detections: str | None,
    as_of: int | None = None,
) -> TruthComparison:
    """Compare a committed campaign with truth; the lake is not changed.

    Args:
        building: The registered building.
        campaign_id: A committed campaign.
        lake: Folder of the lake.
        truth: The truth folder.
        detections: Another COCO file of the campaign, which is registered and deduplicated in memory on the committed
            poses. The lake has no tie points, so that there masks and geometry alone exclude objects before the
            building. None: the committed detections.
        as_of: An earlier version of the lake; None: the newest.

    Returns:
        The comparison, for ``compute_figures`` and ``write_plots``.

    Raises:
        StoreError: The lake does not hold the campaign.
        InputDataError: The truth or the other file cannot be used.
        SchemaError: The tables do not fit the campaign's site origin.
    """
    names = ("photos", "poses", "georeference", "detections", "observations", "defects")
    tables = read_committed_tables(building, campaign_id, names, lake=lake, as_of=as_of)
    building_row = tables["buildings"].to_pylist()[0]
    origin = SiteOrigin(
        lon_deg=building_row["origin_lon_deg"],
        lat_deg=building_row["origin_lat_deg"],
        height_ellipsoidal_m=building_row["origin_height_ellipsoidal_m"],
    )
    if detections is not None:
        if not isinstance(building.detector, CocoDetectorSetting):
            raise InputDataError(
                f"--detections needs a building with a COCO detector; the detector of '{building.id}' is an ONNX model"
            )
        file = building.locate_detections(campaign_id, detections)
        if building.surface_kind is SurfaceKind.AS_BUILT:
            raise InputDataError(
                f"building '{building.id}' has no model (model: as-built), so other detections cannot be registered "
                f"here; run 'facadelake inspect {building.id} {campaign_id} --detections ...' and evaluate that"
            )
        model = read_registered_model(building)
        setting = building.detector
        imported = import_coco(file, tables["photos"], class_names=setting.classes, exif_view=setting.exif_view)
        registered = register_on_committed_poses(building, campaign_id, model, imported, tables)
        tables |= {"detections": imported, "observations": registered.observations, "defects": registered.defects}
    return compare_with_truth(
        photos=tables["photos"],
        poses=tables["poses"],
        detections=tables["detections"],
        observations=tables["observations"],
        defects=tables["defects"],
        truth=truth,
        origin=origin,
        map_crs=building_row["map_crs"],
    )


def compute_figures(compared: TruthComparison) -> CampaignFigures:
    """Compute the figures of a comparison with truth."""
    cameras, observations, defects = compared.cameras, compared.observations, compared.defects
    return CampaignFigures(
        photographs_total=compared.photographs_total,
        photographs_localised=compared.photographs_localised,
        camera_error=compute_position_statistics(cameras.error_site_m),
        ray_error=compute_statistics(compared.ray_error_m),
        observation_error=compute_surface_statistics(observations.error_site_m, observations.normal_site),
        defect_error=compute_surface_statistics(defects.error_site_m, defects.normal_site),
        roundtrip_px=compute_statistics(np.linalg.norm(compared.roundtrip_px, axis=1)),
        roundtrip_cm=compute_statistics(np.linalg.norm(compared.roundtrip_cm, axis=1)),
        roundtrip_defects_px=compute_statistics(np.linalg.norm(compared.roundtrip_defects_px, axis=1)),
        roundtrip_defects_cm=compute_statistics(np.linalg.norm(compared.roundtrip_defects_cm, axis=1)),
        merge=compute_merge_figures(compared.members),
        element_correct_share=_compute_correct_share(compared.element_pairs),
        element_correct_share_defects=_compute_correct_share(compared.element_pairs_defects),
        registered_without_check_point=compared.registered_without_check_point,
        check_points=count_check_points(
            xyz_true_site_m=compared.xyz_true_site_m,
            detected_check_points=compared.detected_check_points,
            check_point_by_defect=compared.check_point_by_defect,
            members=compared.members,
        ),
        consistency_cameras=compute_covariance_consistency(cameras.error_site_m, cameras.covariance_m2),
        consistency_observations=compute_covariance_consistency(observations.error_site_m, observations.covariance_m2),
        consistency_defects=compute_covariance_consistency(defects.error_site_m, defects.covariance_m2),
        table2=compute_table2(compared.roundtrip_cm, compared.roundtrip_defects_cm, observations, defects),
    )


def _compute_correct_share(pairs: Sequence[tuple[str | None, str]]) -> float | None:
    """Share of pairs (found, true) that are equal; None where there is no pair."""
    return float(np.mean([found == true for found, true in pairs])) if pairs else None
