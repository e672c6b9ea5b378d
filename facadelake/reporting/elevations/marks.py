"""Marks: the outlines of defects with their labels, and the facades on which they are drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import shapely

from facadelake.building import BuildingModel
from facadelake.core.arrays import Float64Nx3, Float64x3, Float64x3x3
from facadelake.core.geodesy import SiteOrigin
from facadelake.reporting.drawing.labels import label_ids
from facadelake.reporting.elevations.facades import Facade
from facadelake.reporting.elevations.relief import FacadeRelief

_MIN_INCIDENCE_COS = 0.2  # outlines at larger angles to the elevation are not drawn
_SURFACE_TOLERANCE_M = 0.25
_DEPTH_TOLERANCE_M = 1.5  # a defect farther behind the facade's rearmost wall is not on the facade


@dataclass(frozen=True, kw_only=True, eq=False)
class DefectMark:
    """One defect as drawn on an elevation.

    ``outlines_site_m``: rings (n, 3) in site of its patch, else a rectangle of its width and height. ``normal_site``:
    outward normal of the surface. ``deviation_m``: distance from the model's surface, outward positive; None where not
    measured.
    """

    defect_id: str
    label: str
    defect_class: str
    severity: str
    element_guid: str
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
            severity=row["severity"],
            element_guid=row["element_guid"],
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


def axes_from_normal(normal_site: Float64x3) -> Float64x3x3:
    """Unit vectors right, up and outward (rows) of a surface with outward ``normal_site``, as seen from outside.

    Right of a horizontal surface is east.
    """
    out = normal_site / np.linalg.norm(normal_site)
    right = np.cross([0.0, 0.0, 1.0], out)
    if np.linalg.norm(right) < 1e-6:
        right = np.array([1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(out, right), out])


def _create_rectangle(centre: Float64x3, normal: Float64x3, width_m: float, height_m: float) -> Float64Nx3:
    """Corners of a rectangle in the surface's plane: width horizontal, height perpendicular to it."""
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    corners: Float64Nx3 = centre + (signs * [width_m / 2, height_m / 2]) @ axes_from_normal(normal)[:2]
    return corners


def assign_marks(
    facades: Sequence[Facade], marks: Sequence[DefectMark], building: BuildingModel
) -> tuple[list[list[DefectMark]], list[DefectMark]]:
    """The marks of each facade, and those on none, such as on soffits or on facades too small to be drawn.

    A mark is assigned to the facade of its element, else to the facade within whose extents it is and whose direction
    is nearest to its normal.
    """
    guids = building.elements.column("element_guid").to_pylist()
    members = [frozenset(guids[row] for row in facade.elements) for facade in facades]
    assigned: list[list[DefectMark]] = [[] for _ in facades]
    unassigned: list[DefectMark] = []
    for mark in marks:
        scores = [
            _score_facade(mark, facade, mark.element_guid in guids_on_facade)
            for facade, guids_on_facade in zip(facades, members, strict=True)
        ]
        best = int(np.argmax(scores)) if scores else -1
        if best >= 0 and scores[best] > 0:
            assigned[best].append(mark)
        else:
            unassigned.append(mark)
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


def _score_facade(mark: DefectMark, facade: Facade, is_member: bool) -> float:
    """Score of a facade for a mark; 0 or less where the mark cannot be drawn on it."""
    u, v, w = facade.uvw_from_site(mark.centre_site_m[None])[0]
    inside = facade.u_min_m <= u <= facade.u_max_m and facade.v_min_m <= v <= facade.v_max_m
    if not inside or not facade.far_w_m - _DEPTH_TOLERANCE_M <= w <= facade.near_w_m:
        return 0.0
    incidence_cos = float(mark.normal_site @ facade.axes_site[2])
    return incidence_cos - 0.3 + (2.0 if is_member else 0.0)
