"""A building model from its IFC: geometry, georeference and elements."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import ifcopenshell
import numpy as np
import pyarrow as pa
import shapely
from numpy.typing import NDArray

from facadelake.frames import Array
from facadelake.geobim.elements import attributes_of, storeys_of
from facadelake.geobim.facade import facades_of
from facadelake.geobim.footprint import in_lon_lat, outline_of
from facadelake.geobim.georeference import Georeference, chosen, georeferences_of
from facadelake.geobim.mesh import ElementMesh, meshes_of, open_ifc
from facadelake.geobim.model import BuildingModel, ModelSettings
from facadelake.geobim.storeys import StoreyLevel
from facadelake.geobim.surface import Surface
from facadelake.geodesy import SiteOrigin
from facadelake.tables import table_of_rows

_log = logging.getLogger(__name__)
_FAR_M = 10_000.0  # a map conversion further from the building than this is a false origin, not the site's


def load_building(path: Path, *, settings: ModelSettings) -> BuildingModel:
    """The building in the IFC at ``path``, every vertex ifc -> map -> EPSG:4979 -> site in float64.

    Raises ModelError for a file that is missing, truncated or without surfaces, GeoreferenceError where neither the
    IFC nor ``settings`` says where it stands, in which CRS, or what its heights refer to.
    """
    model = open_ifc(path)
    readings = georeferences_of(
        model,
        map_crs=settings.map_crs,
        vertical_datum=settings.vertical_datum,
        placement=settings.placement,
        control=settings.control,
        accept_level=settings.accept_level,
    )
    meshes = meshes_of(model, deflection_m=settings.mesh_deflection_m, workers=settings.workers)
    vertices_ifc = np.vstack([mesh.vertices_ifc_m for mesh in meshes])
    centre = (vertices_ifc.min(axis=0) + vertices_ifc.max(axis=0)) / 2
    georeference = chosen(readings, centre)
    origin = settings.origin or site_origin(georeference, centre)
    counts = [len(mesh.vertices_ifc_m) for mesh in meshes]
    starts = np.cumsum([0, *counts[:-1]])
    triangles = np.vstack([mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)])
    owner = np.repeat(np.arange(len(meshes)), [len(mesh.triangles) for mesh in meshes])
    vertices = origin.site_from_geo(georeference.geo_from_ifc(vertices_ifc))
    surface = Surface.from_mesh(vertices, triangles, owner)
    _log.info("%d elements, %d triangles, %s, heights %s", len(meshes), len(triangles), georeference.map_crs,
              georeference.vertical_datum)  # fmt: skip
    return BuildingModel(
        origin=origin,
        map_crs=georeference.map_crs,
        vertical_datum=georeference.vertical_datum,
        georeference_level=georeference.level,
        remarks=georeference.remarks,
        vertices_site_m=vertices,
        triangles=triangles,
        element_of_triangle=owner,
        elements=_elements(model, meshes, surface, owner, origin),
        storeys=_levels(model, georeference, origin, centre),
    )


def site_origin(georeference: Georeference, centre_ifc_m: Array) -> SiteOrigin:
    """The site's origin: the model's own, rounded to 1e-4 degrees and 10 m so that small corrections do not move it.

    Where the model's origin lies far from the building (a false origin), the building's middle takes its place.
    """
    own, middle = georeference.geo_from_ifc(np.vstack([np.zeros(3), centre_ifc_m]))
    lon, lat, height = middle if np.linalg.norm(centre_ifc_m) > _FAR_M else own
    return SiteOrigin(
        lon_deg=round(float(lon), 4), lat_deg=round(float(lat), 4), height_ellipsoidal_m=round(float(height), -1)
    )


def _levels(
    model: ifcopenshell.file, georeference: Georeference, origin: SiteOrigin, centre_ifc_m: Array
) -> tuple[StoreyLevel, ...]:
    """The storeys' floors in site, at the building's middle."""
    storeys = storeys_of(model)
    if not storeys:
        return ()
    floors = np.array([[centre_ifc_m[0], centre_ifc_m[1], storey.level_m] for storey in storeys])
    levels = origin.site_from_geo(georeference.geo_from_ifc(floors))[:, 2]
    return tuple(
        StoreyLevel(name=storey.name, floor_site_m=float(level)) for storey, level in zip(storeys, levels, strict=True)
    )


def _elements(
    model: ifcopenshell.file,
    meshes: Sequence[ElementMesh],
    surface: Surface,
    owner: NDArray[np.int64],
    origin: SiteOrigin,
) -> pa.Table:
    storeys = storeys_of(model)
    facades = facades_of(surface, owner, len(meshes))
    areas = np.bincount(owner, weights=surface.areas_m2, minlength=len(meshes))
    rows: list[dict[str, Any]] = []
    for index, mesh in enumerate(meshes):
        said = attributes_of(model.by_guid(mesh.guid), storeys, float(mesh.vertices_ifc_m[:, 2].min()))
        corners = surface.vertices_site_m[surface.triangles[owner == index]]
        rows.append(
            {
                "element_guid": said.guid,
                "ifc_class": said.ifc_class,
                "element_name": said.name or None,
                "storey": said.storey or None,
                "material": said.material or None,
                "is_external": said.is_external,
                "facade": facades[index],
                "surface_area_m2": float(areas[index]),
                "triangles": len(mesh.triangles),
                "geometry": shapely.to_wkb(in_lon_lat(outline_of(corners), float(corners[:, :, 2].min()), origin)),
            }
        )
    return table_of_rows("elements", rows)
