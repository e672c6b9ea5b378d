"""Initial placement by control points: marks are intersected in the free block, then a similarity is fitted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Nx2, Float64Nx3, Float64x3, Int64Array
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.georeferencing.gcp.control_points import (
    SurveyedPoints,
    get_height_unit_m,
    has_own_heights,
    transform_to_site,
)
from facadelake.georeferencing.similarity_fit import fit_similarity
from facadelake.georeferencing.site_frame import SiteFrame
from facadelake.georeferencing.triangulation import ImageRay, Intersection, intersect_rays
from facadelake.sfm import Reconstruction

# Survey, marking and the bending of the free block together; a control point beyond 3.5 times this is a gross error.
_CONTROL_SIGMA_M = 0.15
MIN_CONTROL_POINTS = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class IntersectedMarks:
    """The marks of a point that agree, and their intersection.

    ``photo`` (k,) rows of the block's photographs, ``xy_img`` (k, 2), ``xyz_sfm`` (3,) by the marks alone.
    """

    photo: Int64Array
    xy_img: Float64Nx2
    xyz_sfm: Float64x3


@dataclass(frozen=True, kw_only=True, eq=False)
class ControlPointPlacement:
    """An initial placement by control points.

    ``names`` (p) and ``xyz_site_m`` (p, 3) of all points; ``marks`` of the usable ones (None: fewer than two agreeing
    marks); ``agree`` (p,): the point agrees with the fitted similarity.
    """

    site_from_sfm: Similarity
    names: tuple[str, ...]
    xyz_site_m: Float64Nx3
    marks: tuple[IntersectedMarks | None, ...]
    agree: BoolArray
    remarks: tuple[str, ...]


def intersect_marks(reconstruction: Reconstruction, surveyed: SurveyedPoints) -> tuple[IntersectedMarks | None, ...]:
    """The agreeing marks of each point in photographs of the block; None where fewer than two agree.

    ``surveyed``: points whose marks name photo_ids (``match_marks``).
    """
    index = {photo.photo_id: row for row, photo in enumerate(reconstruction.photos)}
    out: list[IntersectedMarks | None] = []
    for point in surveyed.points:
        marks = [mark for mark in point.marks if mark.photo_name in index]
        rows = np.array([index[mark.photo_name] for mark in marks], dtype=np.int64)
        xy = np.array([[mark.x_px, mark.y_px] for mark in marks]).reshape(-1, 2)
        found = _intersect(reconstruction, rows, xy) if len(marks) >= 2 else None
        out.append(
            None
            if found is None
            else IntersectedMarks(photo=rows[found.used], xy_img=xy[found.used], xyz_sfm=found.xyz_world)
        )
    return tuple(out)


def _intersect(reconstruction: Reconstruction, photo: Int64Array, xy_img: Float64Nx2) -> Intersection | None:
    photos = [reconstruction.photos[row] for row in photo]
    return intersect_rays(
        [
            ImageRay(camera=photo.camera, world_from_cam=photo.sfm_from_cam, xy_img=xy)
            for photo, xy in zip(photos, xy_img, strict=True)
        ]
    )


def place_by_control_points(
    reconstruction: Reconstruction, surveyed: SurveyedPoints | None, site_frame: SiteFrame
) -> ControlPointPlacement:
    """Similarity to the control points that agree with one another.

    Args:
        reconstruction: the free block.
        surveyed: the control points with their marks.
        site_frame: the building's site frame; its vertical datum is that of heights whose CRS has no vertical part.

    Returns:
        the placement, with remarks on points that are not used.

    Raises:
        GeoreferenceError: fewer than three points can be used, or no majority of them agrees.
    """
    if surveyed is None:
        raise GeoreferenceError(
            "georeferencing by control points was requested, but none are given; add a gcp_list.txt"
        )
    names = tuple(point.name for point in surveyed.points)
    xyz_site = transform_to_site(surveyed, site_frame)
    outside = np.isnan(xyz_site).any(axis=1)
    marks = intersect_marks(reconstruction, surveyed)
    usable = np.array([mark is not None for mark in marks]) & ~outside
    unusable = [name for name, mark in zip(names, marks, strict=True) if mark is None]
    if usable.sum() < MIN_CONTROL_POINTS:
        raise GeoreferenceError(
            f"{usable.sum()} of {len(names)} control points of {surveyed.source} can be used, "
            f"{MIN_CONTROL_POINTS} are needed; each must be marked in 2 or more localised photographs whose names "
            f"match the files (not usable: {', '.join(unusable) or 'none'})"
            + "".join(f"; {remark}" for remark in surveyed.remarks)
        )
    xyz_sfm = np.array([mark.xyz_sfm for mark, good in zip(marks, usable, strict=True) if mark is not None and good])
    fit = fit_similarity(xyz_sfm, xyz_site[usable], np.full(xyz_sfm.shape, _CONTROL_SIGMA_M))
    if 2 * fit.used.sum() <= usable.sum():
        raise GeoreferenceError(
            f"only {int(fit.used.sum())} of {usable.sum()} control points of {surveyed.source} agree with one "
            "another (more than half must): check their coordinates, CRS and marks, or georeference by gps"
        )
    agree = usable.copy()
    agree[usable] = fit.used
    remarks = []
    if unusable:
        remarks.append(f"control points not usable (fewer than 2 agreeing marks): {', '.join(unusable)}")
    if outside.any():
        names_outside = [names[row] for row in np.flatnonzero(outside)]
        remarks.append(f"control points left out, outside the area of use of their CRS: {', '.join(names_outside)}")
    if not fit.used.all():
        gross_errors = [names[row] for row in np.flatnonzero(usable & ~agree)]
        remarks.append(f"control points left out as gross errors: {', '.join(gross_errors)}")
    if not has_own_heights(surveyed.crs):
        remarks.append(_describe_heights(surveyed.crs, site_frame.vertical_datum))
    return ControlPointPlacement(
        site_from_sfm=fit.target_from_source,
        names=names,
        xyz_site_m=xyz_site,
        marks=marks,
        agree=agree,
        remarks=tuple(remarks),
    )


def _describe_heights(crs: str, vertical_datum: str) -> str:
    """Remark on heights whose CRS has no vertical part."""
    unit_m = get_height_unit_m(crs)
    unit = "" if unit_m == 1.0 else f" and in the unit of east and north ({unit_m:.7g} m)"
    return f"the control points' heights have no stated datum: taken in the model's ({vertical_datum}){unit}"
