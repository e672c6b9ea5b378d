"""Where a block begins on the globe: a similarity by control points, by GPS, or by the walls of the model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array, Int64Array
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.georeferencing.gcp.control_points import (
    SurveyedPoints,
    has_own_heights,
    match_photo_names,
    transform_to_site,
)
from facadelake.georeferencing.similarity_fit import fit_similarity
from facadelake.georeferencing.triangulation import ImageRay, Intersection, intersect_rays
from facadelake.sfm import Reconstruction

# Survey, marking and the free block's own bending together; a control point farther off (3.5 times) is a blunder.
_CONTROL_SIGMA_M = 0.15
MIN_CONTROL_POINTS = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class IntersectedMarks:
    """Where a control point was marked and the marks agree: ``photo`` (k,) rows of the block, ``xy_img`` (k, 2), and
    the point in sfm by the marks alone (3,)."""

    photo: Int64Array
    xy_img: Float64Array
    xyz_sfm: Float64Array


@dataclass(frozen=True, kw_only=True, eq=False)
class ControlPointPlacement:
    """A start by control points.

    ``xyz_site_m`` (p, 3) of all points, ``marks`` of those that can be used (None: fewer than two agreeing marks),
    ``agree`` (p,) those that agree with one another.
    """

    site_from_sfm: Similarity
    names: tuple[str, ...]
    xyz_site_m: Float64Array
    marks: tuple[IntersectedMarks | None, ...]
    agree: BoolArray
    remarks: tuple[str, ...]


def intersect_marks(
    reconstruction: Reconstruction, control_points: SurveyedPoints
) -> tuple[IntersectedMarks | None, ...]:
    """The agreeing marks of each point in photographs of the block; None where fewer than two agree."""
    index = {photo.photo_id: row for row, photo in enumerate(reconstruction.photos)}
    names = [sighting.photo_name for point in control_points.points for sighting in point.marks]
    photo_of = match_photo_names(names, list(index))
    out: list[IntersectedMarks | None] = []
    for point in control_points.points:
        seen = [sighting for sighting in point.marks if sighting.photo_name in photo_of]
        rows = np.array([index[photo_of[sighting.photo_name]] for sighting in seen], dtype=np.int64)
        xy = np.array([[sighting.x_px, sighting.y_px] for sighting in seen]).reshape(-1, 2)
        found = _intersect(reconstruction, rows, xy) if len(seen) >= 2 else None
        out.append(
            None
            if found is None
            else IntersectedMarks(photo=rows[found.used], xy_img=xy[found.used], xyz_sfm=found.xyz_world)
        )
    return tuple(out)


def _intersect(reconstruction: Reconstruction, photo: Int64Array, xy_img: Float64Array) -> Intersection | None:
    photos = [reconstruction.photos[row] for row in photo]
    return intersect_rays(
        [
            ImageRay(camera=photo.camera, world_from_cam=photo.sfm_from_cam, xy_img=xy)
            for photo, xy in zip(photos, xy_img, strict=True)
        ]
    )


def place_by_control_points(
    reconstruction: Reconstruction, control_points: SurveyedPoints | None, origin: SiteOrigin, vertical_datum: str
) -> ControlPointPlacement:
    """Similarity to the control points that agree with one another.

    Raises GeoreferenceError for fewer than three usable points, or where no majority agrees.
    """
    if control_points is None:
        raise GeoreferenceError("georeference by control points was asked for, but none were given; add a gcp_list.txt")
    names = tuple(point.name for point in control_points.points)
    xyz_site = transform_to_site(control_points, origin=origin, vertical_datum=vertical_datum)
    marks = intersect_marks(reconstruction, control_points)
    usable = np.array([mark is not None for mark in marks])
    lost = [name for name, good in zip(names, usable, strict=True) if not good]
    if usable.sum() < MIN_CONTROL_POINTS:
        raise GeoreferenceError(
            f"{usable.sum()} of {len(names)} control points of {control_points.source} can be used, "
            f"{MIN_CONTROL_POINTS} are needed; each must be marked in 2 or more localised photographs whose names "
            f"match the files (not usable: {', '.join(lost) or 'none'})"
        )
    xyz_sfm = np.array([mark.xyz_sfm for mark in marks if mark is not None])
    fit = fit_similarity(xyz_sfm, xyz_site[usable], np.full(xyz_sfm.shape, _CONTROL_SIGMA_M))
    if 2 * fit.used.sum() <= usable.sum():
        raise GeoreferenceError(
            f"only {int(fit.used.sum())} of {usable.sum()} control points of {control_points.source} agree with one "
            "another (more than half must): check their coordinates, CRS and marks, or georeference by gps"
        )
    agree = usable.copy()
    agree[usable] = fit.used
    remarks = []
    if lost:
        remarks.append(f"control points not usable (fewer than 2 agreeing marks): {', '.join(lost)}")
    if not fit.used.all():
        blunders = [names[row] for row in np.flatnonzero(usable & ~agree)]
        remarks.append(f"control points left out as gross errors: {', '.join(blunders)}")
    if not has_own_heights(control_points.crs):
        remarks.append(f"the control points' heights name no datum: taken in the model's ({vertical_datum})")
    return ControlPointPlacement(
        site_from_sfm=fit.target_from_source,
        names=names,
        xyz_site_m=xyz_site,
        marks=marks,
        agree=agree,
        remarks=tuple(remarks),
    )
