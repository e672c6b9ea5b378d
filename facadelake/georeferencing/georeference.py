"""Georeference: the block onto the globe by control points, an earlier campaign, the building's model or GPS.

Each way finds a start; then one bundle adjustment holds the block to all the evidence at once.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64Array, UInt8Array
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity, estimate_similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import table_from_rows
from facadelake.georeferencing.adjustment.adjust import adjust_block
from facadelake.georeferencing.adjustment.adjusted_block import AdjustedBlock
from facadelake.georeferencing.adjustment.control_observations import ControlObservations
from facadelake.georeferencing.campaign.reference import ReferencePoints, build_reference
from facadelake.georeferencing.control import Control
from facadelake.georeferencing.gcp.placement import MIN_CONTROL_POINTS, intersect_marks
from facadelake.georeferencing.gps.alignment import check_against_gps
from facadelake.georeferencing.gps.priors import GpsPriors, collect_gps_priors
from facadelake.georeferencing.gps.terms import build_attitude_terms, build_datum_terms, build_position_terms
from facadelake.georeferencing.initial_placement import InitialPlacement, find_initial_placement
from facadelake.georeferencing.model.lean import BlockLean, correct_lean, describe_lean, estimate_lean
from facadelake.georeferencing.model.plumb_lines import estimate_vertical
from facadelake.georeferencing.passport import (
    PassportPoint,
    build_control_points,
    build_gps_points,
    build_points_table,
    compare_with_model,
    require_accuracy,
    require_consistent_frame,
)
from facadelake.georeferencing.site_frame import SiteFrame
from facadelake.sfm import Reconstruction
from schemas.vocabulary import ControlKind, PointKind

logger = logging.getLogger(__name__)

# An earlier campaign placed no worse than this goes before control points.
_MAX_PREFERRED_FRAME_SIGMA_M = 0.03
# No photograph of a building is taken from farther; swapped axes and wrong zones are off by hundreds of kilometres.
_MAX_DISTANCE_M = 10_000.0
_REMEDY = (
    "bring control points (gcp_list.txt, 3 or more around the building), a wider block or a model with openings, or "
    "accept metres with --georeference gps"
)


@dataclass(frozen=True, kw_only=True, eq=False)
class GeoreferencedCampaign:
    """The campaign on the globe.

    ``cameras`` and ``covariance`` (6, 6; centre in m, attitude in rad about the camera's axes) by photo_id;
    ``site_from_sfm`` is the similarity nearest to the adjusted block.
    """

    control: ControlKind
    site_from_sfm: Similarity
    cameras: Mapping[str, PosedCamera]
    covariance: Mapping[str, Float64Array]
    adjusted: AdjustedBlock
    priors: GpsPriors
    frame_covariance_m2: Float64Array
    points: tuple[PassportPoint, ...]
    row: Mapping[str, Any]

    def build_table(self) -> pa.Table:
        """Table `georeference`, one row."""
        return table_from_rows("georeference", [self.row])

    def build_reference(
        self,
        reconstruction: Reconstruction,
        descriptors: UInt8Array,
        building_id: str,
        campaign_id: str,
        origin: SiteOrigin,
    ) -> ReferencePoints | None:
        """The tie points by which later campaigns find into this one's frame; None where it is known to metres only."""
        count = len(reconstruction.xyz_sfm)
        xyz, covariance = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
        xyz[self.adjusted.tie_points.reconstruction_point] = self.adjusted.xyz_site_m
        covariance[self.adjusted.tie_points.reconstruction_point] = self.adjusted.point_covariance_m2
        try:
            return build_reference(
                reconstruction,
                descriptors,
                cameras=self.adjusted.cameras,
                xyz_site_m=xyz,
                covariance_m2=covariance,
                frame_covariance_m2=self.frame_covariance_m2,
                building_id=building_id,
                campaign_id=campaign_id,
                origin=origin,
            )
        except GeoreferenceError as error:
            logger.warning("no reference is kept: %s", error)
            return None

    def build_points_table(self, origin: SiteOrigin) -> pa.Table:
        """Table `georeference_points`."""
        return build_points_table(self.points, origin)


def georeference_reconstruction(
    reconstruction: Reconstruction, photos: pa.Table, *, place: SiteFrame, control: Control
) -> GeoreferencedCampaign:
    """Place the block in site, by the control that was asked for, else by the best that works; what did not is said.

    Raises GeoreferenceError where the control cannot place the block, or not well enough.
    """
    priors = collect_gps_priors(reconstruction, photos, place.origin)
    if control.kind is not None:
        return _georeference_by(control.kind, reconstruction, priors, place, control, ())
    kinds, remarks = _rank_controls(reconstruction, control)
    for kind in kinds[:-1]:
        try:
            return _georeference_by(
                kind, reconstruction, priors, place, control, (f"chosen by itself: {kind}", *remarks)
            )
        except GeoreferenceError as error:
            logger.warning("not placed by %s: %s", kind, error)
            remarks.append(f"not placed by {kind}: {error}")
    try:
        return _georeference_by(
            kinds[-1], reconstruction, priors, place, control, (f"chosen by itself: {kinds[-1]}", *remarks)
        )
    except GeoreferenceError as error:
        raise GeoreferenceError("; ".join([str(error), *remarks])) from error


def _rank_controls(reconstruction: Reconstruction, control: Control) -> tuple[list[ControlKind], list[str]]:
    """The kinds of control to try, the best first, and what is to be said of those that are not tried.

    An earlier campaign that is itself placed to centimetres comes first, so that defects can be compared at the
    centimetre; control points then judge it. Wrong control points are the user's to mend, not to be passed over.
    """
    finest_m = min((_compute_frame_sigma(reference) for reference, _ in control.references), default=np.inf)
    campaign = [ControlKind.CAMPAIGN]
    if control.points is not None:
        usable = sum(mark is not None for mark in intersect_marks(reconstruction, control.points))
        if usable >= MIN_CONTROL_POINTS:
            return [*(campaign if finest_m <= _MAX_PREFERRED_FRAME_SIGMA_M else []), ControlKind.GCP], []
        remarks = [
            f"{usable} of {len(control.points.points)} control points of {control.points.source} can be used "
            f"({MIN_CONTROL_POINTS} are needed)"
        ]
    else:
        remarks = []
    kinds = campaign if finest_m <= control.placement_sigma_max_m else []
    if control.model is not None:
        kinds = [*kinds, ControlKind.MODEL]
    return [*kinds, ControlKind.GPS], remarks


def _georeference_by(
    kind: ControlKind,
    reconstruction: Reconstruction,
    priors: GpsPriors,
    place: SiteFrame,
    control: Control,
    remarks: tuple[str, ...],
) -> GeoreferencedCampaign:
    start = find_initial_placement(kind, reconstruction, priors, place=place, control=control).add_remarks(remarks)
    _refuse_far_away(start.site_from_sfm.apply(reconstruction.centres_sfm), kind, place.origin)
    if kind is not ControlKind.GPS:
        _check_against_gps(start, reconstruction, priors)
    xyz_start = start.site_from_sfm.apply(reconstruction.centres_sfm[priors.photo])
    evidence = ControlObservations(
        positions=build_position_terms(priors, start.gps_used, xyz_start)
        if start.datum_sigma_m is None
        else build_datum_terms(priors, start.gps_used, xyz_start, start.datum_sigma_m),
        attitudes=build_attitude_terms(priors),
        marked=start.marked,
        shared=start.shared,
        model=start.model,
    )
    adjusted = adjust_block(reconstruction, start.site_from_sfm, evidence)
    if start.model is None:
        return _build_campaign(reconstruction, priors, place, control, start, adjusted, None)
    edges = control.model.edges if control.model is not None else None
    vertical = estimate_vertical(adjusted.cameras, edges.photographs) if edges is not None else None
    lean = estimate_lean(adjusted, start.model.sigma_m, vertical)
    if vertical is not None:
        start = start.add_remarks((describe_lean(vertical, lean),))
    return _build_campaign(reconstruction, priors, place, control, start, correct_lean(adjusted, lean), lean)


def _compute_frame_sigma(reference: ReferencePoints) -> float:
    return float(np.sqrt(np.linalg.eigvalsh(reference.frame_covariance_m2)[-1]))


def _check_against_gps(start: InitialPlacement, reconstruction: Reconstruction, priors: GpsPriors) -> None:
    # RTK bends less than the block does: no judge of it.
    if priors.sigma_m.size and float(np.median(priors.sigma_m)) > 1.0:
        centres = reconstruction.centres_sfm[priors.photo]
        check_against_gps(start.site_from_sfm, centres, priors, by=start.method)


def _refuse_far_away(centres_site_m: Float64Array, control: ControlKind, origin: SiteOrigin) -> None:
    """Raise GeoreferenceError where the cameras came to lie at another place than the building (site's origin)."""
    middle_m = np.median(centres_site_m, axis=0)
    away_m = float(np.linalg.norm(middle_m))
    if away_m > _MAX_DISTANCE_M:
        lon, lat, _ = origin.geo_from_site(middle_m[None])[0]
        raise GeoreferenceError(
            f"the photographs come to lie {away_m / 1000:.0f} km from the building model (limit "
            f"{_MAX_DISTANCE_M / 1000:.0f} km) by {control}, near lon {lon:.3f}, lat {lat:.3f}; are latitude and longitude "
            "(or east and north) swapped, is a CRS or UTM zone wrong, or do photographs and model belong to different "
            "buildings?"
        )


def _build_campaign(
    reconstruction: Reconstruction,
    priors: GpsPriors,
    place: SiteFrame,
    control: Control,
    start: InitialPlacement,
    adjusted: AdjustedBlock,
    lean: BlockLean | None,
) -> GeoreferencedCampaign:
    frame = adjusted.datum_covariance_m2 + start.frame_covariance_m2
    leaning = np.zeros((1, 6, 6)) if lean is None else lean.compute_covariance(adjusted)
    frame += leaning[:, :3, :3].mean(axis=0)  # what a lean does to a camera of the block, on average
    sigma_m = np.sqrt(np.diag(frame))
    points = [*build_control_points(start, adjusted), *build_gps_points(reconstruction, priors, adjusted, start)]
    held_out_m = np.array(
        [np.linalg.norm(p.residual_site_m) for p in points if p.kind in (PointKind.HELD_OUT, PointKind.CHECK)]
    )
    if start.kind is ControlKind.CAMPAIGN and len(held_out_m):
        require_consistent_frame(held_out_m, float(sigma_m.max()), start.method)
    excused = control.kind is ControlKind.GPS
    require_accuracy(
        control=start.kind,
        sigma_m=sigma_m,
        limit_m=np.inf if excused else control.placement_sigma_max_m,
        held_out_m=held_out_m,
        remedy=_REMEDY,
    )
    site_from_sfm = estimate_similarity(
        reconstruction.xyz_sfm[adjusted.tie_points.reconstruction_point], adjusted.xyz_site_m
    )
    ids = [photo.photo_id for photo in reconstruction.photos]
    covariance = adjusted.covariance.copy()
    covariance[:, :3, :3] += start.frame_covariance_m2
    covariance += leaning
    left_m = start.compute_residual_m(adjusted)
    row: dict[str, Any] = {
        "control": start.kind,
        "method": start.method,
        "map_crs": place.map_crs,
        "vertical_datum": place.vertical_datum,
        "georeference_level": place.georeference_level,
        "reference_campaign": start.reference_campaign,
        "points_used": start.points_used,
        "points_total": start.points_total,
        "scale": site_from_sfm.scale,
        "residual_mean_m": float(left_m.mean()),
        "residual_rmse_m": float(np.sqrt((left_m**2).mean())),
        "residual_max_m": float(left_m.max()),
        "check_points": len(held_out_m),
        "tie_sigma_px": adjusted.solution.tie_sigma_px,
        "tie_variance_factor": adjusted.tie_variance_factor,
        **{f"sigma_{axis}_m": float(s) for axis, s in zip(("east", "north", "up"), sigma_m, strict=True)},
    }
    if len(held_out_m):
        row |= {
            "check_residual_mean_m": float(held_out_m.mean()),
            "check_residual_max_m": float(held_out_m.max()),
        }
    remarks = [*start.remarks, *_build_lens_remarks(adjusted)]
    if len(priors.photo):
        centres = np.array([camera.centre_site_m for camera in adjusted.cameras])[priors.photo]
        offset = np.median(priors.xyz_site_m - centres, axis=0)
        row |= {f"gps_offset_{axis}_m": float(v) for axis, v in zip(("east", "north", "up"), offset, strict=True)}
        row["gps_offset_sigma_m"] = float(adjusted.gps_offset_sigma_m.max())
        if priors.datum_unknown and start.kind is not ControlKind.GPS:
            remarks.append("GPS heights do not name their datum, and gps_offset_up_m says how far they are off")
    fit = compare_with_model(adjusted, control.model.surface) if control.model is not None else None
    if fit is not None:
        row["model_residual_m"] = fit.residual_m
        if np.isfinite(fit.doming_m):
            row |= {"doming_m": fit.doming_m, "doming_sigma_m": fit.doming_sigma_m}
    if start.edge_shift is not None:
        row |= {
            "edge_score": start.edge_shift.score,
            "edge_score_runner_up": start.edge_shift.edge_score_runner_up,
            "edge_features": start.edge_shift.features,
        }
    row["remarks"] = "; ".join(remarks)
    return GeoreferencedCampaign(
        control=start.kind,
        site_from_sfm=site_from_sfm,
        cameras=dict(zip(ids, adjusted.cameras, strict=True)),
        covariance=dict(zip(ids, covariance, strict=True)),
        adjusted=adjusted,
        priors=priors,
        frame_covariance_m2=frame,
        points=tuple(points),
        row=row,
    )


def _build_lens_remarks(adjusted: AdjustedBlock) -> list[str]:
    remarks = []
    if adjusted.fixed_parameters:
        remarks.append(
            f"lens terms that the photographs do not show, held at nought: {', '.join(adjusted.fixed_parameters)}"
        )
    if adjusted.focal_height_correlation > 0.9:
        remarks.append(
            f"focal length and height hang together (correlation {adjusted.focal_height_correlation:.2f}): the block "
            "is too flat to part them; add oblique photographs or control points at different heights"
        )
    if not adjusted.solution.converged:
        remarks.append(f"the adjustment had not settled after {adjusted.solution.iterations} steps")
    return remarks
