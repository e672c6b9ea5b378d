"""Checks before an inspection begins: missing files, contradictory options, unusable detectors."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

from facadelake.campaigns.capture_order import order_by_capture
from facadelake.core.errors import InputDataError
from facadelake.detection import load_configured_detector, resolve_default_model
from facadelake.georeferencing.imported import list_pose_files
from facadelake.photos import list_position_remarks
from facadelake.registry import Building, CocoDetectorSetting
from facadelake.severity import find_rule_file
from schemas.vocabulary import ControlKind, SurfaceKind

logger = logging.getLogger(__name__)

LATEST = "latest"
AUTO = "auto"


def resolve_campaign(building: Building, campaign_id: str) -> str:
    """The campaign, or for 'latest' the building's newest by its photographs' times; InputDataError where it has none.

    Where the order of the campaigns is not by their photographs, a warning is logged.
    """
    found, remarks = _find_campaign(building, campaign_id)
    for remark in remarks:
        logger.warning("%s", remark)
    return found


def _find_campaign(building: Building, campaign_id: str) -> tuple[str, tuple[str, ...]]:
    """The campaign, and what is to be said of the order by which it is the latest."""
    if campaign_id != LATEST:
        return campaign_id, ()
    order = order_by_capture(building)
    if not order.campaigns:
        raise InputDataError(
            f"building '{building.id}' has no campaign with photographs; searched {building.photographs}"
        )
    return order.campaigns[-1], order.remarks


def choose_poses(building: Building, campaign_id: str, georeference: str, poses: str | None) -> Path | None:
    """The poses to import: the option's, otherwise the portfolio's unless a control is named; None: reconstruct them.

    Args:
        building: the registered building.
        campaign_id: its campaign.
        georeference: a control, or 'auto'.
        poses: a file or folder of poses, None: not given.

    Raises:
        InputDataError: where named poses do not exist, or are given together with a control.
    """
    if georeference == AUTO:
        path = building.locate_poses(campaign_id, poses)
        if path is not None:
            list_pose_files(path)
        return path
    if poses is not None:
        raise InputDataError(
            f"--poses {poses} and --georeference {georeference} are contradictory: imported poses are georeferenced "
            "already; omit one of them"
        )
    return None


def check_control(building: Building, campaign_id: str, georeference: str, poses: str | None) -> None:
    """Check that the control is possible for a building without a model (``model: as-built``).

    Args:
        building: the registered building.
        campaign_id: its campaign.
        georeference: a control, or 'auto'.
        poses: a file or folder of poses, None: not given.

    Raises:
        InputDataError: for the model as control, and for imported poses.
    """
    if building.surface_kind is not SurfaceKind.AS_BUILT:
        return
    if georeference == ControlKind.MODEL:
        raise InputDataError(
            f"building '{building.id}' has no model (model: as-built), so --georeference model is not possible; "
            "use gcp, campaign or gps, or name a model in the portfolio"
        )
    if choose_poses(building, campaign_id, georeference, poses) is not None:
        raise InputDataError(
            f"building '{building.id}' has no model (model: as-built): its surface is made of tie points, which "
            "imported poses do not have; reconstruct the poses (--georeference gcp, campaign or gps), or name a mesh "
            "in the portfolio"
        )


def check_files(building: Building, campaign_id: str, detections: str | None) -> tuple[str, ...]:
    """Warnings for optional files that are missing; InputDataError for the first required file that is missing."""
    if building.surface_kind is not SurfaceKind.AS_BUILT:
        building.locate_model()
        building.locate_offset_file()
    building.locate_photographs(campaign_id)
    find_rule_file(building.severity_rules)
    if isinstance(building.detector, CocoDetectorSetting):
        building.locate_detections(campaign_id, detections)
    elif detections is not None:
        raise InputDataError(
            f"--detections '{detections}' is for buildings whose detector reads COCO files; '{building.id}' has a model"
        )
    else:
        load_configured_detector(building.detector)  # an unusable model is reported before the hours of work
    surveyed = (
        ("control", building.control_points, building.locate_control_points(campaign_id)),
        ("check", building.check_points, building.locate_check_points(campaign_id)),
    )
    missing = tuple(
        f"the portfolio names {kind} points, but {template.replace('{campaign}', campaign_id)} does not exist; the "
        "campaign is placed without them"
        for kind, template, path in surveyed
        if template is not None and path is None
    )
    return (*missing, *list_position_remarks(building, campaign_id))


@dataclass(frozen=True, kw_only=True)
class PlannedInspection:
    """An inspection whose inputs exist.

    ``building`` names the detector's file, so that a promotion during the run has no effect; ``control`` None: the best
    available; ``poses``: file or folder of poses to import, None: they are reconstructed.
    """

    building: Building
    campaign_id: str
    control: ControlKind | None
    poses: Path | None
    warnings: tuple[str, ...]


def plan_inspection(
    building: Building, campaign_id: str, *, georeference: str, detections: str | None, poses: str | None
) -> PlannedInspection:
    """Plan an inspection after checking its inputs.

    Args:
        building: the registered building.
        campaign_id: its campaign; 'latest' is the newest with photographs, by their times.
        georeference: a control, or 'auto'.
        detections: other detections than the portfolio's: the name of an alternative, or a COCO file.
        poses: a file or folder of poses of another program.

    Raises:
        InputDataError: for missing files and contradictory options.
        ModelError: for a detector that cannot be used.
    """
    campaign, remarks = _find_campaign(building, campaign_id)
    warnings = (*remarks, *check_files(building, campaign, detections))
    check_control(building, campaign, georeference, poses)
    return PlannedInspection(
        building=resolve_default_model(building),
        campaign_id=campaign,
        control=None if georeference == AUTO else ControlKind(georeference),
        poses=choose_poses(building, campaign, georeference, poses),
        warnings=warnings,
    )
