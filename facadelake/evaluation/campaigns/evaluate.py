"""Comparison of a committed campaign with truth and the figures of that comparison."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

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
    building: Building, campaign_id: str, *, lake: Path, truth: Path, detections: str | None
) -> TruthComparison:
    """A committed campaign beside truth; ``figures_of`` and ``write_plots`` tell of it.

    With ``detections`` another file is registered and merged on the committed poses, in memory; tie points, which tell
    what stands before the building, are not in the lake, so that only masks and geometry exclude there.
    Raises StoreError where the lake does not hold the campaign, InputDataError where the truth is not usable.
    """
    names = ("photos", "poses", "georeference", "detections", "observations", "defects")
    tables = read_committed_tables(building, campaign_id, names, lake=lake)
    place = tables["buildings"].to_pylist()[0]
    origin = SiteOrigin(
        lon_deg=place["origin_lon_deg"],
        lat_deg=place["origin_lat_deg"],
        height_ellipsoidal_m=place["origin_height_ellipsoidal_m"],
    )
    if detections is not None:
        if not isinstance(building.detector, CocoDetectorSetting):
            raise InputDataError(
                f"--detections needs a building whose detector reads COCO files; '{building.id}' has an ONNX model"
            )
        file = building.locate_detections(campaign_id, detections)
        if building.surface_kind is SurfaceKind.AS_BUILT:
            raise InputDataError(
                f"building '{building.id}' has no model (model: as-built), so other detections cannot be registered "
                f"here; run 'facadelake inspect {building.id} {campaign_id} --detections ...' and evaluate that"
            )
        model = read_registered_model(building)
        found = import_coco(file, tables["photos"], class_names=building.detector.classes)
        merged = register_on_committed_poses(building, campaign_id, model, found, tables)
        tables |= {"detections": found, "observations": merged.observations, "defects": merged.defects}
    return compare_with_truth(
        photos=tables["photos"],
        poses=tables["poses"],
        detections=tables["detections"],
        observations=tables["observations"],
        defects=tables["defects"],
        truth=truth,
        origin=origin,
        map_crs=place["map_crs"],
    )


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
) -> CampaignFigures:
    """The figures of one campaign's tables against the folder ``truth``; arguments and errors as of ``compare_with_truth``."""
    return compute_figures(
        compare_with_truth(
            poses=poses,
            detections=detections,
            observations=observations,
            defects=defects,
            photos=photos,
            truth=truth,
            origin=origin,
            map_crs=map_crs,
        )
    )


def compute_figures(compared: TruthComparison) -> CampaignFigures:
    """The figures of methods.md."""
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
    """Share of (found, true) that are the same; None where there are none."""
    return float(np.mean([found == true for found, true in pairs])) if pairs else None
