"""The world frame of imported poses, and its transform to site."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from facadelake.core.arrays import Float64Array, Float64Nx3, Float64Nx3x3
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.proj.crs import promote_to_3d
from facadelake.georeferencing.datum_shift import DatumShift, find_datum_shift, site_from_crs
from facadelake.georeferencing.gcp.control_points import add_vertical_datum, compute_height_factor, has_own_heights
from facadelake.georeferencing.site_frame import SiteFrame

SITE = "site"


class North(StrEnum):
    """The north that rotations refer to: the meridian's, or the map grid's."""

    TRUE = "true"
    GRID = "grid"


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseWorld:
    """The world frame of imported poses.

    ``crs`` of the positions: "EPSG:4979" (lon, lat, ellipsoidal height), a projected CRS, EPSG:4978, "site", or None
    for the model's own map CRS. ``origin`` of the site frame, where it is not the model's. ``crs_from_world``: from the
    file's coordinates to the CRS, an offset or the similarity of a reconstruction. Rotations refer to true east, north
    and up at the building; with ``north`` grid, to the axes of the CRS.
    """

    crs: str | None
    north: North
    origin: SiteOrigin | None = None
    crs_from_world: Similarity | None = None

    def transform_to_site(
        self, xyz_world: Float64Nx3, world_from_cam: Float64Nx3x3, site_frame: SiteFrame
    ) -> tuple[Float64Nx3, Float64Nx3x3]:
        """Centres (n, 3) and site_from_cam rotations (n, 3, 3) of poses in this world.

        Raises GeoreferenceError where the CRS is unknown or cannot hold the points.
        """
        xyz, rotations = np.asarray(xyz_world, dtype=np.float64).reshape(-1, 3), world_from_cam
        if self.crs_from_world is not None:
            xyz, rotations = self.crs_from_world.apply(xyz), self.crs_from_world.rotation @ rotations
        centres = self._site_from_crs(xyz, site_frame)
        if self.crs == SITE:
            return centres, self._site_from_own_site(site_frame).rotation @ rotations
        if self.north is North.TRUE:
            return centres, rotations
        return centres, self._rotate_from_axes(xyz, site_frame) @ rotations

    def resolve_crs(self, site_frame: SiteFrame) -> str:
        """The CRS of the positions, with the datum of their heights."""
        crs = self.crs or site_frame.map_crs
        return crs if crs == SITE else add_vertical_datum(crs, site_frame.vertical_datum)

    def find_datum_shift(self, site_frame: SiteFrame) -> DatumShift | None:
        """The shift from the datum of the positions to that of the model; None for positions in site."""
        return None if self.crs == SITE else find_datum_shift(self.resolve_crs(site_frame), site_frame)

    def describe_assumptions(self, site_frame: SiteFrame) -> list[str]:
        """Assumptions on what the file does not state, in words."""
        remarks = []
        if self.crs is None:
            remarks.append(f"the file states no CRS: positions taken in the model's {site_frame.map_crs}")
        if self.crs != SITE and not has_own_heights(self.crs or site_frame.map_crs):
            remarks.append(
                f"the poses' heights have no stated datum: taken in the model's ({site_frame.vertical_datum})"
            )
        return remarks

    def _site_from_own_site(self, site_frame: SiteFrame) -> Similarity:
        """The site frame of ``site_frame`` from the one that the poses are in."""
        if self.origin is None:
            return Similarity.make_identity()
        return site_frame.origin.ecef_from_site().invert() @ self.origin.ecef_from_site()

    def _site_from_crs(self, xyz: Float64Nx3, site_frame: SiteFrame) -> Float64Nx3:
        if self.crs == SITE:
            return self._site_from_own_site(site_frame).apply(xyz)
        crs = self.resolve_crs(site_frame)
        factor = compute_height_factor(self.crs or site_frame.map_crs, crs)
        return site_from_crs(xyz * np.array([1.0, 1.0, factor]), crs, site_frame)

    def _rotate_from_axes(self, xyz: Float64Nx3, site_frame: SiteFrame) -> Float64Nx3x3:
        """Rotations (n, 3, 3) from the CRS's axes at ``xyz`` (n, 3) to site: the Jacobian without its scale.

        Meridian convergence and the earth's curvature are contained.
        """
        crs = promote_to_3d(self.resolve_crs(site_frame))
        if crs.is_geographic:
            raise GeoreferenceError(
                f"rotations cannot refer to the axes of {self.crs}, which are in degrees; write north: true"
            )
        steps = np.eye(3)  # a metre (or foot) along each axis
        ends = np.concatenate([xyz + sign * step for step in steps for sign in (1.0, -1.0)])
        ends_site = self._site_from_crs(ends, site_frame).reshape(3, 2, len(xyz), 3)
        jacobian = np.moveaxis(ends_site[:, 0] - ends_site[:, 1], 0, -1) / 2
        u, _, vt = np.linalg.svd(jacobian)
        rotations: Float64Array = u @ vt
        if (np.linalg.det(rotations) < 0).any():
            raise GeoreferenceError(
                f"the axes of {self.crs} are left-handed as given (north before east?); give x east, y north, z up"
            )
        return rotations
