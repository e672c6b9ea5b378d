"""Tables with points or polygons as GeoParquet 1.1, in 3D and in 2D; patches are a second geometry column."""

from __future__ import annotations

import json
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import shapely

from facadelake.publish.columns import GEOMETRIES, GEOMETRY, decode_geometries, order_columns
from schemas.column_type import GEO_CRS

CRS_3D = GEO_CRS  # longitude, latitude, ellipsoidal height
CRS_2D = "EPSG:4326"  # longitude and latitude only
_SIDES = ("xmin", "ymin", "xmax", "ymax")


def geodataframe_from_table(table: pa.Table) -> gpd.GeoDataFrame:
    """The rows as points or polygons in EPSG:4979 (WKB column ``geometry``), in published column order.

    A column ``patch`` becomes a second geometry column. Arrow types are kept, so that a missing text or number stays
    null and does not become "" or NaN.
    """
    rows = order_columns(table)
    geometries = [name for name in GEOMETRIES if name in rows.column_names]
    values = rows.drop_columns(geometries).to_pandas(types_mapper=pd.ArrowDtype)
    for name in geometries:
        values[name] = gpd.GeoSeries(decode_geometries(rows, name), index=values.index, crs=CRS_3D)
    return gpd.GeoDataFrame(values, geometry=GEOMETRY)


def drop_heights(rows: gpd.GeoDataFrame) -> gpd.GeoDataFrame:
    """A copy in EPSG:4326 (2D), for programs without support of 3D CRSs; height columns are kept."""
    flat = rows.copy()
    for name in GEOMETRIES:
        if name in rows.columns:
            flat[name] = gpd.GeoSeries(shapely.force_2d(rows[name].values), index=rows.index, crs=CRS_2D)
    return flat.set_geometry(GEOMETRY)


def _bound(geometries: gpd.GeoSeries) -> pa.StructArray:
    """Bounding boxes of a column; null where there is no geometry."""
    bounds = shapely.bounds(geometries.values)
    missing = pa.array(np.isnan(bounds[:, 0]))
    return pa.StructArray.from_arrays([pa.array(side) for side in bounds.T], names=list(_SIDES), mask=missing)


def write_geoparquet(rows: gpd.GeoDataFrame, path: Path) -> None:
    """Write GeoParquet 1.1 with the CRS as PROJJSON and bbox columns, compressed with Snappy for compatibility.

    ``bbox`` covers the geometry, ``patch_bbox`` the patch: GeoPandas writes ``bbox`` alone and declares it as the
    covering of every geometry column, by which a filter of patches would lose rows.
    The ``pandas`` key of the file's metadata is removed: it names Arrow's list types in a form that pandas 3.1 and
    GeoPandas cannot read back.
    """
    rows.to_parquet(
        path,
        index=False,
        schema_version="1.1.0",
        write_covering_bbox=True,
        geometry_encoding="WKB",
    )
    table = pq.ParquetFile(path).read()
    metadata = {key: value for key, value in (table.schema.metadata or {}).items() if key != b"pandas"}
    geo = json.loads(metadata[b"geo"])
    for name, column in geo["columns"].items():
        if name != geo["primary_column"]:
            bbox = f"{name}_bbox"
            table = table.append_column(bbox, _bound(rows[name]))
            column["covering"] = {"bbox": {side: [bbox, side] for side in _SIDES}}
    metadata[b"geo"] = json.dumps(geo).encode()
    pq.write_table(table.replace_schema_metadata(metadata), path, compression="snappy")
