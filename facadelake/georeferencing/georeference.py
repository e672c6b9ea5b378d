"""Georeferencing of a block by control points, an earlier campaign, the building model or GPS.

Each kind of control gives an initial placement; one bundle adjustment then takes all observations together.
"""

from __future__ import annotations

import logging

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64Nx3
from facadelake.core.errors import GeoreferenceError
from facadelake.core.geodesy import SiteOrigin
from facadelake.georeferencing.adjustment.adjust import adjust_block
from facadelake.georeferencing.adjustment.control_observations import ControlObservations
from facadelake.georeferencing.available_control import Control
from facadelake.georeferencing.control_ranking import rank_controls
from facadelake.georeferencing.gcp.control_points import describe_doubtful_marks
from facadelake.georeferencing.georeferenced_campaign import GeoreferencedCampaign, build_georeferenced_campaign
from facadelake.georeferencing.gps.alignment import align_to_gps, check_against_gps
from facadelake.georeferencing.gps.priors import GpsPriors, collect_gps_priors
from facadelake.georeferencing.gps.terms import build_attitude_terms, build_datum_terms, build_position_terms
from facadelake.georeferencing.initial_placement import InitialPlacement, find_initial_placement
from facadelake.georeferencing.model.lean import correct_lean, describe_lean, estimate_lean
from facadelake.georeferencing.model.plumb_lines import estimate_vertical
from facadelake.georeferencing.placement_checks import PlacementCheck
from facadelake.georeferencing.reading_checks import MeshReadingError, check_reading
from facadelake.georeferencing.site_frame import SiteFrame
from facadelake.sfm import Reconstruction
from schemas.vocabulary import ControlKind

logger = logging.getLogger(__name__)

# No photograph of a building is taken from farther; swapped axes and wrong zones are off by hundreds of kilometres.
_MAX_DISTANCE_M = 10_000.0


def georeference_reconstruction(
    reconstruction: Reconstruction, photos: pa.Table, *, site_frame: SiteFrame, control: Control
) -> GeoreferencedCampaign:
    """Georeference a block by the control requested, else by the best kind that works.

    Args:
        reconstruction: the free block.
        photos: table ``photos``, for the GPS priors.
        site_frame: the building's site frame.
        control: the control available.

    Returns:
        the campaign in site. Its remarks name the kind chosen, and the kinds that failed with their reasons.

    Raises:
        GeoreferenceError: the control cannot place the block, or not accurately enough.
    """
    priors = collect_gps_priors(reconstruction, photos, site_frame)
    control = control.match_marks(photos["photo_id"].to_pylist())
    of_files = tuple(
        remark
        for file in (control.points, control.check_points)
        if file
        for remark in (*file.remarks, *describe_doubtful_marks(file, photos))
    )
    if control.kind is not None:
        return _georeference_by(control.kind, reconstruction, priors, site_frame, control, of_files)
    kinds, remarks = rank_controls(reconstruction, control)
    remarks += of_files
    for kind in kinds[:-1]:
        try:
            chosen = (f"chosen automatically: {kind}", *remarks)
            return _georeference_by(kind, reconstruction, priors, site_frame, control, chosen)
        except MeshReadingError:
            raise
        except GeoreferenceError as error:
            logger.warning("not placed by %s: %s", kind, error)
            remarks.append(f"not placed by {kind}: {error}")
    try:
        chosen = (f"chosen automatically: {kinds[-1]}", *remarks)
        return _georeference_by(kinds[-1], reconstruction, priors, site_frame, control, chosen)
    except MeshReadingError:
        raise
    except GeoreferenceError as error:
        raise GeoreferenceError("; ".join([str(error), *remarks])) from error


def _georeference_by(
    kind: ControlKind,
    reconstruction: Reconstruction,
    priors: GpsPriors,
    site_frame: SiteFrame,
    control: Control,
    remarks: tuple[str, ...],
) -> GeoreferencedCampaign:
    """Initial placement, checks against GPS and the building, adjustment, and correction of a lean."""
    readings = control.model.readings if control.model is not None else ()
    reading_checks: tuple[PlacementCheck, ...] = ()
    if kind is ControlKind.MODEL and readings:  # a mesh that was read wrongly cannot place the block
        reading_checks = check_reading(reconstruction, align_to_gps(reconstruction, priors).site_from_sfm, readings)
    placement = find_initial_placement(
        kind, reconstruction, priors, site_frame=site_frame, control=control
    ).add_remarks(remarks)
    if kind is not ControlKind.MODEL:
        reading_checks = check_reading(reconstruction, placement.site_from_sfm, readings)
    _refuse_far_away(placement.site_from_sfm.apply(reconstruction.centres_sfm), kind, site_frame.origin)
    if kind is not ControlKind.GPS:
        _check_against_gps(placement, reconstruction, priors)
    initial_xyz_m = placement.site_from_sfm.apply(reconstruction.centres_sfm[priors.photo])
    # RTK positions in another realisation of WGS 84 must not compete with control in the model's datum.
    by_gps = kind is ControlKind.GPS
    observations = ControlObservations(
        positions=build_position_terms(
            priors,
            placement.gps_used,
            initial_xyz_m,
            datum_sigma_m=np.zeros(3) if by_gps else priors.datum_sigma_m,
            convention_m=0.0 if by_gps else priors.convention_m,
        )
        if placement.datum_sigma_m is None
        else build_datum_terms(priors, placement.gps_used, initial_xyz_m, placement.datum_sigma_m),
        attitudes=build_attitude_terms(priors),
        marked=placement.marked,
        shared=placement.shared,
        model=placement.model,
    )
    adjusted = adjust_block(reconstruction, placement.site_from_sfm, observations)
    lean = None
    if placement.model is not None:
        edges = control.model.edges if control.model is not None else None
        vertical = estimate_vertical(adjusted.cameras, edges.photographs) if edges is not None else None
        lean = estimate_lean(adjusted, placement.model.sigma_m, vertical)
        if vertical is not None:
            placement = placement.add_remarks((describe_lean(vertical, lean),))
        adjusted = correct_lean(adjusted, lean)
    return build_georeferenced_campaign(
        reconstruction,
        priors,
        adjusted,
        placement=placement,
        lean=lean,
        site_frame=site_frame,
        control=control,
        reading_checks=reading_checks,
    )


def _check_against_gps(placement: InitialPlacement, reconstruction: Reconstruction, priors: GpsPriors) -> None:
    # RTK positions are more accurate than the shape of the free block, so they are no test of the placement.
    if priors.sigma_m.size and float(np.median(priors.sigma_m)) > 1.0:
        centres = reconstruction.centres_sfm[priors.photo]
        check_against_gps(placement.site_from_sfm, centres, priors, by=placement.method)


def _refuse_far_away(centres_site_m: Float64Nx3, control: ControlKind, origin: SiteOrigin) -> None:
    """Raise GeoreferenceError where the cameras (n, 3) are placed far from the building (site's origin)."""
    median_m = np.median(centres_site_m, axis=0)
    distance_m = float(np.linalg.norm(median_m))
    if distance_m > _MAX_DISTANCE_M:
        lon, lat, _ = origin.geo_from_site(median_m[None])[0]
        raise GeoreferenceError(
            f"placed by {control}, the photographs lie {distance_m / 1000:.0f} km from the building model (limit "
            f"{_MAX_DISTANCE_M / 1000:.0f} km), near lon {lon:.3f}, lat {lat:.3f}; are latitude and longitude "
            "(or east and north) swapped, is a CRS or UTM zone wrong, or do photographs and model belong to different "
            "buildings?"
        )
