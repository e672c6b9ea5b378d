"""Tables as GeoPackage layers: points and patches in 2D and 3D, and one layer per facade in the facade's plane.

In plan view a facade is a line; therefore each facade has a layer in its own plane, in frame ``facade``: u in metres to
the right as seen from outside, v in metres up, both from the site's origin. A defect is drawn as its patch, or as a box
of its extents, true to size about its position: where the wall turns away from the facade's plane, as at a round
corner, the outline is not foreshortened.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyogrio
import shapely

from facadelake.core.arrays import Float64Array, Float64Nx3, Int64Array
from facadelake.core.frames import axes_from_normal, facade_from_site
from facadelake.core.geodesy import SiteOrigin
from facadelake.publish.columns import FIRST, GEOMETRY, PATCH, decode_geometries, flatten_table
from facadelake.publish.coverage_styles import create_coverage_style
from facadelake.publish.geoparquet import CRS_2D, CRS_3D
from schemas.tables import RUN_KEYS

_POINT, _POLYGON, _MULTIPOLYGON = 0, 3, 6  # shapely's numbers of the types
_MIXED = "Unknown"  # GDAL's type of a layer of several types, with or without heights
_AZIMUTH_DECIMALS = 2  # of degrees: 9 mm over 50 m
# Attributes of the cells, of which there are many; coverage.parquet has all columns.
_COVERAGE_COLUMNS = [
    "coverage_outcome", "imaged_count", "searched_count", "hidden_share", "gsd_mm", "incidence_deg", "blur_px",
    "found_crack_width_mm", "found_patch_mm", "area_m2", "facade", "storey", "element_guid", "cell_column", "cell_row",
    "cell_layer", "best_photo_id", "campaign_id",
]  # fmt: skip
STYLES = "layer_styles"
LEVEL = "level"  # roofs, floors and soffits: plan view, u east and v north


@dataclass(frozen=True, kw_only=True)
class GisLayer:
    """A GeoPackage layer; ``geometry`` holds one WKB per row, of the GDAL type ``geometry_type``.

    ``style``: QML, with which QGIS draws it.
    """

    name: str
    rows: pa.Table
    geometry: list[bytes | None]
    geometry_type: str
    crs: str
    style: str | None = None


def create_plane_crs(facade: str) -> str:
    """Engineering CRS (WKT 2, ISO 19162) of a facade's plane, so that its metres are not taken for map coordinates."""
    u, v = ("east", "north") if facade == LEVEL else ("to the right as seen from outside", "up")
    return (
        f'ENGCRS["facade {facade}: u {u}, v {v}",EDATUM["site origin"],CS[Cartesian,2],'
        'AXIS["u",unspecified],AXIS["v",unspecified],LENGTHUNIT["metre",1]]'
    )


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
    geometries, geometry_type = _unify_types(decode_geometries(rows, column))
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
            geometry_type=geometry_type if geometry_type == _MIXED else f"{geometry_type} Z",
            crs=CRS_3D,
        )


def create_facade_layers(defects: pa.Table, prefix: str = "facade") -> Iterator[GisLayer]:
    """One layer per facade of one building, such as facade_N: outlines of defects, or tracks, in the facade's plane
    (u, v in metres).

    A facade whose azimuth differs between campaigns, because the model was changed, has a layer for each.
    """
    for name, azimuth_deg, rows in _divide_by_plane(defects):
        polygons, geometry_type = _unify_types(_create_outlines(rows, azimuth_deg))
        yield GisLayer(
            name=f"{prefix}_{name}",
            rows=rows,
            geometry=_wkb_from_geometries(polygons),
            geometry_type=geometry_type,
            crs=create_plane_crs(name),
        )


def create_coverage_layers(coverage: pa.Table) -> Iterator[GisLayer]:
    """The cells of coverage: ``coverage_3d`` on the surface, and one layer per facade in the facade's plane.

    There is no layer in plan view, where the cells of a wall are lines.
    """
    if not len(coverage):
        return
    attributes, style = coverage.select(_COVERAGE_COLUMNS), create_coverage_style(coverage)
    yield GisLayer(
        name="coverage_3d",
        rows=attributes,
        geometry=_wkb_from_geometries(decode_geometries(coverage, GEOMETRY)),
        geometry_type="Polygon Z",
        crs=CRS_3D,
        style=style,
    )
    for name, _, rows in _divide_by_plane(coverage):
        u_min, u_max, v_min, v_max = _collect_columns(rows, "u_min_m", "u_max_m", "v_min_m", "v_max_m").T
        yield GisLayer(
            name=f"coverage_{name}",
            rows=rows.select(_COVERAGE_COLUMNS),
            geometry=_wkb_from_geometries(shapely.box(u_min, v_min, u_max, v_max)),
            geometry_type="Polygon",
            crs=create_plane_crs(name),
            style=style,
        )


def _divide_by_plane(rows: pa.Table) -> Iterator[tuple[str, float | None, pa.Table]]:
    """The rows of each facade's plane, with the name of its layer and its azimuth (None: plan view)."""
    # Interior surfaces (facade "inside") have no exterior view.
    azimuths = pc.round(rows.column("facade_azimuth_deg"), _AZIMUTH_DECIMALS)
    planes = dict.fromkeys(zip(rows.column("facade").to_pylist(), azimuths.to_pylist(), strict=True))
    named = Counter(facade for facade, _ in planes)
    for facade, azimuth_deg in sorted(planes, key=lambda plane: (plane[0], plane[1] or 0.0)):
        if azimuth_deg is None and facade != LEVEL:
            continue
        same_plane = pc.is_null(azimuths) if azimuth_deg is None else pc.equal(azimuths, azimuth_deg)
        own = rows.filter(pc.and_(pc.equal(rows.column("facade"), facade), same_plane))
        yield facade if named[facade] == 1 else f"{facade}_{azimuth_deg:.2f}", azimuth_deg, own


