"""The columns of a published table: in a reader's order, and as plain values for formats without lists."""

from __future__ import annotations

import json

import numpy as np
import pyarrow as pa
import shapely

from schemas.tables import RUN_KEYS

GEOMETRY = "geometry"  # the position (or the footprint), a file's own geometry
PATCH = "patch"  # the outline on the surface: a second geometry, which most formats cannot hold
GEOMETRIES = (PATCH, GEOMETRY)
# What a person wants to see first in an attribute table; the other columns follow in the order of schemas/.
FIRST = (
    "defect_id", "detection_id", "defect_class", "severity", "width_m", "height_m", "length_m", "crack_width_mm",
    "crack_width_sigma_mm", "crack_width_limit_mm", "crack_width_outcome", "area_m2", "photo_count", "score", "storey",
    "facade", "ifc_class", "element_name", "material", "element_guid", "photo_id", "best_photo_id",
)  # fmt: skip


def order_columns(table: pa.Table) -> pa.Table:
    """The columns in a reader's order: what it is, how large, on what, where, then the run's keys; geometries last."""
    names = [name for name in table.column_names if name not in GEOMETRIES]
    first = [name for name in FIRST if name in names]
    rest = [name for name in names if name not in (*first, *RUN_KEYS)]
    keys = [name for name in RUN_KEYS if name in names]
    return table.select([*first, *rest, *keys, *(name for name in GEOMETRIES if name in table.column_names)])


def flatten_table(table: pa.Table) -> pa.Table:
    """The columns ``order_columns`` without geometries; a list of numbers becomes JSON text, for CSV and GDAL."""
    rows = order_columns(table)
    for number, field in enumerate(rows.schema):
        if pa.types.is_list(field.type):
            texts = [None if value is None else json.dumps(value) for value in rows.column(number).to_pylist()]
            rows = rows.set_column(number, field.name, pa.array(texts, pa.string()))
    return rows.drop_columns([name for name in GEOMETRIES if name in rows.column_names])


def decode_geometries(table: pa.Table, column: str) -> np.ndarray:
    """The geometries of a WKB column, None where it is empty."""
    found: np.ndarray = shapely.from_wkb(table.column(column).to_numpy())
    return found


def wkt_from_wkb(table: pa.Table, column: str) -> pa.Array:
    """A WKB column as text, to 1e-9 degrees (0.1 mm) and 1e-9 m."""
    return pa.array(shapely.to_wkt(decode_geometries(table, column), rounding_precision=9), pa.string())
