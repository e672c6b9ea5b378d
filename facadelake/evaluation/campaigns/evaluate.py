"""Evaluate a campaign's tables against a truth folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from facadelake.core.geodesy import SiteOrigin
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
