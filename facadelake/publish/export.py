"""Export of one table to one file for GIS or a spreadsheet; the file's suffix selects the format."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as csv
import pyarrow.parquet as pq
import pyogrio

from facadelake.core.errors import InputDataError
from facadelake.publish.columns import GEOMETRIES, GEOMETRY, PATCH, flatten_table, order_columns, wkt_from_wkb
from facadelake.publish.geopackage import (
    create_coverage_layers,
    create_facade_layers,
    create_map_layers,
    write_attribute_table,
    write_layers,
)
from facadelake.publish.geoparquet import CRS_2D, geodataframe_from_table, write_geoparquet
from facadelake.publish.replaced_file import replace_file


def export_table(name: str, table: pa.Table, path: Path) -> Path:
    """Write the rows of table ``name`` (columns as in the lake) to ``path``, atomically, and return the path.

    ``.parquet``: GeoParquet in EPSG:4979, or plain Parquet for a table without geometry. ``.gpkg``: layers in 2D and
    3D of the points and of the patches; for defects and coverage also one layer per facade, in the facade's plane.
    ``.geojson``:
    RFC 7946 with heights. ``.csv``: geometry as WKT. In the last three a list of numbers is JSON text.
    Raises InputDataError for an unsupported suffix, a missing folder, a folder of that name, GeoJSON of a table without
    geometry, a file that another program has open, or one that cannot be read back; an earlier file is then left as it
    was.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise InputDataError(f"cannot write {path.name}: the suffix must be one of {', '.join(FORMATS)}")
    if path.is_dir():
        raise InputDataError(f"cannot write {path}: it is a folder; give the name of a file")
    if not path.parent.is_dir():
        raise InputDataError(f"cannot write {path}: folder {path.parent} does not exist; create it first")
    replace_file(path, lambda file: FORMATS[suffix](name, table, file))
    return path


def _write_parquet(name: str, table: pa.Table, path: Path) -> Mapping[str, int]:
    if GEOMETRY in table.column_names:
        write_geoparquet(geodataframe_from_table(table), path)
    else:
        pq.write_table(order_columns(table), path)
    return {"": len(table)}


def _write_geopackage(name: str, table: pa.Table, path: Path) -> Mapping[str, int]:
    if GEOMETRY not in table.column_names:
        write_attribute_table(table, name, path)
        return {name: len(table)}
    if name == "coverage":
        return write_layers(create_coverage_layers(table), path)
    facades = create_facade_layers(table) if name == "defects" else iter(())
    return write_layers((layer for layers in (create_map_layers(table, name), facades) for layer in layers), path)


def _write_geojson(name: str, table: pa.Table, path: Path) -> Mapping[str, int]:
    if GEOMETRY not in table.column_names:
        raise InputDataError(
            f"table {name} has no geometry and cannot be written as GeoJSON; write .csv, .parquet or .gpkg"
        )
    # RFC 7946 allows one CRS: WGS 84 longitude and latitude, with the ellipsoidal height as third coordinate.
    rows = flatten_table(table)
    if PATCH in table.column_names:
        rows = rows.append_column(f"{PATCH}_wkt", wkt_from_wkb(table, PATCH))
    pyogrio.write_arrow(
        rows.append_column(GEOMETRY, table.column(GEOMETRY)),
        path,
        layer=name,
        driver="GeoJSON",
        geometry_name=GEOMETRY,
        geometry_type="Unknown",
        crs=CRS_2D,
        RFC7946="YES",
        COORDINATE_PRECISION="9",
    )
    return {"": len(table)}


def _write_csv(name: str, table: pa.Table, path: Path) -> Mapping[str, int]:
    rows = flatten_table(table)
    for name in GEOMETRIES:
        if name in table.column_names:
            rows = rows.append_column(f"{name}_wkt", wkt_from_wkb(table, name))
    csv.write_csv(rows, path)
    return {"": len(table)}


FORMATS: dict[str, Callable[[str, pa.Table, Path], Mapping[str, int]]] = {
    ".parquet": _write_parquet,
    ".gpkg": _write_geopackage,
    ".geojson": _write_geojson,
    ".csv": _write_csv,
}
