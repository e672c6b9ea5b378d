"""Tables as GeoPackage layers: points and patches in 2D and 3D, and one layer per facade in the facade's plane.

In plan view a facade is a line; therefore each facade has a layer in its own plane: u in metres to the right as seen
from outside, v in metres up, both from the site's origin. A defect is drawn as its patch, or as a box of its extents.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyogrio
import shapely

from facadelake.core.arrays import Float64Array, Float64Nx2, Float64Nx3
from facadelake.core.geodesy import SiteOrigin
from facadelake.publish.columns import FIRST, GEOMETRY, PATCH, decode_geometries, flatten_table
from facadelake.publish.geoparquet import CRS_2D, CRS_3D
from schemas.tables import RUN_KEYS

_COMPASS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
LEVEL = "level"  # roofs, floors and soffits: plan view, u east and v north


@dataclass(frozen=True, kw_only=True)
class GisLayer:
    """A GeoPackage layer; ``geometry`` holds one WKB per row, of the GDAL type ``geometry_type``."""

    name: str
    rows: pa.Table
    geometry: list[bytes | None]
    geometry_type: str
    crs: str


def create_plane_crs(facade: str) -> str:
    """Engineering CRS (WKT 2, ISO 19162) of a facade's plane, so that its metres are not taken for map coordinates."""
    u, v = ("east", "north") if facade == LEVEL else ("to the right as seen from outside", "up")
    return (
        f'ENGCRS["facade {facade}: u {u}, v {v}",EDATUM["site origin"],CS[Cartesian,2],'
        'AXIS["u",unspecified],AXIS["v",unspecified],LENGTHUNIT["metre",1]]'
    )


def right_from_facade(facade: str) -> tuple[float, float]:
    """East and north components of the unit vector along a facade, to the right as seen from outside."""
    if facade == LEVEL:
        return 1.0, 0.0
    bearing = math.radians(_parse_bearing_deg(facade))
    return -math.cos(bearing), math.sin(bearing)


def _parse_bearing_deg(facade: str) -> float:
    """Azimuth of the outward normal, clockwise from north, from a facade's name: "E", or "E-075" with its degrees."""
    point, _, degrees = facade.partition("-")
    return float(degrees) if degrees else 45.0 * _COMPASS.index(point)


def create_map_layers(table: pa.Table, name: str) -> Iterator[GisLayer]:
    """The rows as a 2D layer ``<name>`` and, where they have heights, a 3D layer ``<name>_3d``.

    Rows with a patch follow as ``<name>_patches`` and ``<name>_patches_3d``, with the first columns and the keys only.
    """
    yield from _create_2d_and_3d(table, name, GEOMETRY)
    if PATCH in table.column_names:
        with_patch = table.filter(pc.is_valid(table.column(PATCH)))
        if len(with_patch):
            kept = [column for column in (*FIRST, *RUN_KEYS, PATCH) if column in table.column_names]
            yield from _create_2d_and_3d(with_patch.select(kept), f"{name}_patches", PATCH)


def _create_2d_and_3d(rows: pa.Table, name: str, column: str) -> Iterator[GisLayer]:
    geometries = decode_geometries(rows, column)
    geometry_type = _find_geometry_type(geometries)
    yield GisLayer(
        name=name,
        rows=rows,
        geometry=_wkb_from_geometries(shapely.force_2d(geometries)),
        geometry_type=geometry_type,
        crs=CRS_2D,
    )
    if shapely.has_z(geometries).any():
        yield GisLayer(
            name=f"{name}_3d",
            rows=rows,
            geometry=_wkb_from_geometries(geometries),
            geometry_type=f"{geometry_type} Z",
            crs=CRS_3D,
        )


