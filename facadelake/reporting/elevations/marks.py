"""Marks: the outlines of defects with their labels, and the facades on which they are drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import shapely

from facadelake.core.arrays import Float64Nx3, Float64x3
from facadelake.core.frames import axes_from_normal
from facadelake.core.geodesy import SiteOrigin
from facadelake.reporting.drawing.labels import label_ids
from facadelake.reporting.elevations.facades import Facade, choose_view
from facadelake.reporting.elevations.relief import FacadeRelief
from facadelake.severity import describe_severity

_MIN_INCIDENCE_COS = 0.2  # outlines at larger angles to the elevation are not drawn
_SURFACE_TOLERANCE_M = 0.25


@dataclass(frozen=True, kw_only=True, eq=False)
class DefectMark:
    """One defect as drawn on an elevation.

    ``facade``: its column of table ``defects``. ``outlines_site_m``: rings (n, 3) in site of its patch, else a
    rectangle of its width and height. ``normal_site``: outward normal of the surface. ``deviation_m``: distance from
    the model's surface, outward positive; None where not measured.
    """

    defect_id: str
    label: str
    defect_class: str
    severity: str
    facade: str
    centre_site_m: Float64x3
    outlines_site_m: tuple[Float64Nx3, ...]
    normal_site: Float64x3
    deviation_m: float | None = None

    @property
    def corners_site_m(self) -> Float64Nx3:
        """All vertices of its outlines in site."""
        return np.vstack(self.outlines_site_m)


def create_marks(defects: pa.Table, origin: SiteOrigin) -> list[DefectMark]:
    """Marks of all rows of a table ``defects``, in its order; ``origin`` is that of the site frame."""
    rows = defects.to_pylist()
    labels = label_ids([row["defect_id"] for row in rows])
    outlines = _decode_patches([row["patch"] for row in rows], origin)
    return [
        DefectMark(
            defect_id=row["defect_id"],
            label=labels[row["defect_id"]],
            defect_class=row["defect_class"],
            severity=describe_severity(row),
            facade=row["facade"],
            centre_site_m=(centre := np.array([row["x_site_m"], row["y_site_m"], row["z_site_m"]])),
            normal_site=(normal := np.array([row["normal_x"], row["normal_y"], row["normal_z"]])),
            outlines_site_m=rings or (_create_rectangle(centre, normal, row["width_m"], row["height_m"]),),
            deviation_m=row["deviation_from_model_m"],
        )
        for row, rings in zip(rows, outlines, strict=True)
    ]


def _decode_patches(patches: Sequence[bytes | None], origin: SiteOrigin) -> list[tuple[Float64Nx3, ...]]:
    """Outer rings in site of each patch (WKB, EPSG:4979); empty where there is no patch or it has no heights."""
    outlines: list[tuple[Float64Nx3, ...]] = []
    for patch in patches:
        geometry = shapely.from_wkb(patch) if patch else None
        parts = [] if geometry is None or not geometry.has_z else shapely.get_parts(geometry).tolist()
        rings = [shapely.get_coordinates(part.exterior, include_z=True) for part in parts if hasattr(part, "exterior")]
        outlines.append(tuple(origin.site_from_geo(ring) for ring in rings if len(ring) >= 4))
    return outlines


def _create_rectangle(centre: Float64x3, normal: Float64x3, width_m: float, height_m: float) -> Float64Nx3:
    """Corners of a rectangle in the surface's plane: width horizontal, height perpendicular to it."""
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    corners: Float64Nx3 = centre + (signs * [width_m / 2, height_m / 2]) @ axes_from_normal(normal)[:2]
    return corners


def assign_marks(
    facades: Sequence[Facade], marks: Sequence[DefectMark]
) -> tuple[list[list[DefectMark]], list[DefectMark]]:
    """The marks of each facade, and those on none, such as on soffits.

    Column ``facade`` of table ``defects`` decides.
    """
    assigned: list[list[DefectMark]] = [[] for _ in facades]
    unassigned: list[DefectMark] = []
    for mark in marks:
        views = [index for index, facade in enumerate(facades) if facade.code == mark.facade]
        chosen = choose_view([facades[index] for index in views], mark.centre_site_m)
        if chosen is None:
            unassigned.append(mark)
        else:
            assigned[views[chosen]].append(mark)
    return assigned, unassigned


def find_visible_marks(
    relief: FacadeRelief, marks: Sequence[DefectMark], own: Sequence[DefectMark]
) -> list[DefectMark]:
    """Marks of other facades that are visible in this elevation too, such as on the sides of a curved wall."""
    own_ids = {mark.defect_id for mark in own}
    outward = relief.facade.axes_site[2]
    return [
        mark
        for mark in marks
        if mark.defect_id not in own_ids
        and float(mark.normal_site @ outward) > _MIN_INCIDENCE_COS
        and relief.has_surface_at(mark.centre_site_m, _SURFACE_TOLERANCE_M)
    ]
