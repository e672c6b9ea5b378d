"""Columns of a published table: their order, and values for formats without lists."""

from __future__ import annotations

import json

import numpy as np
import pyarrow as pa
import shapely

from schemas.tables import RUN_KEYS

GEOMETRY = "geometry"  # the position (of an element: its footprint), the primary geometry of a file
PATCH = "patch"  # the outline on the surface: a second geometry, which most formats do not support
GEOMETRIES = (PATCH, GEOMETRY)
# First columns of an attribute table; the others follow in the order of schemas/.
FIRST = (
    "track_id", "track_state", "state_evidence", "defect_id", "detection_id", "defect_class", "severity",
    "severity_low", "severity_high", "width_m", "height_m",
    "length_m", "crack_width_mm", "crack_width_sigma_mm", "crack_width_blur_mm", "crack_width_limit_mm",
    "crack_width_outcome", "area_m2", "photo_count", "score", "storey", "facade", "ifc_class",
    "element_name", "material", "element_guid", "photo_id", "best_photo_id", "best_photo_uri", "captured_at",
    "captured_from", "captured_to",
)  # fmt: skip


def order_columns(table: pa.Table) -> pa.Table:
    """The table with its columns in published order: class and size, element, position, keys of the run, geometries."""
    names = [name for name in table.column_names if name not in GEOMETRIES]
    first = [name for name in FIRST if name in names]
    rest = [name for name in names if name not in (*first, *RUN_KEYS)]
    keys = [name for name in RUN_KEYS if name in names]
    return table.select([*first, *rest, *keys, *(name for name in GEOMETRIES if name in table.column_names)])


def flatten_table(table: pa.Table) -> pa.Table:
    """The table in published column order without geometries; lists of numbers become JSON text, for CSV and GDAL."""
    rows = order_columns(table)
    for index, field in enumerate(rows.schema):
        if pa.types.is_list(field.type):
            texts = [None if value is None else json.dumps(value) for value in rows.column(index).to_pylist()]
            rows = rows.set_column(index, field.name, pa.array(texts, pa.string()))
    return rows.drop_columns([name for name in GEOMETRIES if name in rows.column_names])


def decode_geometries(table: pa.Table, column: str) -> np.ndarray:
    """Geometries (n,) of a WKB column; None where it is null."""
    geometries: np.ndarray = shapely.from_wkb(table.column(column).to_numpy())
    return geometries


def wkt_from_wkb(table: pa.Table, column: str) -> pa.Array:
    """A WKB column as WKT, rounded to 1e-9 degrees (0.1 mm) and 1e-9 m."""
    return pa.array(shapely.to_wkt(decode_geometries(table, column), rounding_precision=9), pa.string())