def create_facade_layers(defects: pa.Table) -> Iterator[GisLayer]:
    """One layer per facade of one building: each defect's patch, else a box, in the facade's plane (u, v in metres)."""
    # Interior surfaces (facade "inside") have no exterior view.
    facades = set(defects.column("facade").to_pylist())
    for facade in sorted(name for name in facades if name == LEVEL or name.partition("-")[0] in _COMPASS):
        rows = defects.filter(pc.equal(defects.column("facade"), facade))
        patches = _project_patches(rows, facade)
        polygons = np.where(shapely.is_missing(patches), _create_boxes(rows, facade), patches)
        yield GisLayer(
            name=f"facade_{facade}",
            rows=rows,
            geometry=_wkb_from_geometries(polygons),
            geometry_type=_find_geometry_type(polygons),
            crs=create_plane_crs(facade),
        )


def _plane_from_site(xyz_site_m: Float64Nx3, facade: str) -> Float64Nx2:
    """Coordinates (n, 2) u and v, in metres, in a facade's plane, of points (n, 3) of site."""
    if facade == LEVEL:
        return xyz_site_m[:, :2]
    return np.column_stack([xyz_site_m[:, :2] @ right_from_facade(facade), xyz_site_m[:, 2]])


def _collect_columns(rows: pa.Table, *names: str) -> Float64Array:
    return np.column_stack([rows.column(name).to_numpy() for name in names])


def _create_boxes(rows: pa.Table, facade: str) -> np.ndarray:
    u, v = _plane_from_site(_collect_columns(rows, "x_site_m", "y_site_m", "z_site_m"), facade).T
    width, height = _collect_columns(rows, "width_m", "height_m").T
    boxes: np.ndarray = shapely.box(u - width / 2, v - height / 2, u + width / 2, v + height / 2)
    return boxes


def _project_patches(rows: pa.Table, facade: str) -> np.ndarray:
    """The patches in the facade's plane, None where a row has none.

    Each patch is placed relative to its own defect's position. The east-north-up axes of the first defect are used
    for all: across a building the axes differ by 1e-5 rad, which is 0.05 mm over a patch of 5 m.
    """
    if PATCH not in rows.column_names:
        return np.full(len(rows), None, dtype=object)
    patches = decode_geometries(rows, PATCH)
    position_geo = _collect_columns(rows, "lon_deg", "lat_deg", "height_ellipsoidal_m")
    lon_deg, lat_deg, height_m = position_geo[0]
    local = SiteOrigin(lon_deg=lon_deg, lat_deg=lat_deg, height_ellipsoidal_m=height_m)
    vertices_geo, row = shapely.get_coordinates(patches, include_z=True, return_index=True)
    offset_m = local.site_from_geo(vertices_geo) - local.site_from_geo(position_geo)[row]
    xyz_site_m = offset_m + _collect_columns(rows, "x_site_m", "y_site_m", "z_site_m")[row]
    projected: np.ndarray = shapely.set_coordinates(shapely.force_2d(patches), _plane_from_site(xyz_site_m, facade))
    return projected


def write_layers(layers: Iterator[GisLayer], path: Path) -> None:
    """Write a new GeoPackage with the layers in the given order; GIS programs open the first one by default."""
    path.unlink(missing_ok=True)
    for index, layer in enumerate(layers):
        pyogrio.write_arrow(
            flatten_table(layer.rows).append_column(GEOMETRY, pa.array(layer.geometry, pa.binary())),
            path,
            layer=layer.name,
            driver="GPKG",
            geometry_name=GEOMETRY,
            geometry_type=layer.geometry_type,
            crs=layer.crs,
            append=index > 0,
        )


def write_attribute_table(table: pa.Table, name: str, path: Path) -> None:
    """Write a new GeoPackage with one attribute table, without geometry."""
    path.unlink(missing_ok=True)
    pyogrio.write_arrow(flatten_table(table), path, layer=name, driver="GPKG", geometry_name=None, geometry_type=None)


def _find_geometry_type(geometries: np.ndarray) -> str:
    """GDAL's name of the common type of the geometries; "Unknown" where they differ."""
    types = {shapely.get_type_id(geometry) for geometry in geometries if geometry is not None}
    return {0: "Point", 3: "Polygon", 6: "MultiPolygon"}.get(types.pop(), "Unknown") if len(types) == 1 else "Unknown"


def _wkb_from_geometries(geometries: np.ndarray) -> list[bytes | None]:
    return list(shapely.to_wkb(geometries))
