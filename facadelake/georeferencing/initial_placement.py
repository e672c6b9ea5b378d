"""The initial placement of a block by each kind of control, and the observations of that control for the adjustment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Float64Nx3, Float64x3, Float64x3x3
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.georeferencing.adjustment.adjusted_block import AdjustedBlock
from facadelake.georeferencing.adjustment.control_observations import MarkedPoints, SharedTiePoints, SurfaceConstraint
from facadelake.georeferencing.available_control import Control
from facadelake.georeferencing.campaign.matching import ReferenceMatch, match_reference
from facadelake.georeferencing.control_ranking import order_references
from facadelake.georeferencing.datum_shift import DatumShift, find_datum_shift
from facadelake.georeferencing.gcp.control_points import SurveyedPoints, add_vertical_datum, transform_to_site
from facadelake.georeferencing.gcp.placement import intersect_marks, place_by_control_points
from facadelake.georeferencing.gps.alignment import align_to_gps
from facadelake.georeferencing.gps.priors import GpsPriors
from facadelake.georeferencing.model.edge_search import EdgeShift
from facadelake.georeferencing.model.placement import place_by_model
from facadelake.georeferencing.site_frame import SiteFrame
from facadelake.sfm import Reconstruction
from schemas.vocabulary import ControlKind

# A total station's point on a facade, and a mark set by hand in a photograph.
CONTROL_SIGMA_M = 0.01
MARK_SIGMA_PX = 1.0
# A check point this near to a control point is the same point: files round to centimetres.
_SAME_POINT_M = 0.01
# Displacement of a surface point found again after months, under other light, besides its own covariance.
_SHARED_POINT_SIGMA_M = 0.003
_CELL_M = 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class InitialPlacement:
    """An initial placement ``site_from_sfm`` and the control observations to adjust the block to.

    ``method``: the control in words, for the passport. ``gps_used`` (n,): the priors that agree with the placement.
    ``points_used`` of ``points_total`` control points, tie points or photographs. ``compute_residual_m``: distances
    (k,) at the control after the adjustment. ``marked``, ``shared`` and ``model``: observations of the control.
    ``edge_shift``: of a placement by the model's edges. ``datum_sigma_m`` (3,): sigma to which the placement itself
    constrains the block's datum, instead of GPS (None: GPS does). ``frame_covariance_m2`` (3, 3): error that all
    control shares (the frame of an earlier campaign, the shift between two datums). ``datum_shift``: from the datum of
    the control to that of the model, where the control has coordinates of its own.
    """

    kind: ControlKind
    method: str
    site_from_sfm: Similarity
    gps_used: BoolArray
    points_used: int
    points_total: int
    compute_residual_m: Callable[[AdjustedBlock], Float64N]
    remarks: tuple[str, ...] = ()
    marked: MarkedPoints | None = None
    shared: SharedTiePoints | None = None
    model: SurfaceConstraint | None = None
    edge_shift: EdgeShift | None = None
    datum_sigma_m: Float64x3 | None = None
    reference_campaign: str | None = None
    datum_shift: DatumShift | None = None
    frame_covariance_m2: Float64x3x3 = field(default_factory=lambda: np.zeros((3, 3)))

    def add_remarks(self, remarks: tuple[str, ...]) -> InitialPlacement:
        """The same placement with ``remarks`` before its own."""
        return replace(self, remarks=(*remarks, *self.remarks))


def find_initial_placement(
    kind: ControlKind, reconstruction: Reconstruction, priors: GpsPriors, *, site_frame: SiteFrame, control: Control
) -> InitialPlacement:
    """The initial placement by one kind of control.

    Args:
        kind: the kind of control.
        reconstruction: the free block.
        priors: GPS priors of its photographs, in site.
        site_frame: the building's site frame.
        control: the control available. Its check points, and its control points where ``kind`` is an earlier campaign,
            are added without weight.

    Returns:
        the placement and the observations to adjust to.

    Raises:
        GeoreferenceError: the control is missing or cannot place the block.
    """
    match kind:
        case ControlKind.GCP:
            placement = _build_from_control_points(reconstruction, priors, site_frame, control)
        case ControlKind.CAMPAIGN:
            placement = _build_from_campaign(reconstruction, priors, site_frame, control)
        case ControlKind.MODEL:
            placement = _build_from_model(reconstruction, priors, control)
        case ControlKind.GPS:
            placement = _build_from_gps(reconstruction, priors)
    for surveyed in (control.check_points, control.points if kind is ControlKind.CAMPAIGN else None):
        placement = _add_check_points(placement, reconstruction, site_frame, surveyed)
    return placement


def _find_consistent_gps(site_from_sfm: Similarity, reconstruction: Reconstruction, priors: GpsPriors) -> BoolArray:
    """Priors (n,) within 3.5 sigmas of the placement, after their common offset is removed."""
    if not len(priors.photo):
        return np.zeros(0, dtype=bool)
    residual = priors.xyz_site_m - site_from_sfm.apply(reconstruction.centres_sfm[priors.photo])
    normalised = np.abs(residual - np.median(residual, axis=0)) / priors.sigma_m
    consistent: BoolArray = normalised.max(axis=1) < 3.5
    return consistent


def _build_from_control_points(
    reconstruction: Reconstruction, priors: GpsPriors, site_frame: SiteFrame, control: Control
) -> InitialPlacement:
    placed = place_by_control_points(reconstruction, control.points, site_frame)
    assert control.points is not None
    shift = find_datum_shift(add_vertical_datum(control.points.crs, site_frame.vertical_datum), site_frame)
    rows = np.flatnonzero(placed.agree)
    marks = [placed.marks[row] for row in rows]
    marked = MarkedPoints(
        names=tuple(placed.names[row] for row in rows),
        xyz_site_m=placed.xyz_site_m[rows],
        sigma_m=np.full((len(rows), 3), CONTROL_SIGMA_M),
        photo=np.concatenate([mark.photo for mark in marks if mark is not None]),
        point=np.concatenate([np.full(len(mark.photo), k) for k, mark in enumerate(marks) if mark is not None]),
        xy_img=np.vstack([mark.xy_img for mark in marks if mark is not None]),
        sigma_px=MARK_SIGMA_PX,
    )
    return InitialPlacement(
        kind=ControlKind.GCP,
        method="control points",
        site_from_sfm=placed.site_from_sfm,
        gps_used=_find_consistent_gps(placed.site_from_sfm, reconstruction, priors),
        points_used=len(rows),
        points_total=len(placed.names),
        compute_residual_m=lambda adjusted: np.linalg.norm(
            adjusted.marked_xyz_site_m[: len(rows)] - placed.xyz_site_m[rows], axis=1
        ),
        remarks=placed.remarks,
        marked=marked,
        datum_shift=shift,
        frame_covariance_m2=shift.covariance_m2,
    )


def _select_shared_points(match: ReferenceMatch) -> SharedTiePoints:
    """The shared point with the smallest variance in each half-metre cell.

    Neighbours share their errors: thousands of them as independent observations would imply a tenth of a millimetre.
    """
    cell = np.floor(match.xyz_site_m / _CELL_M).astype(np.int64)
    order = np.argsort(np.trace(match.covariance_m2, axis1=1, axis2=2), kind="stable")
    _, first = np.unique(cell[order], axis=0, return_index=True)
    rows = np.sort(order[first])
    return SharedTiePoints(
        point=match.point[rows],
        xyz_site_m=match.xyz_site_m[rows],
        covariance_m2=match.covariance_m2[rows] + np.eye(3) * _SHARED_POINT_SIGMA_M**2,
    )


def _build_from_campaign(
    reconstruction: Reconstruction, priors: GpsPriors, site_frame: SiteFrame, control: Control
) -> InitialPlacement:
    if not control.references:
        raise GeoreferenceError(
            "georeferencing by an earlier campaign was requested, but the lake holds no earlier campaign of this "
            "building with a reference; inspect the earlier campaign first"
        )
    problems: list[str] = []
    for reference, descriptors in order_references(control.references):
        try:
            match = match_reference(reconstruction, descriptors, reference, origin=site_frame.origin)
        except GeoreferenceError as error:
            problems.append(f"{reference.campaign_id}: {error}")
            continue
        shared = _select_shared_points(match)

        def compute_residual_m(adjusted: AdjustedBlock, shared: SharedTiePoints = shared) -> Float64N:
            row = {int(point): k for k, point in enumerate(adjusted.tie_points.reconstruction_point)}
            used = [k for k, point in enumerate(shared.point) if int(point) in row]
            xyz = adjusted.xyz_site_m[[row[int(shared.point[k])] for k in used]]
            distance: Float64Array = np.linalg.norm(xyz - shared.xyz_site_m[used], axis=1)
            return distance

        return InitialPlacement(
            kind=ControlKind.CAMPAIGN,
            method=f"tie points shared with campaign {reference.campaign_id}",
            site_from_sfm=match.site_from_sfm,
            gps_used=_find_consistent_gps(match.site_from_sfm, reconstruction, priors),
            points_used=len(match.point),
            points_total=match.points_compared,
            compute_residual_m=compute_residual_m,
            shared=shared,
            reference_campaign=reference.campaign_id,
            frame_covariance_m2=reference.frame_covariance_m2,
            remarks=tuple(problems),
        )
    raise GeoreferenceError("the block matches no earlier campaign: " + "; ".join(problems))


def _build_from_model(reconstruction: Reconstruction, priors: GpsPriors, control: Control) -> InitialPlacement:
    model = control.model
    if model is None:
        raise GeoreferenceError("georeferencing by the model was requested, but the building has no model surface")
    placed = place_by_model(reconstruction, priors, model)
    return InitialPlacement(
        kind=ControlKind.MODEL,
        method="the building model's faces" + (" and edges" if model.edges is not None else ""),
        site_from_sfm=placed.site_from_sfm,
        gps_used=_find_consistent_gps(placed.site_from_sfm, reconstruction, priors),
        points_used=len(placed.alignment.residual_m),
        points_total=placed.alignment.points_total,
        compute_residual_m=_compute_wall_residuals,
        remarks=placed.remarks,
        model=SurfaceConstraint(surface=model.surface, sigma_m=model.sigma_m),
        edge_shift=placed.shift,
        datum_sigma_m=placed.datum_sigma_m,
    )


def _compute_wall_residuals(adjusted: AdjustedBlock) -> Float64N:
    """Distances (k,) of the tie points on the model from their faces, in metres."""
    terms = adjusted.problem.point_to_plane
    xyz = adjusted.solution.state.xyz_site_m[terms.point]
    distance: Float64Array = np.abs(np.einsum("ij,ij->i", terms.normal_site, xyz) - terms.distance_m)
    return distance


def _build_from_gps(reconstruction: Reconstruction, priors: GpsPriors) -> InitialPlacement:
    aligned = align_to_gps(reconstruction, priors)

    def compute_residual_m(adjusted: AdjustedBlock) -> Float64N:
        centres = np.array([camera.centre_site_m for camera in adjusted.cameras])[priors.photo]
        distance: Float64Array = np.linalg.norm(priors.xyz_site_m - centres, axis=1)[aligned.used]
        return distance

    return InitialPlacement(
        kind=ControlKind.GPS,
        method="the photographs' GPS",
        site_from_sfm=aligned.site_from_sfm,
        gps_used=aligned.used,
        points_used=int(aligned.used.sum()),
        points_total=len(priors.photo),
        compute_residual_m=compute_residual_m,
        datum_shift=priors.observed_shift,
        frame_covariance_m2=priors.observed_covariance_m2,
        remarks=(*aligned.remarks, "the error common to all GPS positions (metres) is not observable"),
    )


def _is_among(point_m: Float64x3, points_m: Float64Nx3) -> bool:
    return bool((np.linalg.norm(points_m - point_m, axis=1) < _SAME_POINT_M).any())


def _add_check_points(
    placement: InitialPlacement,
    reconstruction: Reconstruction,
    site_frame: SiteFrame,
    check_points: SurveyedPoints | None,
) -> InitialPlacement:
    """The placement with check points among its marked points.

    Args:
        placement: the placement.
        reconstruction: the free block.
        site_frame: the building's site frame.
        check_points: the check points with their marks, or None.

    Returns:
        the placement; check points have infinite sigmas, so their marks determine them and their survey has no weight.
    """
    if check_points is None:
        return placement
    xyz = transform_to_site(check_points, site_frame)
    outside: list[bool] = np.isnan(xyz.sum(axis=1)).tolist()
    if any(outside):
        names = [point.name for point, out in zip(check_points.points, outside, strict=True) if out]
        placement = placement.add_remarks(
            (f"check points left out, outside the area of use of their CRS: {', '.join(names)}",)
        )
    known = np.zeros((0, 3)) if placement.marked is None else placement.marked.xyz_site_m
    used = [not is_out and _is_among(point, known) for point, is_out in zip(xyz, outside, strict=True)]
    if any(used):
        names = [point.name for point, is_used in zip(check_points.points, used, strict=True) if is_used]
        placement = placement.add_remarks(
            (
                f"check points left out, which are control points (less than {_SAME_POINT_M * 100:g} cm apart), so "
                f"that they tell nothing new: {', '.join(names)}",
            )
        )
        outside = [is_out or is_used for is_out, is_used in zip(outside, used, strict=True)]
    marks = [
        None if out else mark for mark, out in zip(intersect_marks(reconstruction, check_points), outside, strict=True)
    ]
    usable = [row for row, mark in enumerate(marks) if mark is not None]
    unusable = [
        point.name
        for point, mark, out in zip(check_points.points, marks, outside, strict=True)
        if mark is None and not out
    ]
    if unusable:
        placement = placement.add_remarks(
            (f"check points not usable (fewer than 2 agreeing marks): {', '.join(unusable)}",)
        )
    if not usable:
        return placement
    control = placement.marked or MarkedPoints(
        names=(),
        xyz_site_m=np.zeros((0, 3)),
        sigma_m=np.zeros((0, 3)),
        photo=np.zeros(0, dtype=np.int64),
        point=np.zeros(0, dtype=np.int64),
        xy_img=np.zeros((0, 2)),
        sigma_px=MARK_SIGMA_PX,
    )
    usable_marks = [mark for mark in marks if mark is not None]
    marked = MarkedPoints(
        names=(*control.names, *(check_points.points[row].name for row in usable)),
        xyz_site_m=np.vstack([control.xyz_site_m, xyz[usable]]),
        initial_xyz_site_m=np.vstack(
            [
                control.xyz_site_m,
                placement.site_from_sfm.apply(np.array([mark.xyz_sfm for mark in usable_marks])),
            ]
        ),
        sigma_m=np.vstack([control.sigma_m, np.full((len(usable), 3), np.inf)]),
        photo=np.concatenate([control.photo, *(mark.photo for mark in usable_marks)]),
        point=np.concatenate(
            [control.point, *(np.full(len(mark.photo), len(control.names) + k) for k, mark in enumerate(usable_marks))]
        ),
        xy_img=np.vstack([control.xy_img, *(mark.xy_img for mark in usable_marks)]),
        sigma_px=MARK_SIGMA_PX,
    )
    return replace(placement, marked=marked)