def _collect_columns(rows: pa.Table, *names: str) -> Float64Array:
    return np.column_stack([rows.column(name).to_numpy() for name in names])


def _create_outlines(rows: pa.Table, azimuth_deg: float | None) -> np.ndarray:
    """Outlines in a facade's plane; ``azimuth_deg`` None: in plan view, u east and v north.

    A vertex is placed relative to its own defect's position, by its offsets to the right and up on the surface.
    """
    xyz_site_m = _collect_columns(rows, "x_site_m", "y_site_m", "z_site_m")
    uv = (xyz_site_m if azimuth_deg is None else facade_from_site(xyz_site_m, azimuth_deg))[:, :2]
    half_width, half_height = _collect_columns(rows, "width_m", "height_m").T / 2
    boxes: np.ndarray = shapely.box(
        uv[:, 0] - half_width, uv[:, 1] - half_height, uv[:, 0] + half_width, uv[:, 1] + half_height
    )
    if PATCH not in rows.column_names:
        return boxes
    patches = decode_geometries(rows, PATCH)
    vertices_geo, row = shapely.get_coordinates(patches, include_z=True, return_index=True)
    normals = _collect_columns(rows, "normal_x", "normal_y", "normal_z")
    # "Up" on a floor or a roof is not up; in plan view all offsets are east and north.
    axes = np.array([np.eye(3) if azimuth_deg is None else axes_from_normal(normal) for normal in normals])
    offset_m = _measure_offsets(rows, vertices_geo, row)
    flat = np.einsum("nij,nj->ni", axes[row], offset_m)[:, :2] + uv[row]
    projected = shapely.set_coordinates(shapely.force_2d(patches), flat)
    outlines: np.ndarray = np.where(shapely.is_missing(patches), boxes, projected)
    return outlines


def _measure_offsets(rows: pa.Table, vertices_geo: Float64Nx3, row: Int64Array) -> Float64Nx3:
    """Vertices (n, 3) of the patches of ``row`` (n,) from their defects' positions: east, north and up in metres.

    The axes of the first defect are used for all: across a building the axes differ by 1e-5 rad, which is 0.05 mm over
    a patch of 5 m.
    """
    position_geo = _collect_columns(rows, "lon_deg", "lat_deg", "height_ellipsoidal_m")
    lon_deg, lat_deg, height_m = position_geo[0]
    local = SiteOrigin(lon_deg=lon_deg, lat_deg=lat_deg, height_ellipsoidal_m=height_m)
    offsets: Float64Nx3 = local.site_from_geo(vertices_geo) - local.site_from_geo(position_geo)[row]
    return offsets


def write_layers(layers: Iterator[GisLayer], path: Path) -> dict[str, int]:
    """Write a new GeoPackage with the layers in the given order, and return their numbers of rows by name.

    GIS programs open the first one by default. Styles are rows of a table ``layer_styles``, as QGIS writes them.
    """
    path.unlink(missing_ok=True)
    rows = {}
    styles = {}
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
        rows[layer.name] = len(layer.rows)
        if layer.style is not None:
            styles[layer.name] = layer.style
    if styles:
        _write_styles(styles, path)
        rows[STYLES] = len(styles)
    return rows


def _write_styles(styles: Mapping[str, str], path: Path) -> None:
    """Add the table of default styles (QML by layer) that QGIS looks for in a GeoPackage."""
    count = len(styles)
    table = pa.table(
        {
            "f_table_catalog": [""] * count,
            "f_table_schema": [""] * count,
            "f_table_name": list(styles),
            "f_geometry_column": [GEOMETRY] * count,
            "styleName": list(styles),
            "styleQML": list(styles.values()),
            "styleSLD": [""] * count,
            "useAsDefault": [True] * count,
            "description": list(styles),
            "owner": [""] * count,
            "ui": [""] * count,
            "update_time": pa.array([datetime.now(UTC)] * count, pa.timestamp("ms", tz="UTC")),
        }
    )
    options = {"layer": STYLES, "driver": "GPKG", "geometry_name": None, "geometry_type": None, "append": True}
    pyogrio.write_arrow(table, path, **options, FID="id")


def write_attribute_table(table: pa.Table, name: str, path: Path) -> None:
    """Write a new GeoPackage with one attribute table, without geometry."""
    path.unlink(missing_ok=True)
    pyogrio.write_arrow(flatten_table(table), path, layer=name, driver="GPKG", geometry_name=None, geometry_type=None)


def _unify_types(geometries: np.ndarray) -> tuple[np.ndarray, str]:
    """The geometries, polygons among multipolygons as such, and GDAL's name of their common type.

    Readers expect one type in a layer. An outline that a window divides is a multipolygon.
    """
    types = {shapely.get_type_id(geometry) for geometry in geometries if geometry is not None}
    if types == {_POLYGON, _MULTIPOLYGON}:
        geometries = np.array(
            [
                shapely.MultiPolygon([geometry]) if shapely.get_type_id(geometry) == _POLYGON else geometry
                for geometry in geometries
            ],
            dtype=object,
        )
        types = {_MULTIPOLYGON}
    names = {_POINT: "Point", _POLYGON: "Polygon", _MULTIPOLYGON: "MultiPolygon"}
    return geometries, names.get(types.pop(), _MIXED) if len(types) == 1 else _MIXED


def _wkb_from_geometries(geometries: np.ndarray) -> list[bytes | None]:
    return list(shapely.to_wkb(geometries))
