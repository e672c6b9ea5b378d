"""Tables as GeoPackage layers: a flat map, the points in 3D, the patches, and an elevation of each facade.

On a map seen from above a facade is a line, so each facade has a layer in its own plane: u metres to the right as
seen from outside, v metres up, both from the site's origin; a defect is its patch, or the box of its extents.
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

from facadelake.core.arrays import Float64Array
from facadelake.core.geodesy import SiteOrigin
from facadelake.publish.columns import FIRST, GEOMETRY, PATCH, decode_geometries, flatten_table
from facadelake.publish.geoparquet import CRS_2D, CRS_3D
from schemas.tables import RUN_KEYS

_COMPASS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
LEVEL = "level"  # roofs, floors and soffits: seen from above, u east and v north


@dataclass(frozen=True, kw_only=True)
class GisLayer:
    """One layer; ``geometry`` is WKB in the order of the rows and of type ``geometry_type``."""

    name: str
    rows: pa.Table
    geometry: list[bytes | None]
    geometry_type: str
    crs: str


def create_plane_crs(facade: str) -> str:
    """An engineering CRS (WKT 2) for the plane of a facade, so that no program mistakes its metres for a map's."""
    u, v = ("east", "north") if facade == LEVEL else ("to the right as seen from outside", "up")
    return (
        f'ENGCRS["facade {facade}: u {u}, v {v}",EDATUM["site origin"],CS[Cartesian,2],'
        'AXIS["u",unspecified],AXIS["v",unspecified],LENGTHUNIT["metre",1]]'
    )


def right_from_facade(facade: str) -> tuple[float, float]:
    """East and north part of the direction to the right for someone outside who looks at the facade."""
    if facade == LEVEL:
        return 1.0, 0.0
    bearing = math.radians(_parse_bearing_deg(facade))
    return -math.cos(bearing), math.sin(bearing)


def _parse_bearing_deg(facade: str) -> float:
    """Of the outward normal, clockwise from north, as the name tells: "E", or "E-075" where two facades look east."""
    point, _, degrees = facade.partition("-")
    return float(degrees) if degrees else 45.0 * _COMPASS.index(point)


def create_map_layers(table: pa.Table, name: str) -> Iterator[GisLayer]:
    """The rows as a flat layer ``<name>`` and, where they have heights, in 3D as ``<name>_3d``.

    Rows with a patch follow as ``<name>_patches`` and ``<name>_patches_3d`` with the first columns and the keys alone.
    """
    yield from _create_2d_and_3d(table, name, GEOMETRY)
    if PATCH in table.column_names:
        outlined = table.filter(pc.is_valid(table.column(PATCH)))
        if len(outlined):
            kept = [column for column in (*FIRST, *RUN_KEYS, PATCH) if column in table.column_names]
            yield from _create_2d_and_3d(outlined.select(kept), f"{name}_patches", PATCH)


def _create_2d_and_3d(rows: pa.Table, name: str, column: str) -> Iterator[GisLayer]:
    found = decode_geometries(rows, column)
    kind = _find_geometry_type(found)
    yield GisLayer(
        name=name, rows=rows, geometry=_wkb_from_geometries(shapely.force_2d(found)), geometry_type=kind, crs=CRS_2D
    )
    if shapely.has_z(found).any():
        yield GisLayer(
            name=f"{name}_3d", rows=rows, geometry=_wkb_from_geometries(found), geometry_type=f"{kind} Z", crs=CRS_3D
        )


def create_facade_layers(defects: pa.Table) -> Iterator[GisLayer]:
    """For each facade the defects (of one building) in the facade's plane (u, v in metres): the patch, else a box."""
    # A facade "inside" the building has no outside to look at it from.
    named = set(defects.column("facade").to_pylist())
    for facade in sorted(name for name in named if name == LEVEL or name.partition("-")[0] in _COMPASS):
        rows = defects.filter(pc.equal(defects.column("facade"), facade))
        outlines = _project_patches(rows, facade)
        drawn = np.where(shapely.is_missing(outlines), _create_boxes(rows, facade), outlines)
        yield GisLayer(
            name=f"facade_{facade}",
            rows=rows,
            geometry=_wkb_from_geometries(drawn),
            geometry_type=_find_geometry_type(drawn),
            crs=create_plane_crs(facade),
        )


def _plane_from_site(xyz_site_m: Float64Array, facade: str) -> Float64Array:
    """Site metres (n, 3) as u and v of the facade's plane (n, 2)."""
    if facade == LEVEL:
        return xyz_site_m[:, :2]
    return np.column_stack([xyz_site_m[:, :2] @ right_from_facade(facade), xyz_site_m[:, 2]])


def _stack_columns(rows: pa.Table, *names: str) -> Float64Array:
    return np.column_stack([rows.column(name).to_numpy() for name in names])


def _create_boxes(rows: pa.Table, facade: str) -> np.ndarray:
    u, v = _plane_from_site(_stack_columns(rows, "x_site_m", "y_site_m", "z_site_m"), facade).T
    width, height = _stack_columns(rows, "width_m", "height_m").T
    boxes: np.ndarray = shapely.box(u - width / 2, v - height / 2, u + width / 2, v + height / 2)
    return boxes


def _project_patches(rows: pa.Table, facade: str) -> np.ndarray:
    """The patches in the facade's plane, None where a row has none.

    A patch is laid out from its own defect's position: east and up at the first defect serve for all, for across a
    building they turn by 1e-5 rad, 0.05 mm over a patch of 5 m.
    """
    if PATCH not in rows.column_names:
        return np.full(len(rows), None, dtype=object)
    patches = decode_geometries(rows, PATCH)
    place = _stack_columns(rows, "lon_deg", "lat_deg", "height_ellipsoidal_m")
    here = SiteOrigin(lon_deg=place[0, 0], lat_deg=place[0, 1], height_ellipsoidal_m=place[0, 2])
    corners, owner = shapely.get_coordinates(patches, include_z=True, return_index=True)
    from_defect = here.site_from_geo(corners) - here.site_from_geo(place)[owner]
    xyz_site_m = from_defect + _stack_columns(rows, "x_site_m", "y_site_m", "z_site_m")[owner]
    outlines: np.ndarray = shapely.set_coordinates(shapely.force_2d(patches), _plane_from_site(xyz_site_m, facade))
    return outlines


def write_layers(layers: Iterator[GisLayer], path: Path) -> None:
    """A new GeoPackage of the layers, in their order; a program opens the first by default."""
    path.unlink(missing_ok=True)
    for number, layer in enumerate(layers):
        pyogrio.write_arrow(
            flatten_table(layer.rows).append_column(GEOMETRY, pa.array(layer.geometry, pa.binary())),
            path,
            layer=layer.name,
            driver="GPKG",
            geometry_name=GEOMETRY,
            geometry_type=layer.geometry_type,
            crs=layer.crs,
            append=number > 0,
        )


def write_attribute_table(table: pa.Table, name: str, path: Path) -> None:
    """A new GeoPackage with one layer that has no geometry."""
    path.unlink(missing_ok=True)
    pyogrio.write_arrow(flatten_table(table), path, layer=name, driver="GPKG", geometry_name=None, geometry_type=None)


def _find_geometry_type(found: np.ndarray) -> str:
    kinds = {shapely.get_type_id(shape) for shape in found if shape is not None}
    return {0: "Point", 3: "Polygon", 6: "MultiPolygon"}.get(kinds.pop(), "Unknown") if len(kinds) == 1 else "Unknown"


def _wkb_from_geometries(found: np.ndarray) -> list[bytes | None]:
    return list(shapely.to_wkb(found))
