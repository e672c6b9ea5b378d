"""Tables as GeoPackage layers: a flat map, the points in 3D, and an elevation of each facade.

On a map seen from above a facade is a line, so each facade has a layer in its own plane: u metres to the right as
seen from outside, v metres up, both from the site's origin; a defect is the box of its extents.
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

from facadelake.publish.geoparquet import CRS_2D, CRS_3D, GEOMETRY, ordered

_COMPASS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
LEVEL = "level"  # roofs, floors and soffits: seen from above, u east and v north


@dataclass(frozen=True, kw_only=True)
class Layer:
    """One layer; ``geometry`` is WKB in the order of the rows and of type ``geometry_type``."""

    name: str
    rows: pa.Table
    geometry: list[bytes | None]
    geometry_type: str
    crs: str


def plane_crs(facade: str) -> str:
    """An engineering CRS (WKT 2) for the plane of a facade, so that no program mistakes its metres for a map's."""
    u, v = ("east", "north") if facade == LEVEL else ("to the right as seen from outside", "up")
    return (
        f'ENGCRS["facade {facade}: u {u}, v {v}",EDATUM["site origin"],CS[Cartesian,2],'
        'AXIS["u",unspecified],AXIS["v",unspecified],LENGTHUNIT["metre",1]]'
    )


def right_of(facade: str) -> tuple[float, float]:
    """East and north part of the direction to the right for someone outside who looks at the facade."""
    if facade == LEVEL:
        return 1.0, 0.0
    bearing = math.radians(45 * _COMPASS.index(facade))  # of the outward normal, clockwise from north
    return -math.cos(bearing), math.sin(bearing)


def geo_layers(table: pa.Table, name: str) -> Iterator[Layer]:
    """The rows as a flat layer ``<name>`` and, where they have heights, in 3D as ``<name>_3d``."""
    shapes = shapely.from_wkb(table.column(GEOMETRY).to_numpy())
    kind = _kind(shapes)
    yield Layer(name=name, rows=table, geometry=_wkb(shapely.force_2d(shapes)), geometry_type=kind, crs=CRS_2D)
    if shapely.has_z(shapes).any():
        yield Layer(name=f"{name}_3d", rows=table, geometry=_wkb(shapes), geometry_type=f"{kind} Z", crs=CRS_3D)


def facade_layers(defects: pa.Table) -> Iterator[Layer]:
    """For each facade its defects as boxes in the facade's plane (u, v in metres)."""
    # A facade "inside" the building has no outside to look at it from.
    for facade in sorted({*_COMPASS, LEVEL} & set(defects.column("facade").to_pylist())):
        rows = defects.filter(pc.equal(defects.column("facade"), facade))
        x, y, z, width, height = (
            rows.column(name).to_numpy() for name in ("x_site_m", "y_site_m", "z_site_m", "width_m", "height_m")
        )
        east, north = right_of(facade)
        u, v = (x, y) if facade == LEVEL else (x * east + y * north, z)
        boxes = shapely.box(u - width / 2, v - height / 2, u + width / 2, v + height / 2)
        yield Layer(
            name=f"facade_{facade}", rows=rows, geometry=_wkb(boxes), geometry_type="Polygon", crs=plane_crs(facade)
        )


def write_layers(layers: Iterator[Layer], path: Path) -> None:
    """A new GeoPackage of the layers, in their order; a program opens the first by default."""
    path.unlink(missing_ok=True)
    for number, layer in enumerate(layers):
        plain = ordered(layer.rows).drop_columns([GEOMETRY])
        pyogrio.write_arrow(
            plain.append_column(GEOMETRY, pa.array(layer.geometry, pa.binary())),
            path,
            layer=layer.name,
            driver="GPKG",
            geometry_name=GEOMETRY,
            geometry_type=layer.geometry_type,
            crs=layer.crs,
            append=number > 0,
        )


def write_plain(table: pa.Table, name: str, path: Path) -> None:
    """A new GeoPackage with one layer that has no geometry."""
    path.unlink(missing_ok=True)
    pyogrio.write_arrow(ordered(table), path, layer=name, driver="GPKG", geometry_name=None, geometry_type=None)


def _kind(shapes: np.ndarray) -> str:
    kinds = {shapely.get_type_id(shape) for shape in shapes if shape is not None}
    return {0: "Point", 3: "Polygon", 6: "MultiPolygon"}.get(kinds.pop(), "Unknown") if len(kinds) == 1 else "Unknown"


def _wkb(shapes: np.ndarray) -> list[bytes | None]:
    return list(shapely.to_wkb(shapes))
