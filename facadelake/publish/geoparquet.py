"""Tables with points or polygons as GeoParquet 1.1, in 3D and as a 2D twin."""

from __future__ import annotations

from pathlib import Path

import geopandas as gpd
import pandas as pd
import pyarrow as pa
import shapely

from schemas.columns import GEO_CRS
from schemas.tables import RUN_KEYS

CRS_3D = GEO_CRS  # longitude, latitude, ellipsoidal height
CRS_2D = "EPSG:4326"  # the same without the height
GEOMETRY = "geometry"
# What a person wants to see first in an attribute table; the other columns follow in the order of schemas/.
FIRST = (
    "defect_id", "detection_id", "defect_class", "severity", "width_m", "height_m", "area_m2", "sightings", "score",
    "storey", "facade", "ifc_class", "element_name", "material", "element_guid", "photo_id", "best_photo_id",
)  # fmt: skip


def ordered(table: pa.Table) -> pa.Table:
    """The columns in a reader's order: what it is, how large, on what, where, then the run's keys; geometry last."""
    names = [name for name in table.column_names if name != GEOMETRY]
    first = [name for name in FIRST if name in names]
    rest = [name for name in names if name not in (*first, *RUN_KEYS)]
    keys = [name for name in RUN_KEYS if name in names]
    last = [GEOMETRY] if GEOMETRY in table.column_names else []
    return table.select([*first, *rest, *keys, *last])


def frame(table: pa.Table) -> gpd.GeoDataFrame:
    """The rows as points or polygons in EPSG:4979 (WKB column ``geometry``), columns ``ordered``.

    Types stay those of Arrow, so that an empty text or number is null and not "" or NaN.
    """
    plain = ordered(table).drop_columns([GEOMETRY]).to_pandas(types_mapper=pd.ArrowDtype)
    geometry = shapely.from_wkb(table.column(GEOMETRY).to_numpy())
    return gpd.GeoDataFrame(plain, geometry=gpd.GeoSeries(geometry, index=plain.index, crs=CRS_3D))


def flat(rows: gpd.GeoDataFrame) -> gpd.GeoDataFrame:
    """The 2D twin in EPSG:4326, for programs that know no heights; the height stays as a column where there is one."""
    return rows.set_geometry(gpd.GeoSeries(shapely.force_2d(rows.geometry.values), index=rows.index, crs=CRS_2D))


def write_geoparquet(rows: gpd.GeoDataFrame, path: Path) -> None:
    """GeoParquet 1.1 with the CRS as PROJJSON and a bbox column, compressed by Snappy, which every reader knows."""
    rows.to_parquet(
        path,
        index=False,
        compression="snappy",
        schema_version="1.1.0",
        write_covering_bbox=True,
        geometry_encoding="WKB",
    )
