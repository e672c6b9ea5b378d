"""Evaluate a campaign's tables against a truth folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from facadelake.core.geodesy import SiteOrigin
from facadelake.evaluation.campaigns.check_points import check_points_of
from facadelake.evaluation.campaigns.comparison import Comparison, compare
from facadelake.evaluation.campaigns.covariance_consistency import honesty_of
from facadelake.evaluation.campaigns.figures import Figures
from facadelake.evaluation.campaigns.merging import merging_of
from facadelake.evaluation.campaigns.paper_table2 import table2_of
from facadelake.evaluation.campaigns.statistics import position_stats, stats_of, surface_stats


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
    """The figures of one campaign's tables against the folder ``truth``; arguments and errors as of ``compare``."""
    return figures_of(
        compare(
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


def figures_of(compared: Comparison) -> Figures:
    """The figures of methods.md."""
    cameras, observations, defects = compared.cameras, compared.observations, compared.defects
    return Figures(
        photographs_total=compared.photographs_total,
        photographs_localised=compared.photographs_localised,
        camera_error=position_stats(cameras.error_site_m),
        ray_error=stats_of(compared.ray_error_m),
        observation_error=surface_stats(observations.error_site_m, observations.normal_site),
        defect_error=surface_stats(defects.error_site_m, defects.normal_site),
        roundtrip_px=stats_of(np.linalg.norm(compared.roundtrip_px, axis=1)),
        roundtrip_cm=stats_of(np.linalg.norm(compared.roundtrip_cm, axis=1)),
        roundtrip_defects_px=stats_of(np.linalg.norm(compared.roundtrip_defects_px, axis=1)),
        roundtrip_defects_cm=stats_of(np.linalg.norm(compared.roundtrip_defects_cm, axis=1)),
        merge=merging_of(compared.members),
        element_correct_share=_right(compared.element_pairs),
        element_correct_share_defects=_right(compared.element_pairs_defects),
        off_truth=compared.off_truth,
        check_points=check_points_of(
            xyz_true_site_m=compared.xyz_true_site_m,
            detected=compared.detected,
            shown_by_defect=compared.shown_by_defect,
            members=compared.members,
        ),
        honesty_cameras=honesty_of(cameras.error_site_m, cameras.covariance_m2),
        honesty_observations=honesty_of(observations.error_site_m, observations.covariance_m2),
        honesty_defects=honesty_of(defects.error_site_m, defects.covariance_m2),
        table2=table2_of(compared.roundtrip_cm, compared.roundtrip_defects_cm, observations, defects),
    )


def _right(pairs: Sequence[tuple[str | None, str]]) -> float | None:
    """Share of (found, true) that are the same; None where there are none."""
    return float(np.mean([found == true for found, true in pairs])) if pairs else None
