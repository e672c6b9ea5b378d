"""What can be told before any work begins: files that an inspection needs and that are not there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from facadelake.core.errors import InputDataError
from facadelake.detection import load_configured_detector, resolve_default_model
from facadelake.georeferencing.imported import list_pose_files
from facadelake.registry import Building, CocoDetectorSetting
from facadelake.severity import find_rule_file
from schemas.vocabulary import ControlKind, SurfaceKind

LATEST = "latest"
AUTO = "auto"


def resolve_campaign(building: Building, campaign_id: str) -> str:
    """The campaign itself, or the building's newest for 'latest'. Raises InputDataError where there is none."""
    if campaign_id != LATEST:
        return campaign_id
    known = building.list_campaigns()
    if not known:
        raise InputDataError(
            f"building '{building.id}' has no campaign with photographs yet; looked for {building.photographs}"
        )
    return known[-1]


def choose_poses(building: Building, campaign_id: str, georeference: str, poses: str | None) -> Path | None:
    """The poses to import: those asked for, else the registry's unless a control is named; None: to be found anew.

    Raises InputDataError where poses are named and not there, or asked for together with a control.
    """
    if georeference == AUTO:
        found = building.locate_poses(campaign_id, poses)
        if found is not None:
            list_pose_files(found)
        return found
    if poses is not None:
        raise InputDataError(
            f"--poses {poses} and --georeference {georeference} contradict one another: imported poses are placed "
            "already; leave one out"
        )
    return None


def check_control(building: Building, campaign_id: str, georeference: str, poses: str | None) -> None:
    """Raise InputDataError for a control that a building without a model (``model: as-built``) cannot have."""
    if building.surface_kind is not SurfaceKind.AS_BUILT:
        return
    if georeference == ControlKind.MODEL:
        raise InputDataError(
            f"building '{building.id}' has no model (model: as-built), so --georeference model has nothing to hold to; "
            "use gcp, campaign or gps, or give the registry a model"
        )
    if choose_poses(building, campaign_id, georeference, poses) is not None:
        raise InputDataError(
            f"building '{building.id}' has no model (model: as-built): its surface is made of tie points, which "
            "imported poses do not bring; let the poses be found (--georeference gcp, campaign or gps), or give the "
            "registry a mesh"
        )


def check_files(building: Building, campaign_id: str, detections: str | None) -> tuple[str, ...]:
    """Raise InputDataError for the first file that an inspection needs and that is not there.

    Returns warnings of what is missing but can be done without.
    """
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
        load_configured_detector(building.detector)  # a model that cannot be used is told before the hours of work
    if building.control_points is not None and building.locate_control_points(campaign_id) is None:
        path = building.control_points.replace("{campaign}", campaign_id)
        return (f"the registry names control points, but {path} does not exist; without them GPS is the control",)
    return ()


@dataclass(frozen=True, kw_only=True)
class PlannedInspection:
    """An inspection that can begin: all that it was asked for is there.

    ``building`` names the detector's file, so that a promotion does not reach a run under way; ``control`` None: the
    best there is; ``poses``: the file or folder to import them from, None: they are found.
    """

    building: Building
    campaign_id: str
    control: ControlKind | None
    poses: Path | None
    warnings: tuple[str, ...]


def plan_inspection(
    building: Building, campaign_id: str, *, georeference: str, detections: str | None, poses: str | None
) -> PlannedInspection:
    """What is to be done, after everything that can be told before any work begins was checked.

    Args:
        building: the registered building.
        campaign_id: its campaign; 'latest' is the newest that has photographs.
        georeference: a control, or 'auto'.
        detections: other detections than the registry's: the name of an alternative, or a COCO file.
        poses: a file or folder of poses of another program.

    Raises InputDataError for what is missing or contradicts itself, ModelError for a detector that cannot be used.
    """
    campaign = resolve_campaign(building, campaign_id)
    warnings = check_files(building, campaign, detections)
    check_control(building, campaign, georeference, poses)
    return PlannedInspection(
        building=resolve_default_model(building),
        campaign_id=campaign,
        control=None if georeference == AUTO else ControlKind(georeference),
        poses=choose_poses(building, campaign, georeference, poses),
        warnings=warnings,
    )
