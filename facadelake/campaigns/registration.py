"""Registration and merging of other detections on the poses of a committed campaign, in memory."""

from __future__ import annotations

from collections.abc import Mapping

import pyarrow as pa

from facadelake.building import BuildingModel
from facadelake.core.pose_table import read_pose_covariances, read_posed_cameras
from facadelake.deduplication import MergeResult, PhotographSource, merge_observations, resolve_merge_settings
from facadelake.photos import find_masks
from facadelake.registration import register_detections, resolve_registration_settings
from facadelake.registry import Building


def register_on_committed_poses(
    building: Building, campaign_id: str, model: BuildingModel, detections: pa.Table, tables: Mapping[str, pa.Table]
) -> MergeResult:
    """Observations and defects of other detections on the poses of a committed campaign.

    The lake does not store tie points, so occluders are found by exclusion masks and the model alone.

    Args:
        building: the registered building.
        campaign_id: its campaign.
        model: its model.
        detections: table ``detections``.
        tables: the campaign's tables ``poses`` and ``georeference``.
    """
    passport, poses = tables["georeference"].to_pylist()[0], tables["poses"]
    root = building.locate_photographs(campaign_id)
    observations = register_detections(
        detections,
        poses,
        model,
        passport=passport,
        settings=resolve_registration_settings(building),
        masks=find_masks(root),
        block=None,
    )
    posed = read_posed_cameras(poses)
    return merge_observations(
        observations,
        detections,
        model,
        posed,
        prefix=f"{building.id}-{campaign_id}",
        settings=resolve_merge_settings(passport),
        covariances=read_pose_covariances(poses),
        photographs=PhotographSource(root=root, posed=posed),
    )
