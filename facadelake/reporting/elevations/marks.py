"""Defects as outlines on a facade: which facade each belongs to, and its corners in the facade's plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import shapely

from facadelake.building import BuildingModel
from facadelake.core.arrays import Float64Array
from facadelake.core.geodesy import SiteOrigin
from facadelake.reporting.drawing.labels import label_ids
from facadelake.reporting.elevations.facades import Facade
from facadelake.reporting.elevations.relief import FacadeRelief

_MIN_INCIDENCE_COS = 0.2  # seen flatter than this an outline is a stroke
_SURFACE_TOLERANCE_M = 0.25
_DEPTH_TOLERANCE_M = 1.5  # a defect this far behind a facade's rearmost wall is not on it


@dataclass(frozen=True, kw_only=True, eq=False)
class DefectMark:
    """One defect: where it is, and what is written beside it.

    ``outlines_site_m``: rings (n, 3) in site, its measured patch, else a rectangle of its size; ``normal_site`` points
    out of the surface. ``deviation_m`` is how far it stands before the model's surface, None where not measured.
    """

    defect_id: str
    label: str
    defect_class: str
    severity: str
    element_guid: str
    centre_site_m: Float64Array
    outlines_site_m: tuple[Float64Array, ...]
    normal_site: Float64Array
    deviation_m: float | None = None

    @property
    def corners_site_m(self) -> Float64Array:
        """All corners (n, 3) of its outlines."""
        return np.vstack(self.outlines_site_m)


def create_marks(defects: pa.Table, origin: SiteOrigin) -> list[DefectMark]:
    """All defects of a table of kind ``defects``, in its order; patches are in EPSG:4979, ``origin`` is site's."""
    rows = defects.to_pylist()
    labels = label_ids([row["defect_id"] for row in rows])
    rings = _decode_patches([row["patch"] for row in rows], origin)
    return [
        DefectMark(
            defect_id=row["defect_id"],
            label=labels[row["defect_id"]],
            defect_class=row["defect_class"],
            severity=row["severity"],
            element_guid=row["element_guid"],
            centre_site_m=(centre := np.array([row["x_site_m"], row["y_site_m"], row["z_site_m"]])),
            normal_site=(normal := np.array([row["normal_x"], row["normal_y"], row["normal_z"]])),
            outlines_site_m=own or (_create_rectangle(centre, normal, row["width_m"], row["height_m"]),),
            deviation_m=row["deviation_from_model_m"],
        )
        for row, own in zip(rows, rings, strict=True)
    ]


def _decode_patches(patches: Sequence[bytes | None], origin: SiteOrigin) -> list[tuple[Float64Array, ...]]:
    """Outer rings of each WKB polygon in site; none where there is no patch, or it has no heights."""
    found: list[tuple[Float64Array, ...]] = []
    for patch in patches:
        shape = shapely.from_wkb(patch) if patch else None
        parts = [] if shape is None or not shape.has_z else shapely.get_parts(shape).tolist()
        rings = [shapely.get_coordinates(part.exterior, include_z=True) for part in parts if hasattr(part, "exterior")]
        found.append(tuple(origin.site_from_geo(ring) for ring in rings if len(ring) >= 4))
    return found


def compute_surface_axes(normal_site: Float64Array) -> Float64Array:
    """Rows right, up, out (3, 3) of a surface with outward ``normal_site`` (3,), as who stands before it sees it.

    Of a floor or a ceiling, where no direction is up, right is east.
    """
    out = normal_site / np.linalg.norm(normal_site)
    right = np.cross([0.0, 0.0, 1.0], out)
    if np.linalg.norm(right) < 1e-6:
        right = np.array([1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(out, right), out])


def _create_rectangle(centre: Float64Array, normal: Float64Array, width_m: float, height_m: float) -> Float64Array:
    """Corners (4, 3) of a rectangle in the surface's plane: width horizontal, height across it."""
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    corners: Float64Array = centre + (signs * [width_m / 2, height_m / 2]) @ compute_surface_axes(normal)[:2]
    return corners


def assign_marks(
    facades: Sequence[Facade], marks: Sequence[DefectMark], building: BuildingModel
) -> tuple[list[list[DefectMark]], list[DefectMark]]:
    """The marks of each facade, and those on none (a floor slab's underside, a facade too small to be drawn).

    A mark belongs to the facade of its element, else to the one it faces most squarely and lies within.
    """
    guids = building.elements.column("element_guid").to_pylist()
    members = [frozenset(guids[row] for row in facade.elements) for facade in facades]
    shown: list[list[DefectMark]] = [[] for _ in facades]
    nowhere: list[DefectMark] = []
    for mark in marks:
        scores = [_score_facade(mark, f, mark.element_guid in own) for f, own in zip(facades, members, strict=True)]
        best = int(np.argmax(scores)) if scores else -1
        if best >= 0 and scores[best] > 0:
            shown[best].append(mark)
        else:
            nowhere.append(mark)
    return shown, nowhere


def find_visible_marks(
    relief: FacadeRelief, marks: Sequence[DefectMark], own: Sequence[DefectMark]
) -> list[DefectMark]:
    """Marks of other facades that this elevation shows too, such as on a curved wall's flank."""
    mine = {mark.defect_id for mark in own}
    outward = relief.facade.axes_site[2]
    return [
        mark
        for mark in marks
        if mark.defect_id not in mine
        and float(mark.normal_site @ outward) > _MIN_INCIDENCE_COS
        and relief.has_surface_at(mark.centre_site_m, _SURFACE_TOLERANCE_M)
    ]


def _score_facade(mark: DefectMark, facade: Facade, is_member: bool) -> float:
    """How well a mark fits a facade; 0 or less where it cannot be shown on it."""
    u, v, w = facade.uvw_from_site(mark.centre_site_m[None])[0]
    inside = facade.u_min_m <= u <= facade.u_max_m and facade.v_min_m <= v <= facade.v_max_m
    if not inside or not facade.far_w_m - _DEPTH_TOLERANCE_M <= w <= facade.near_w_m:
        return 0.0
    square_on = float(mark.normal_site @ facade.axes_site[2])
    return square_on - 0.3 + (2.0 if is_member else 0.0)
