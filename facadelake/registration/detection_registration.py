"""Registration of detections on the surface, and exclusion of those that are not of the building."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from facadelake.building import BuildingModel
from facadelake.building.surface import Surface
from facadelake.core.geodesy import SITE_AXES
from facadelake.core.pose_table import read_pose_covariances, read_posed_cameras
from facadelake.registration.exclusion import ExclusionEvidence, ExclusionSettings, exclude_observations
from facadelake.registration.observation import observe_detections
from facadelake.registration.settings import RegistrationSettings
from facadelake.registration.tie_points import BlockImagePoints, triangulate_tie_points
from facadelake.sfm import Reconstruction

DEFAULT_EXCLUSION = ExclusionSettings()


def register_detections(
    detections: pa.Table,
    poses: pa.Table,
    building: BuildingModel,
    *,
    passport: Mapping[str, Any],
    settings: RegistrationSettings,
    masks: Mapping[str, Path],
    block: Reconstruction | None,
    exclusion: ExclusionSettings = DEFAULT_EXCLUSION,
) -> pa.Table:
    """Table ``observations`` of a campaign, not yet merged.

    Args:
        detections: table ``detections``.
        poses: table ``poses``.
        building: the building's surface and elements.
        passport: the campaign's row of table ``georeference``.
        settings: sampling of detections and limits of their outcomes.
        masks: exclusion masks by photo_id.
        block: the reconstruction, whose tie points show occluders; None where there is none (imported poses, or a
            campaign read from the lake), and then masks and geometry alone exclude.
        exclusion: limits of masks and occlusion.
    """
    posed, surface = read_posed_cameras(poses), Surface(building)
    table = observe_detections(
        detections, posed, building, surface, settings=settings, covariances=read_pose_covariances(poses)
    )
    evidence = ExclusionEvidence(
        tie_points=triangulate_tie_points(_read_image_points(block), posed) if block else None,
        masks=masks,
        placement_sigma_m=max(passport[f"sigma_{axis}_m"] for axis in SITE_AXES),
    )
    return exclude_observations(table, detections, posed, building.elements, surface, evidence, exclusion)


def _read_image_points(block: Reconstruction) -> BlockImagePoints:
    """The image points of the reconstruction's tie points."""
    return BlockImagePoints(
        photo_ids=[photo.photo_id for photo in block.photos],
        photo=block.image_point_photo,
        point=block.image_point_tie_point,
        xy_img=block.image_point_xy_img,
    )
