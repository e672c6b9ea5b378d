"""Imported poses onto the campaign's photographs: who is who, into site, and whether they can be right."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64Array
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import GeoreferenceError, InputDataError
from facadelake.core.frames import Similarity
from facadelake.core.photo_names import PhotoNames
from facadelake.core.tables import table_from_rows
from facadelake.georeferencing.gcp.control_points import SurveyedPoints
from facadelake.georeferencing.imported.plausibility import SurfaceLike, check_plausibility
from facadelake.georeferencing.imported.records import ImportedPose, ImportedPoses
from facadelake.georeferencing.imported.validation import ImportValidation, validate_imported_poses
from facadelake.georeferencing.passport import build_points_table, require_accuracy
from facadelake.georeferencing.poses_table import build_pose_columns
from facadelake.georeferencing.site_frame import SiteFrame
from schemas.vocabulary import ControlKind, PhotoOutcome, PoseSource

# What a good bundle adjustment knows of its cameras on a building; taken where the file states no sigma.
SIGMA_POSITION_M = 0.02
SIGMA_ATTITUDE_DEG = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class ImportedPlacement:
    """A campaign whose poses were imported: tables ``poses``, ``georeference`` and ``georeference_points``."""

    poses: pa.Table
    georeference: pa.Table
    georeference_points: pa.Table
    localised: int


def place_imported_poses(
    found: ImportedPoses,
    photos: pa.Table,
    *,
    place: SiteFrame,
    surface: SurfaceLike,
    placement_sigma_max_m: float,
    surveyed: Sequence[SurveyedPoints] = (),
) -> ImportedPlacement:
    """One row for each accepted photograph of ``photos``, with its imported pose or with the reason why it has none.

    ``surveyed`` points and the photographs' GPS judge the poses in the passport; they do not move them.
    Raises InputDataError where no pose is of a photograph of this campaign, GeoreferenceError where the poses cannot
    be right: far from the building, looking away from it or turned against what the photographs state, known too badly
    to be of use, or off the surveyed points.
    """
    accepted = [row for row in photos.to_pylist() if row["photo_outcome"] == PhotoOutcome.ACCEPTED]
    own, reasons, strangers = _match_to_photographs(found, accepted)
    posed = _build_cameras(own, {row["photo_id"]: row for row in accepted}, reasons, found, place)
    if not posed:
        some = "; ".join([*list(reasons.values())[:2], *strangers[:2]])
        raise InputDataError(
            f"none of the {len(found.poses) + len(found.unusable)} poses of {found.source} can be used for the "
            f"{len(accepted)} photographs of the campaign: {some or 'the file has no lines'}"
        )
    remarks = check_plausibility(posed, accepted, surface, place, source=found.source)
    covariance = {photo_id: own[photo_id].covariance for photo_id in posed}
    silent = sum(stated is None for stated in covariance.values())
    if silent:
        remarks.append(
            f"{silent} of {len(posed)} poses state no sigma: {SIGMA_POSITION_M * 100:g} cm and "
            f"{SIGMA_ATTITUDE_DEG:g} deg were assumed"
        )
    if strangers:
        remarks.append(f"{len(strangers)} poses are of no photograph of this campaign ({strangers[0]})")
    rows = []
    for row in accepted:
        photo_id = row["photo_id"]
        said: dict[str, Any] = {
            "photo_id": photo_id,
            "image_width_px": row["image_width_px"],
            "image_height_px": row["image_height_px"],
            "tie_points": 0,
        }
        if photo_id in posed:
            stated = covariance[photo_id]
            columns = build_pose_columns(
                posed[photo_id], _build_assumed_covariance() if stated is None else stated, place.origin
            )
            rows.append(said | {"pose_source": PoseSource.IMPORTED} | columns)
        else:
            reason = reasons.get(photo_id, f"{found.source} has no pose of it")
            rows.append(said | {"pose_source": PoseSource.UNLOCALISED, "reason": reason})
    poses = table_from_rows("poses", rows)
    evidence = validate_imported_poses(posed, accepted, surveyed, place)
    return ImportedPlacement(
        poses=poses,
        georeference=_build_passport(found, poses, place, remarks, evidence, placement_sigma_max_m),
        georeference_points=build_points_table(evidence.points, place.origin),
        localised=len(posed),
    )


def _build_assumed_covariance() -> Float64Array:
    return np.diag([SIGMA_POSITION_M**2] * 3 + [np.radians(SIGMA_ATTITUDE_DEG) ** 2] * 3)


def _match_to_photographs(
    found: ImportedPoses, accepted: Sequence[Mapping[str, Any]]
) -> tuple[dict[str, ImportedPose], dict[str, str], list[str]]:
    """Poses by photo_id, reasons of photographs whose line cannot be used, and names that mean no photograph."""
    names = PhotoNames([row["photo_id"] for row in accepted])
    own: dict[str, ImportedPose] = {}
    reasons: dict[str, str] = {}
    strangers: list[str] = []
    matches = [(pose, names.match(pose.image)) for pose in found.poses]
    times = Counter(match.photo_id for _, match in matches if match.photo_id is not None)
    for pose, match in matches:
        if match.photo_id is None:
            strangers.append(match.reason)
        elif times[match.photo_id] > 1:
            reasons[match.photo_id] = f"{found.source} has {times[match.photo_id]} poses of it; keep one"
        else:
            own[match.photo_id] = pose
    for line in found.unusable:
        photo_id = names.match(line.image).photo_id
        if photo_id is None:
            strangers.append(line.reason)
        elif own.pop(photo_id, None) is not None:
            reasons[photo_id] = f"{found.source} has two lines of it; keep one"
        else:
            reasons[photo_id] = line.reason
    return own, reasons, strangers


def _build_cameras(
    own: Mapping[str, ImportedPose],
    row_of: Mapping[str, Mapping[str, Any]],
    reasons: dict[str, str],
    found: ImportedPoses,
    place: SiteFrame,
) -> dict[str, PosedCamera]:
    """The cameras in site; a lens that does not fit its photograph, or a place off the map, becomes a reason."""
    posed = {}
    for (photo_id, pose), at in zip(own.items(), _transform_to_site(list(own.values()), found, place), strict=True):
        row = row_of[photo_id]
        if isinstance(at, GeoreferenceError):
            reasons[photo_id] = f"{found.source}: {at}"
            continue
        centre, rotation = at
        try:
            camera = pose.lens.scale_to(row["image_width_px"], row["image_height_px"])
        except InputDataError as error:
            reasons[photo_id] = f"{found.source}: {error}"
            continue
        posed[photo_id] = PosedCamera(camera=camera, site_from_cam=Similarity(rotation=rotation, translation=centre))
    return posed


def _transform_to_site(
    poses: Sequence[ImportedPose], found: ImportedPoses, place: SiteFrame
) -> list[tuple[Float64Array, Float64Array] | GeoreferenceError]:
    """Centre and rotation of each pose in site, or why it has none. Raises GeoreferenceError where none has."""
    if not poses:
        return []
    centres, rotations = np.array([pose.xyz_world for pose in poses]), np.array([pose.world_from_cam for pose in poses])
    try:
        return list(zip(*found.world.transform_to_site(centres, rotations, place), strict=True))
    except GeoreferenceError as whole:
        placed: list[tuple[Float64Array, Float64Array] | GeoreferenceError] = []
        for row in range(len(poses)):
            try:
                centre, rotation = found.world.transform_to_site(
                    centres[row : row + 1], rotations[row : row + 1], place
                )
                placed.append((centre[0], rotation[0]))
            except GeoreferenceError as error:
                placed.append(error)
        if all(isinstance(one, GeoreferenceError) for one in placed):
            raise whole
        return placed


def _build_passport(
    found: ImportedPoses,
    poses: pa.Table,
    place: SiteFrame,
    remarks: Sequence[str],
    evidence: ImportValidation,
    limit_m: float,
) -> pa.Table:
    """Table ``georeference``: what an import can say of itself; residuals it has none."""
    known = [row for row in poses.to_pylist() if row["pose_source"] == PoseSource.IMPORTED]
    sigma_m = np.array([np.median([row[f"sigma_{axis}_m"] for row in known]) for axis in ("east", "north", "up")])
    require_accuracy(
        control=ControlKind.IMPORTED,
        sigma_m=sigma_m,
        limit_m=limit_m,
        held_out_m=evidence.held_out_m,
        remedy="import better poses, or leave them out and have the photographs placed by control points or the model",
    )
    return table_from_rows(
        "georeference",
        [
            {
                "control": ControlKind.IMPORTED,
                "method": f"poses imported from {found.source}",
                "map_crs": place.map_crs,
                "vertical_datum": place.vertical_datum,
                "georeference_level": place.georeference_level,
                "points_used": len(known),
                "points_total": len(found.poses) + len(found.unusable),
                "scale": 1.0,
                **evidence.columns,
                **{f"sigma_{axis}_m": float(s) for axis, s in zip(("east", "north", "up"), sigma_m, strict=True)},
                "remarks": "; ".join(
                    [*found.remarks, *found.world.describe_assumptions(place), *remarks, *evidence.remarks]
                ),
            }
        ],
    )
