"""Placement of a campaign by imported poses: matched with photographs, transformed to site, checked, as tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.building.surface import Surface
from facadelake.core.arrays import Float64Array, Float64x3, Float64x3x3
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import GeoreferenceError, InputDataError
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SITE_AXES
from facadelake.core.photo_names import PhotoNames
from facadelake.core.tables import table_from_rows
from facadelake.georeferencing.acceptance import require_accuracy
from facadelake.georeferencing.accepted_statements import accept_statements
from facadelake.georeferencing.accuracy_remedies import suggest_shift_remedy
from facadelake.georeferencing.datum_shift import (
    DatumShift,
    build_operation_columns,
    describe_datum_shift,
    find_datum_shift,
)
from facadelake.georeferencing.gcp.control_points import SurveyedPoints, describe_doubtful_marks, match_marks
from facadelake.georeferencing.imported.plausibility import check_plausibility
from facadelake.georeferencing.imported.records import ImportedPose, ImportedPoses
from facadelake.georeferencing.imported.validation import COVERED, ImportValidation, validate_imported_poses
from facadelake.georeferencing.initial_placement import CONTROL_SIGMA_M
from facadelake.georeferencing.model_checks import check_cameras
from facadelake.georeferencing.passport import build_points_table
from facadelake.georeferencing.placement_checks import (
    build_checks_table,
    check_gps,
    check_surveyed_points,
    require_agreement,
)
from facadelake.georeferencing.poses_table import build_pose_columns, widen_poses
from facadelake.georeferencing.site_frame import SiteFrame
from facadelake.registry import AcceptedStatement
from schemas.vocabulary import ControlKind, PhotoOutcome, PlacementStatement, PoseSource

# Accuracy of a good bundle adjustment on a building; assumed where the file states no sigma.
SIGMA_POSITION_M = 0.02
SIGMA_ATTITUDE_DEG = 0.02
_REMEDY = "import more accurate poses, or leave them out and place the photographs by control points or the model"


@dataclass(frozen=True, kw_only=True, eq=False)
class ImportedPlacement:
    """A campaign with imported poses: tables ``poses``, ``georeference``, ``georeference_points`` and
    ``placement_checks``."""

    poses: pa.Table
    georeference: pa.Table
    georeference_points: pa.Table
    placement_checks: pa.Table
    localised: int


def place_imported_poses(
    imported: ImportedPoses,
    photos: pa.Table,
    *,
    site_frame: SiteFrame,
    surface: Surface,
    placement_sigma_max_m: float,
    surveyed: Sequence[SurveyedPoints] = (),
    accepted_statements: Sequence[AcceptedStatement] = (),
) -> ImportedPlacement:
    """Place a campaign by imported poses.

    Args:
        imported: the file of poses.
        photos: table ``photos``.
        site_frame: the building's site frame.
        surface: the building's surface, for the plausibility of the poses.
        placement_sigma_max_m: limit of the poses' median sigma.
        surveyed: control and check points. They and the photographs' GPS validate the poses in the passport and do not
            change them.
        accepted_statements: those that may contradict the placement.

    Returns:
        the tables; one row of ``poses`` for each accepted photograph, with its pose or with the reason why it has none.

    Raises:
        InputDataError: no pose belongs to a photograph of this campaign.
        GeoreferenceError: the poses are not plausible, not accurate enough, or contradict the surveyed points.
    """
    accepted = [row for row in photos.to_pylist() if row["photo_outcome"] == PhotoOutcome.ACCEPTED]
    photo_ids = photos["photo_id"].to_pylist()
    pose_of, reasons, unmatched = _match_to_photographs(imported, photo_ids, {row["photo_id"] for row in accepted})
    posed = _build_cameras(pose_of, {row["photo_id"]: row for row in accepted}, reasons, imported, site_frame)
    if not posed:
        examples = "; ".join([*list(reasons.values())[:2], *unmatched[:2]])
        raise InputDataError(
            f"none of the {len(imported.poses) + len(imported.unusable)} poses of {imported.source} can be used for "
            f"the {len(accepted)} photographs of the campaign: {examples or 'the file has no lines'}"
        )
    remarks = check_plausibility(posed, accepted, surface, site_frame, source=imported.source)
    covariance = {photo_id: pose_of[photo_id].covariance for photo_id in posed}
    without_sigma = sum(stated is None for stated in covariance.values())
    if without_sigma:
        remarks.append(
            f"{without_sigma} of {len(posed)} poses state no sigma: {SIGMA_POSITION_M * 100:g} cm and "
            f"{SIGMA_ATTITUDE_DEG:g} deg are assumed"
        )
    shift = imported.world.find_datum_shift(site_frame)
    if unmatched:
        remarks.append(f"{len(unmatched)} poses belong to no photograph of this campaign ({unmatched[0]})")
    rows = []
    for row in accepted:
        photo_id = row["photo_id"]
        columns: dict[str, Any] = {
            "photo_id": photo_id,
            "image_width_px": row["image_width_px"],
            "image_height_px": row["image_height_px"],
            "tie_points": 0,
        }
        if photo_id in posed:
            stated = covariance[photo_id]
            total = (_build_assumed_covariance() if stated is None else stated).copy()
            if shift is not None:
                total[:3, :3] += shift.covariance_m2
            pose = build_pose_columns(posed[photo_id], total, site_frame.origin)
            rows.append(columns | {"pose_source": PoseSource.IMPORTED} | pose)
        else:
            reason = reasons.get(photo_id, f"{imported.source} has no pose for it")
            rows.append(columns | {"pose_source": PoseSource.UNLOCALISED, "reason": reason})
    poses = table_from_rows("poses", rows)
    matched = [match_marks(file, photo_ids) for file in surveyed]
    remarks += [remark for file in matched for remark in (*file.remarks, *describe_doubtful_marks(file, photos))]
    validation = validate_imported_poses(posed, accepted, matched, site_frame)
    sigma_m = _require_accuracy(poses, validation, shift, placement_sigma_max_m)
    gps_shift = find_datum_shift(site_frame.gnss_crs, site_frame)
    lowest_m, highest_m = surface.vertices_site_m[:, 2].min(), surface.vertices_site_m[:, 2].max()
    checks = (
        *check_gps(
            validation.gps_residual_m,
            np.hypot(validation.gps_sigma_m, gps_shift.sigma_m),
            validation.gps_flight,
            sigma_m,
            gps_shift.convention_m,
            datum_unknown=validation.gps_datum_unknown,
        ),
        check_surveyed_points(PlacementStatement.SURVEYED_POINTS, validation.held_out_m, sigma_m, CONTROL_SIGMA_M),
        *check_cameras(list(posed.values()), surface, float(lowest_m), float(highest_m)),
    )
    checks = accept_statements(checks, accepted_statements)
    centres = np.array([camera.centre_site_m for camera in posed.values()])
    disagreements = require_agreement(
        checks,
        control=ControlKind.IMPORTED,
        method=f"the poses of {imported.source}",
        placement_sigma_max_m=placement_sigma_max_m,
        height_ellipsoidal_m=float(np.median(site_frame.origin.geo_from_site(centres)[:, 2])),
    )
    common_m = validation.find_common_error_m(checks)
    return ImportedPlacement(
        poses=widen_poses(poses, common_m),
        georeference=_build_passport(
            imported,
            poses,
            site_frame=site_frame,
            shift=shift,
            remarks=[*disagreements, *([COVERED] if common_m.any() else []), *remarks],
            validation=validation,
            sigma_m=np.hypot(sigma_m, common_m),
        ),
        placement_checks=build_checks_table(checks),
        georeference_points=build_points_table(validation.points, site_frame.origin),
        localised=len(posed),
    )


def _build_assumed_covariance() -> Float64Array:
    return np.diag([SIGMA_POSITION_M**2] * 3 + [np.radians(SIGMA_ATTITUDE_DEG) ** 2] * 3)


def _match_to_photographs(
    imported: ImportedPoses, photo_ids: Sequence[str], accepted: Collection[str]
) -> tuple[dict[str, ImportedPose], dict[str, str], list[str]]:
    """Poses by photo_id, reasons of photographs whose line cannot be used, and reasons of lines without photograph."""
    images = [*(pose.image for pose in imported.poses), *(line.image for line in imported.unusable)]
    names = PhotoNames(photo_ids).match_all(images)
    pose_of: dict[str, ImportedPose] = {}
    reasons: dict[str, str] = {}
    unmatched: list[str] = []
    matches = [(pose, names[pose.image]) for pose in imported.poses]
    count = Counter(match.photo_id for _, match in matches if match.photo_id is not None)
    for pose, match in matches:
        if match.photo_id is None:
            unmatched.append(match.reason)
        elif match.photo_id not in accepted:
            unmatched.append(f"{match.photo_id} was not accepted")
        elif count[match.photo_id] > 1:
            reasons[match.photo_id] = f"{imported.source} has {count[match.photo_id]} poses for it; keep one"
        else:
            pose_of[match.photo_id] = pose
    for line in imported.unusable:
        photo_id = names[line.image].photo_id
        if photo_id is None:
            unmatched.append(line.reason)
        elif pose_of.pop(photo_id, None) is not None:
            reasons[photo_id] = f"{imported.source} has two lines for it; keep one"
        else:
            reasons[photo_id] = line.reason
    return pose_of, reasons, unmatched


def _build_cameras(
    pose_of: Mapping[str, ImportedPose],
    row_of: Mapping[str, Mapping[str, Any]],
    reasons: dict[str, str],
    imported: ImportedPoses,
    site_frame: SiteFrame,
) -> dict[str, PosedCamera]:
    """The cameras in site by photo_id.

    A lens that does not fit its photograph, or a position outside the CRS, is added to ``reasons`` in place.
    """
    posed = {}
    placed = _transform_to_site(list(pose_of.values()), imported, site_frame)
    for (photo_id, pose), result in zip(pose_of.items(), placed, strict=True):
        row = row_of[photo_id]
        if isinstance(result, GeoreferenceError):
            reasons[photo_id] = f"{imported.source}: {result}"
            continue
        centre, rotation = result
        try:
            camera = pose.lens.scale_to(row["image_width_px"], row["image_height_px"])
        except InputDataError as error:
            reasons[photo_id] = f"{imported.source}: {error}"
            continue
        posed[photo_id] = PosedCamera(camera=camera, site_from_cam=Similarity(rotation=rotation, translation=centre))
    return posed


def _transform_to_site(
    poses: Sequence[ImportedPose], imported: ImportedPoses, site_frame: SiteFrame
) -> list[tuple[Float64x3, Float64x3x3] | GeoreferenceError]:
    """Centre and rotation of each pose in site, or why it has none. Raises GeoreferenceError where none has."""
    if not poses:
        return []
    centres, rotations = np.array([pose.xyz_world for pose in poses]), np.array([pose.world_from_cam for pose in poses])
    world = imported.world
    try:
        return list(zip(*world.transform_to_site(centres, rotations, site_frame), strict=True))
    except GeoreferenceError as error_of_all:
        results: list[tuple[Float64x3, Float64x3x3] | GeoreferenceError] = []
        for k in range(len(poses)):
            try:
                centre, rotation = world.transform_to_site(centres[k : k + 1], rotations[k : k + 1], site_frame)
                results.append((centre[0], rotation[0]))
            except GeoreferenceError as error:
                results.append(error)
        if all(isinstance(result, GeoreferenceError) for result in results):
            raise error_of_all
        return results


def _require_accuracy(
    poses: pa.Table, validation: ImportValidation, shift: DatumShift | None, limit_m: float
) -> Float64x3:
    """Median sigma (3,) of the imported poses.

    Args:
        poses: table ``poses``.
        validation: residuals at surveyed points.
        shift: the shift from the poses' datum to that of the model.
        limit_m: limit of the median sigma.

    Returns:
        the sigma.

    Raises:
        GeoreferenceError: it exceeds the limit, or surveyed points contradict the poses.
    """
    rows = [row for row in poses.to_pylist() if row["pose_source"] == PoseSource.IMPORTED]
    sigma_m = np.array([np.median([row[f"sigma_{axis}_m"] for row in rows]) for axis in SITE_AXES])
    require_accuracy(
        control=ControlKind.IMPORTED,
        sigma_m=sigma_m,
        limit_m=limit_m,
        held_out_m=validation.held_out_m,
        remedy="; ".join(
            filter(None, [describe_datum_shift(shift, sigma_m), suggest_shift_remedy(shift, sigma_m) or _REMEDY])
        ),
    )
    return sigma_m


def _build_passport(
    imported: ImportedPoses,
    poses: pa.Table,
    *,
    site_frame: SiteFrame,
    shift: DatumShift | None,
    remarks: Sequence[str],
    validation: ImportValidation,
    sigma_m: Float64x3,
) -> pa.Table:
    """Table ``georeference`` of an import; it has no residuals of an adjustment.

    Args:
        imported: the file of poses.
        poses: table ``poses``.
        site_frame: the building's site frame.
        shift: the shift from the poses' datum to that of the model.
        remarks: remarks on the poses.
        validation: residuals at surveyed points and GPS.
        sigma_m: median sigma (3,) of the poses.

    Returns:
        the table, one row.
    """
    assumptions = imported.world.describe_assumptions(site_frame)
    return table_from_rows(
        "georeference",
        [
            {
                "control": ControlKind.IMPORTED,
                "method": f"poses imported from {imported.source}",
                "map_crs": site_frame.map_crs,
                "vertical_datum": site_frame.vertical_datum,
                "georeference_level": site_frame.georeference_level,
                "points_used": poses["pose_source"].to_pylist().count(PoseSource.IMPORTED),
                "points_total": len(imported.poses) + len(imported.unusable),
                "scale": 1.0,
                **validation.columns,
                **build_operation_columns(site_frame, shift),
                **{f"sigma_{axis}_m": float(s) for axis, s in zip(SITE_AXES, sigma_m, strict=True)},
                "remarks": "; ".join(
                    [
                        *filter(None, [describe_datum_shift(shift, sigma_m)]),
                        *imported.remarks,
                        *assumptions,
                        *remarks,
                        *validation.remarks,
                        *site_frame.list_model_remarks(),
                    ]
                ),
            }
        ],
    )
