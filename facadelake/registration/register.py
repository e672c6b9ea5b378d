"""Detections to observations on the building's surface, those that are not of the building told apart."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from facadelake.building import BuildingModel
from facadelake.building.surface import Surface
from facadelake.core.pose_table import read_pose_covariances, read_posed_cameras
from facadelake.registration.exclusion import ExclusionSettings, Scene, exclude
from facadelake.registration.observe import observe
from facadelake.registration.settings import RegisterSettings
from facadelake.registration.tie_points import Tracks, tie_points
from facadelake.sfm import Reconstruction

DEFAULT_EXCLUSION = ExclusionSettings()


def register_detections(
    detections: pa.Table,
    poses: pa.Table,
    building: BuildingModel,
    *,
    passport: Mapping[str, Any],
    settings: RegisterSettings,
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
        settings: how boxes are sampled and which of them are refused.
        masks: exclusion masks by photo_id.
        block: the reconstruction, whose tie points show what stands before the building; None where there is none
            (poses were imported, or the campaign is read from the lake), so that masks and geometry alone exclude.
        exclusion: limits of masks and occluders.
    """
    posed, surface = read_posed_cameras(poses), Surface(building)
    table = observe(detections, posed, building, surface, settings=settings, covariances=read_pose_covariances(poses))
    scene = Scene(
        points=tie_points(_tracks(block), posed) if block else None,
        masks=masks,
        placement_sigma_m=max(passport[f"sigma_{axis}_m"] for axis in ("east", "north", "up")),
    )
    return exclude(table, detections, posed, building.elements, surface, scene, exclusion)


def _tracks(block: Reconstruction) -> Tracks:
    return Tracks(
        photo_ids=[photo.photo_id for photo in block.photos],
        photo=block.track_photo,
        point=block.track_point,
        xy_img=block.track_xy_img,
    )
