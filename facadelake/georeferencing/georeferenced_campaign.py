"""The georeferenced campaign: posed cameras with their covariance, and its row of table ``georeference``."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64Array, Float64N, Float64x3, Float64x3x3, UInt8Array
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity, estimate_similarity
from facadelake.core.geodesy import SITE_AXES, SiteOrigin
from facadelake.core.tables import table_from_rows
from facadelake.georeferencing.acceptance import require_accuracy, require_consistent_frame
from facadelake.georeferencing.accepted_statements import accept_statements
from facadelake.georeferencing.accuracy_remedies import suggest_accuracy_remedy
from facadelake.georeferencing.adjustment.adjusted_block import AdjustedBlock
from facadelake.georeferencing.available_control import Control
from facadelake.georeferencing.block_checks import check_block
from facadelake.georeferencing.campaign.reference import ReferencePoints
from facadelake.georeferencing.campaign.reference_selection import build_reference
from facadelake.georeferencing.datum_shift import build_operation_columns, describe_datum_shift
from facadelake.georeferencing.gps.priors import DATUM_SIGMA_M, GpsPriors
from facadelake.georeferencing.initial_placement import InitialPlacement
from facadelake.georeferencing.model.lean import BlockLean
from facadelake.georeferencing.model_comparison import compare_with_model
from facadelake.georeferencing.passport import (
    PassportPoint,
    build_control_points,
    build_gps_points,
    build_points_table,
)
from facadelake.georeferencing.placement_checks import PlacementCheck, require_agreement
from facadelake.georeferencing.site_frame import SiteFrame
from facadelake.sfm import Reconstruction
from schemas.vocabulary import ControlKind, PointKind

logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, eq=False)
class GeoreferencedCampaign:
    """The campaign in site.

    ``cameras`` and ``covariance`` (6, 6; centre in m, attitude in rad about the camera's axes) by photo_id;
    ``site_from_sfm``: the similarity nearest to the adjusted block; ``frame_covariance_m2`` (3, 3): of the campaign's
    position as a whole; ``points``, ``placement_checks`` and ``row``: its passport.
    """

    control: ControlKind
    site_from_sfm: Similarity
    cameras: Mapping[str, PosedCamera]
    covariance: Mapping[str, Float64Array]
    adjusted: AdjustedBlock
    priors: GpsPriors
    frame_covariance_m2: Float64x3x3
    points: tuple[PassportPoint, ...]
    placement_checks: tuple[PlacementCheck, ...]
    row: Mapping[str, Any]

    def build_table(self) -> pa.Table:
        """Table ``georeference``, one row."""
        return table_from_rows("georeference", [self.row])

    def build_points_table(self, origin: SiteOrigin) -> pa.Table:
        """Table ``georeference_points``."""
        return build_points_table(self.points, origin)

    def build_reference(
        self,
        reconstruction: Reconstruction,
        descriptors: UInt8Array,
        building_id: str,
        campaign_id: str,
        origin: SiteOrigin,
    ) -> ReferencePoints | None:
        """The tie points by which later campaigns are placed in this one's frame.

        Args:
            reconstruction: the block.
            descriptors: SIFT descriptors (m, 128) of its tie points.
            building_id: the building.
            campaign_id: this campaign.
            origin: origin of the site frame.

        Returns:
            the reference; None where no tie point is accurate enough.
        """
        count = len(reconstruction.xyz_sfm)
        xyz, covariance = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
        rows = self.adjusted.tie_points.reconstruction_point
        xyz[rows] = self.adjusted.xyz_site_m
        covariance[rows] = self.adjusted.point_covariance_m2
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
            logger.warning("no reference is stored: %s", error)
            return None


def build_georeferenced_campaign(
    reconstruction: Reconstruction,
    priors: GpsPriors,
    adjusted: AdjustedBlock,
    *,
    placement: InitialPlacement,
    lean: BlockLean | None,
    site_frame: SiteFrame,
    control: Control,
    reading_checks: Sequence[PlacementCheck] = (),
) -> GeoreferencedCampaign:
    """The campaign with covariances, passport points and passport row.

    Args:
        reconstruction: the free block.
        priors: GPS priors of its photographs, in site.
        adjusted: the adjusted block, its lean corrected.
        placement: the initial placement that it was adjusted from, with its control.
        lean: the lean of a block placed by the model; its covariance is added.
        site_frame: the building's site frame.
        control: the control available, for its model and its limit.
        reading_checks: the placement check of how a mesh was read.

    Returns:
        the campaign.

    Raises:
        GeoreferenceError: the placement is not accurate enough, or independent evidence contradicts it.
    """
    frame = adjusted.datum_covariance_m2 + placement.frame_covariance_m2
    lean_covariance = np.zeros((1, 6, 6)) if lean is None else lean.compute_covariance(adjusted)
    frame += lean_covariance[:, :3, :3].mean(axis=0)  # mean effect of a lean on a camera of the block
    sigma_m = np.sqrt(np.diag(frame))
    points = [
        *build_control_points(placement, adjusted),
        *build_gps_points(reconstruction, priors, adjusted, placement),
    ]
    held_out_m = np.array(
        [np.linalg.norm(p.residual_site_m) for p in points if p.kind in (PointKind.HELD_OUT, PointKind.CHECK)]
    )
    if placement.kind is ControlKind.CAMPAIGN and len(held_out_m):
        require_consistent_frame(held_out_m, float(sigma_m.max()), placement.method)
    datum_remark = describe_datum_shift(placement.datum_shift, sigma_m)
    gps_requested = control.kind is ControlKind.GPS
    require_accuracy(
        control=placement.kind,
        sigma_m=sigma_m,
        limit_m=np.inf if gps_requested else control.placement_sigma_max_m,
        held_out_m=held_out_m,
        remedy="; ".join(filter(None, [datum_remark, suggest_accuracy_remedy(placement, sigma_m, priors)])),
    )
    checks = accept_statements(
        (*check_block(priors, adjusted, sigma_m, points, control), *reading_checks), control.accepted
    )
    disagreements = require_agreement(
        checks,
        control=placement.kind,
        method=placement.method,
        placement_sigma_max_m=control.placement_sigma_max_m,
        height_ellipsoidal_m=_compute_camera_height(adjusted, site_frame.origin),
    )
    site_from_sfm = estimate_similarity(
        reconstruction.xyz_sfm[adjusted.tie_points.reconstruction_point], adjusted.xyz_site_m
    )
    ids = [photo.photo_id for photo in reconstruction.photos]
    covariance = adjusted.covariance.copy()
    covariance[:, :3, :3] += placement.frame_covariance_m2
    covariance += lean_covariance
    row = {
        "map_crs": site_frame.map_crs,
        "vertical_datum": site_frame.vertical_datum,
        "georeference_level": site_frame.georeference_level,
        "scale": site_from_sfm.scale,
        **_describe_control(placement, adjusted),
        **build_operation_columns(site_frame, placement.datum_shift),
        **_describe_accuracy(sigma_m, held_out_m, adjusted),
        **_describe_gps(priors, adjusted),
        **_describe_model(control, placement, adjusted),
        "remarks": "; ".join(
            [
                *disagreements,
                *filter(None, [datum_remark]),
                *_build_remarks(reconstruction, priors, placement, adjusted),
                *site_frame.list_model_remarks(),
            ]
        ),
    }
    return GeoreferencedCampaign(
        control=placement.kind,
        site_from_sfm=site_from_sfm,
        cameras=dict(zip(ids, adjusted.cameras, strict=True)),
        covariance=dict(zip(ids, covariance, strict=True)),
        adjusted=adjusted,
        priors=priors,
        frame_covariance_m2=frame,
        points=tuple(points),
        placement_checks=checks,
        row=row,
    )


def _compute_camera_height(adjusted: AdjustedBlock, origin: SiteOrigin) -> float:
    """Median ellipsoidal height of the cameras, metres."""
    centres = np.array([camera.centre_site_m for camera in adjusted.cameras])
    return float(np.median(origin.geo_from_site(centres)[:, 2]))


def _describe_control(placement: InitialPlacement, adjusted: AdjustedBlock) -> dict[str, Any]:
    """Columns of the control and its residuals."""
    residual_m = placement.compute_residual_m(adjusted)
    return {
        "control": placement.kind,
        "method": placement.method,
        "reference_campaign": placement.reference_campaign,
        "points_used": placement.points_used,
        "points_total": placement.points_total,
        "residual_mean_m": float(residual_m.mean()),
        "residual_rmse_m": float(np.sqrt((residual_m**2).mean())),
        "residual_max_m": float(residual_m.max()),
    }


def _describe_accuracy(sigma_m: Float64x3, held_out_m: Float64N, adjusted: AdjustedBlock) -> dict[str, Any]:
    """Columns of sigmas and of residuals at held-out and check points."""
    columns: dict[str, Any] = {
        "check_points": len(held_out_m),
        "tie_sigma_px": adjusted.solution.tie_sigma_px,
        "tie_variance_factor": adjusted.tie_variance_factor,
        **{f"sigma_{axis}_m": float(s) for axis, s in zip(SITE_AXES, sigma_m, strict=True)},
    }
    if len(held_out_m):
        columns |= {
            "check_residual_mean_m": float(held_out_m.mean()),
            "check_residual_max_m": float(held_out_m.max()),
        }
    return columns


def _describe_gps(priors: GpsPriors, adjusted: AdjustedBlock) -> dict[str, Any]:
    """Columns of the GPS offset: median of GPS minus adjusted camera centre."""
    if not len(priors.photo):
        return {}
    centres = np.array([camera.centre_site_m for camera in adjusted.cameras])[priors.photo]
    offset = np.median(priors.xyz_site_m - centres, axis=0)
    return {
        **{f"gps_offset_{axis}_m": float(v) for axis, v in zip(SITE_AXES, offset, strict=True)},
        "gps_offset_sigma_m": float(adjusted.gps_offset_sigma_m.max()),
    }


def _describe_model(control: Control, placement: InitialPlacement, adjusted: AdjustedBlock) -> dict[str, Any]:
    """Columns of the comparison with the model and of the search by its edges."""
    columns: dict[str, Any] = {}
    comparison = compare_with_model(adjusted, control.model.surface) if control.model is not None else None
    if comparison is not None:
        columns["model_residual_m"] = comparison.residual_m
        if np.isfinite(comparison.doming_m):
            columns |= {"doming_m": comparison.doming_m, "doming_sigma_m": comparison.doming_sigma_m}
    if placement.edge_shift is not None:
        columns |= {
            "edge_score": placement.edge_shift.score,
            "edge_score_runner_up": placement.edge_shift.edge_score_runner_up,
            "edge_features": placement.edge_shift.features,
        }
    return columns


def _build_remarks(
    reconstruction: Reconstruction, priors: GpsPriors, placement: InitialPlacement, adjusted: AdjustedBlock
) -> Sequence[str]:
    remarks = [*placement.remarks, *reconstruction.list_focal_deviations()]
    if adjusted.fixed_parameters:
        remarks.append(
            "lens parameters fixed at their default (aspect 1, distortion 0), not significant: "
            + ", ".join(adjusted.fixed_parameters)
        )
    if adjusted.focal_height_correlation > 0.9:
        remarks.append(
            f"focal length and height are correlated ({adjusted.focal_height_correlation:.2f}): the block is too flat "
            "to separate them; add oblique photographs or control points at different heights"
        )
    if not adjusted.solution.converged:
        remarks.append(f"the adjustment did not converge in {adjusted.solution.iterations} iterations")
    if priors.unlike_heights:
        remarks.append(
            f"the GPS heights of {len(priors.unlike_heights)} of {len(priors.photo)} photographs are not stated as "
            f"ellipsoidal and count with a sigma of {DATUM_SIGMA_M:g} m: {', '.join(priors.unlike_heights[:5])}"
        )
    if len(priors.photo) and priors.datum_unknown and placement.kind is not ControlKind.GPS:
        remarks.append("GPS heights have no stated datum; gps_offset_up_m is their offset from ellipsoidal heights")
    return remarks
