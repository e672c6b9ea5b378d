"""The surfaces of a mesh by all readings that the portfolio leaves open, and their comparison with photographs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa

from facadelake.building.mesh.files import MAX_SIZE_M
from facadelake.building.mesh.load import MeshModelSettings, read_placed_mesh, round_origin
from facadelake.building.mesh.readings import list_other_readings, read_photograph_rays, require_reading_fits
from facadelake.building.surface.raycasting import Surface
from facadelake.core.arrays import Float64x3
from facadelake.core.geodesy import SiteOrigin

_MIN_HEIGHT_M = 2.0  # of a storey


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceReading:
    """The surface of a mesh by one reading, in site.

    ``keys``: the keys of the portfolio that state the reading; ``size_m`` (3,): east, north, up.
    """

    keys: str
    size_m: Float64x3
    surface: Surface


def list_surface_readings(path: Path, origin: SiteOrigin, *, settings: MeshModelSettings) -> tuple[SurfaceReading, ...]:
    """The surfaces of the mesh at ``path`` by the reading taken, which is the first, and by the others that are open.

    ``origin`` is that of the site frame. Readings by which the mesh would lie outside the area of use of its CRS, or
    have a size that no building has, are left out. Empty where the portfolio states axis and unit.
    """
    mesh, taken, georeference = read_placed_mesh(path, settings)
    others = list_other_readings(taken, axes=settings.axes, unit=settings.unit)
    if not others:
        return ()
    found = []
    for reading in (taken, *others):
        vertices_m = reading.read_vertices(mesh.vertices_m, taken)
        extent_m = np.array([vertices_m.min(axis=0), vertices_m.max(axis=0)])
        size_m = np.ptp(extent_m, axis=0)
        is_building = size_m[2] >= _MIN_HEIGHT_M and size_m.max() <= MAX_SIZE_M
        if reading is taken or (is_building and georeference.is_in_area_of_use(extent_m.mean(axis=0))):
            vertices_site_m = origin.site_from_geo(georeference.geo_from_ifc(vertices_m))
            found.append(
                SurfaceReading(
                    keys=str(reading),
                    size_m=size_m,
                    surface=Surface.from_mesh(vertices_site_m, mesh.triangles),
                )
            )
    return tuple(found)


def check_mesh_against_photographs(path: Path, photos: pa.Table, *, settings: MeshModelSettings) -> None:
    """Check the upward axis and the unit with which a mesh was read, as far as the portfolio leaves them open.

    Args:
        path: the mesh.
        photos: table ``photos`` of the campaign.
        settings: the portfolio's statements.

    Raises:
        GeoreferenceError: the photographs' positions and attitudes fit another reading, and do not fit this one.
    """
    mesh, taken, georeference = read_placed_mesh(path, settings)
    others = list_other_readings(taken, axes=settings.axes, unit=settings.unit)
    rays = read_photograph_rays(photos)
    if not others or not len(rays.geo):
        return
    centre = (mesh.vertices_m.min(axis=0) + mesh.vertices_m.max(axis=0)) / 2
    origin = settings.origin or round_origin(georeference.geo_from_ifc(centre[None])[0])
    require_reading_fits(
        taken,
        others,
        mesh.vertices_m,
        mesh.triangles,
        lambda vertices_m: origin.site_from_geo(georeference.geo_from_ifc(vertices_m)),
        replace(rays, geo=origin.site_from_geo(rays.geo)),
    )
