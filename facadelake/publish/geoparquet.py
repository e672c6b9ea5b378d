"""Tables with points or polygons as GeoParquet 1.1, in 3D and as a 2D twin; patches are a second geometry column."""

from __future__ import annotations

from pathlib import Path

import geopandas as gpd
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import shapely

from facadelake.publish.columns import GEOMETRIES, GEOMETRY, decode_geometries, order_columns
from schemas.column import GEO_CRS

CRS_3D = GEO_CRS  # longitude, latitude, ellipsoidal height
CRS_2D = "EPSG:4326"  # the same without the height


def geodataframe_from_table(table: pa.Table) -> gpd.GeoDataFrame:
    """The rows as points or polygons in EPSG:4979 (WKB column ``geometry``), columns ``order_columns``.

    A column ``patch`` becomes a second geometry. Types stay those of Arrow, so that an empty text or number is null
    and not "" or NaN.
    """
    rows = order_columns(table)
    held = [name for name in GEOMETRIES if name in rows.column_names]
    values = rows.drop_columns(held).to_pandas(types_mapper=pd.ArrowDtype)
    for name in held:
        values[name] = gpd.GeoSeries(decode_geometries(rows, name), index=values.index, crs=CRS_3D)
    return gpd.GeoDataFrame(values, geometry=GEOMETRY)


def drop_heights(rows: gpd.GeoDataFrame) -> gpd.GeoDataFrame:
    """The 2D twin in EPSG:4326, for programs that know no heights; the height stays as a column where there is one."""
    twin = rows.copy()
    for name in GEOMETRIES:
        if name in rows.columns:
            twin[name] = gpd.GeoSeries(shapely.force_2d(rows[name].values), index=rows.index, crs=CRS_2D)
    return twin.set_geometry(GEOMETRY)


def write_geoparquet(rows: gpd.GeoDataFrame, path: Path) -> None:
    """GeoParquet 1.1 with the CRS as PROJJSON and a bbox column, compressed by Snappy, which every reader knows.

    What pandas notes beside the columns is left out: it names Arrow's list types in a way that neither pandas nor
    GeoPandas can read back (pandas 3.1).
    """
    rows.to_parquet(
        path,
        index=False,
        schema_version="1.1.0",
        write_covering_bbox=True,
        geometry_encoding="WKB",
    )
    table = pq.ParquetFile(path).read()
    noted = {key: value for key, value in (table.schema.metadata or {}).items() if key != b"pandas"}
    pq.write_table(table.replace_schema_metadata(noted), path, compression="snappy")
