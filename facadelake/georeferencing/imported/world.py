"""The world that imported poses are given in, and how its points and directions come into site."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from facadelake.core.arrays import Float64Array
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import GEO, SiteOrigin, promote_to_3d, transform
from facadelake.georeferencing.gcp.control_points import add_vertical_datum, has_own_heights
from facadelake.georeferencing.site_frame import SiteFrame

SITE = "site"


class North(StrEnum):
    """Which north a rotation's world has: the meridian's, or the map grid's."""

    TRUE = "true"
    GRID = "grid"


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseWorld:
    """Where imported poses stand.

    ``crs`` of the positions: "EPSG:4979" (lon, lat, ellipsoidal height), a projected CRS, EPSG:4978, "site", or None
    for the model's own map CRS. ``origin`` is that of the site frame where it is not the model's. ``crs_from_world``
    takes the file's coordinates into the CRS: an offset, or the similarity of a reconstruction. Rotations refer to
    true east, north and up at the building; with ``north`` grid, to the axes of the CRS.
    """

    crs: str | None
    north: North
    origin: SiteOrigin | None = None
    crs_from_world: Similarity | None = None

    def transform_to_site(
        self, xyz_world: Float64Array, world_from_cam: Float64Array, place: SiteFrame
    ) -> tuple[Float64Array, Float64Array]:
        """Centres (n, 3) and rotations (n, 3, 3) in the site frame of ``place``.

        Raises GeoreferenceError where the CRS is not known or cannot hold the points.
        """
        xyz, rotations = np.asarray(xyz_world, dtype=np.float64).reshape(-1, 3), world_from_cam
        if self.crs_from_world is not None:
            xyz, rotations = self.crs_from_world.apply(xyz), self.crs_from_world.rotation @ rotations
        centres = self._to_site(xyz, place)
        if self.crs == SITE:
            return centres, self._site_from_own(place).rotation @ rotations
        if self.north is North.TRUE:
            return centres, rotations
        return centres, self._axes_in_site(xyz, place) @ rotations

    def resolve_crs(self, place: SiteFrame) -> str:
        """The CRS of the positions, with what their heights refer to."""
        crs = self.crs or place.map_crs
        return crs if crs == SITE else add_vertical_datum(crs, place.vertical_datum)

    def describe_assumptions(self, place: SiteFrame) -> list[str]:
        """What had to be assumed of the world."""
        said = []
        if self.crs is None:
            said.append(f"the file names no CRS: its positions were taken in the model's {place.map_crs}")
        if self.crs != SITE and not has_own_heights(self.crs or place.map_crs):
            said.append(f"the poses' heights name no datum: taken in the model's ({place.vertical_datum})")
        return said

    def _site_from_own(self, place: SiteFrame) -> Similarity:
        """The site frame of ``place`` from the one the poses are in."""
        if self.origin is None:
            return Similarity.make_identity()
        return place.origin.ecef_from_site().invert() @ self.origin.ecef_from_site()

    def _to_site(self, xyz: Float64Array, place: SiteFrame) -> Float64Array:
        if self.crs == SITE:
            return self._site_from_own(place).apply(xyz)
        return place.origin.site_from_geo(transform(xyz, self.resolve_crs(place), GEO))

    def _axes_in_site(self, xyz: Float64Array, place: SiteFrame) -> Float64Array:
        """Rotations (n, 3, 3) of the CRS's axes at ``xyz`` (n, 3) into site: the map's derivative without its scale.

        So the convergence of meridians and the earth's curvature are in it.
        """
        crs = promote_to_3d(self.resolve_crs(place))
        if crs.is_geographic:
            raise GeoreferenceError(
                f"rotations cannot refer to the axes of {self.crs}, which are degrees; write north: true"
            )
        steps = np.eye(3)  # a metre (or foot) along each axis
        ends = np.concatenate([xyz + sign * step for step in steps for sign in (1.0, -1.0)])
        moved = self._to_site(ends, place).reshape(3, 2, len(xyz), 3)
        derivative = np.moveaxis(moved[:, 0] - moved[:, 1], 0, -1) / 2
        u, _, vt = np.linalg.svd(derivative)
        turned: Float64Array = u @ vt
        if (np.linalg.det(turned) < 0).any():
            raise GeoreferenceError(
                f"the axes of {self.crs} are left-handed as given (north before east?); give x east, y north, z up"
            )
        return turned
