"""Where the adjustment of a block begins, and what it will be held to, for each kind of control."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.georeferencing.adjustment.adjusted_block import AdjustedBlock
from facadelake.georeferencing.adjustment.control_observations import MarkedPoints, SharedTiePoints, SurfaceConstraint
from facadelake.georeferencing.campaign.matching import ReferenceMatch, match_reference
from facadelake.georeferencing.control import Control
from facadelake.georeferencing.gcp.control_points import SurveyedPoints, transform_to_site
from facadelake.georeferencing.gcp.placement import intersect_marks, place_by_control_points
from facadelake.georeferencing.gps.alignment import align_to_gps
from facadelake.georeferencing.gps.priors import GpsPriors
from facadelake.georeferencing.model.control import place_by_model
from facadelake.georeferencing.model.edge_search import EdgeShift
from facadelake.georeferencing.site_frame import SiteFrame
from facadelake.sfm import Reconstruction
from schemas.vocabulary import ControlKind

# A tachymeter's point on a facade, and a person's mark on a photograph.
CONTROL_SIGMA_M = 0.01
MARK_SIGMA_PX = 1.0
# A point found again after months, by another light: what it moves by, beside its own covariance.
_SHARED_POINT_SIGMA_M = 0.003
_CELL_M = 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class InitialPlacement:
    """A start, ``site_from_sfm``, and the evidence to adjust it to.

    ``gps_used`` (n,): which priors agree. ``frame_covariance_m2`` (3, 3): what the control itself has in common as an
    error (an earlier campaign's frame). ``datum_sigma_m`` (3,): within what the start itself holds the block's
    datum, in GPS's stead (None: it does not). ``compute_residual_m`` gives what is left (k,) at the control after adjustment.
    """

    kind: ControlKind
    method: str
    site_from_sfm: Similarity
    gps_used: BoolArray
    points_used: int
    points_total: int
    compute_residual_m: Callable[[AdjustedBlock], Float64Array]
    remarks: tuple[str, ...] = ()
    marked: MarkedPoints | None = None
    shared: SharedTiePoints | None = None
    model: SurfaceConstraint | None = None
    edge_shift: EdgeShift | None = None
    datum_sigma_m: Float64Array | None = None
    reference_campaign: str | None = None
    frame_covariance_m2: Float64Array = field(default_factory=lambda: np.zeros((3, 3)))

    def add_remarks(self, remarks: tuple[str, ...]) -> InitialPlacement:
        """The same start with ``remarks`` before its own."""
        return replace(self, remarks=(*remarks, *self.remarks))


def find_initial_placement(
    kind: ControlKind, reconstruction: Reconstruction, priors: GpsPriors, *, place: SiteFrame, control: Control
) -> InitialPlacement:
    """The start by ``kind``. Raises GeoreferenceError where it cannot place the block."""
    match kind:
        case ControlKind.GCP:
            start = _place_by_control_points(reconstruction, priors, place, control)
        case ControlKind.CAMPAIGN:
            start = _place_by_campaign(reconstruction, priors, place, control)
        case ControlKind.MODEL:
            start = _place_by_model(reconstruction, priors, control)
        case ControlKind.GPS:
            start = _place_by_gps(reconstruction, priors)
    for held_out in (control.check_points, control.points if kind is ControlKind.CAMPAIGN else None):
        start = _add_check_points(start, reconstruction, place, held_out)
    return start


def _find_consistent_gps(site_from_sfm: Similarity, reconstruction: Reconstruction, priors: GpsPriors) -> BoolArray:
    """Priors (n,) within 3.5 sigmas of the placement, their common offset aside."""
    if not len(priors.photo):
        return np.zeros(0, dtype=bool)
    left = priors.xyz_site_m - site_from_sfm.apply(reconstruction.centres_sfm[priors.photo])
    away = np.abs(left - np.median(left, axis=0)) / priors.sigma_m
    good: BoolArray = away.max(axis=1) < 3.5
    return good


def _place_by_control_points(
    reconstruction: Reconstruction, priors: GpsPriors, place: SiteFrame, control: Control
) -> InitialPlacement:
    placed = place_by_control_points(reconstruction, control.points, place.origin, place.vertical_datum)
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
    )


def _select_shared_points(found: ReferenceMatch) -> SharedTiePoints:
    """One shared point of each half-metre cell, the best known: neighbours share their errors, so thousands of them
    would claim a tenth of a millimetre."""
    cell = np.floor(found.xyz_site_m / _CELL_M).astype(np.int64)
    order = np.argsort(np.trace(found.covariance_m2, axis1=1, axis2=2), kind="stable")
    _, first = np.unique(cell[order], axis=0, return_index=True)
    rows = np.sort(order[first])
    return SharedTiePoints(
        point=found.point[rows],
        xyz_site_m=found.xyz_site_m[rows],
        covariance_m2=found.covariance_m2[rows] + np.eye(3) * _SHARED_POINT_SIGMA_M**2,
    )


def _place_by_campaign(
    reconstruction: Reconstruction, priors: GpsPriors, place: SiteFrame, control: Control
) -> InitialPlacement:
    if not control.references:
        raise GeoreferenceError(
            "georeference by an earlier campaign was asked for, but the lake holds none of this building that was "
            "placed before; inspect the earlier campaign first"
        )
    problems: list[str] = []
    for reference, descriptors in control.references:
        try:
            found = match_reference(reconstruction, descriptors, reference, origin=place.origin)
        except GeoreferenceError as error:
            problems.append(f"{reference.campaign_id}: {error}")
            continue
        known = _select_shared_points(found)

        def residual_m(adjusted: AdjustedBlock, known: SharedTiePoints = known) -> Float64Array:
            row = {int(point): k for k, point in enumerate(adjusted.tie_points.reconstruction_point)}
            held = [k for k, point in enumerate(known.point) if int(point) in row]
            at = adjusted.xyz_site_m[[row[int(known.point[k])] for k in held]]
            left: Float64Array = np.linalg.norm(at - known.xyz_site_m[held], axis=1)
            return left

        return InitialPlacement(
            kind=ControlKind.CAMPAIGN,
            method=f"points shared with campaign {reference.campaign_id}",
            site_from_sfm=found.site_from_sfm,
            gps_used=_find_consistent_gps(found.site_from_sfm, reconstruction, priors),
            points_used=len(found.point),
            points_total=found.points_compared,
            compute_residual_m=residual_m,
            shared=known,
            reference_campaign=reference.campaign_id,
            frame_covariance_m2=reference.frame_covariance_m2,
            remarks=tuple(problems),
        )
    raise GeoreferenceError("no earlier campaign could be found again: " + "; ".join(problems))


def _place_by_model(reconstruction: Reconstruction, priors: GpsPriors, control: Control) -> InitialPlacement:
    model = control.model
    if model is None:
        raise GeoreferenceError("georeference by the model was asked for, but the model's surface was not given")
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


def _compute_wall_residuals(adjusted: AdjustedBlock) -> Float64Array:
    walls = adjusted.problem.point_to_plane
    at = adjusted.solution.state.xyz_site_m[walls.point]
    away: Float64Array = np.abs(np.einsum("ij,ij->i", walls.normal_site, at) - walls.distance_m)
    return away


def _place_by_gps(reconstruction: Reconstruction, priors: GpsPriors) -> InitialPlacement:
    aligned = align_to_gps(reconstruction, priors)

    def residual_m(adjusted: AdjustedBlock) -> Float64Array:
        centres = np.array([camera.centre_site_m for camera in adjusted.cameras])[priors.photo]
        left: Float64Array = np.linalg.norm(priors.xyz_site_m - centres, axis=1)[aligned.used]
        return left

    return InitialPlacement(
        kind=ControlKind.GPS,
        method="the photographs' GPS",
        site_from_sfm=aligned.site_from_sfm,
        gps_used=aligned.used,
        points_used=int(aligned.used.sum()),
        points_total=len(priors.photo),
        compute_residual_m=residual_m,
        remarks=(*aligned.remarks, "the error common to all GPS positions (metres) cannot be seen from them"),
    )


def _add_check_points(
    start: InitialPlacement, reconstruction: Reconstruction, place: SiteFrame, check_points: SurveyedPoints | None
) -> InitialPlacement:
    """Check points are adjusted as places, but hold nothing: their sigma is infinite."""
    if check_points is None:
        return start
    xyz = transform_to_site(check_points, origin=place.origin, vertical_datum=place.vertical_datum)
    marks = intersect_marks(reconstruction, check_points)
    seen = [row for row, mark in enumerate(marks) if mark is not None]
    lost = [check_points.points[row].name for row, mark in enumerate(marks) if mark is None]
    if lost:
        start = start.add_remarks((f"check points not usable (fewer than 2 agreeing marks): {', '.join(lost)}",))
    if not seen:
        return start
    own = start.marked or MarkedPoints(
        names=(),
        xyz_site_m=np.zeros((0, 3)),
        sigma_m=np.zeros((0, 3)),
        photo=np.zeros(0, dtype=np.int64),
        point=np.zeros(0, dtype=np.int64),
        xy_img=np.zeros((0, 2)),
        sigma_px=MARK_SIGMA_PX,
    )
    found = [mark for mark in marks if mark is not None]
    both = MarkedPoints(
        names=(*own.names, *(check_points.points[row].name for row in seen)),
        xyz_site_m=np.vstack([own.xyz_site_m, xyz[seen]]),
        sigma_m=np.vstack([own.sigma_m, np.full((len(seen), 3), np.inf)]),
        photo=np.concatenate([own.photo, *(mark.photo for mark in found)]),
        point=np.concatenate(
            [own.point, *(np.full(len(mark.photo), len(own.names) + k) for k, mark in enumerate(found))]
        ),
        xy_img=np.vstack([own.xy_img, *(mark.xy_img for mark in found)]),
        sigma_px=MARK_SIGMA_PX,
    )
    return replace(start, marked=both)
