"""Table ``defects``: one row per defect from its observations, column by column."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import shapely

from facadelake.building import BuildingModel
from facadelake.building.facades import collect_facades
from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Float64Nx3, RowIndices
from facadelake.core.frames import COMPASS, compute_facade_axes
from facadelake.core.tables import check_table, get_stage_schema
from facadelake.deduplication.crack_width import estimate_crack_widths
from facadelake.deduplication.group_statistics import compute_maxima, compute_weighted_medians, find_most_common
from facadelake.deduplication.observations import CLASSES, ObservationArrays, encode_column, read_column
from facadelake.deduplication.position import DefectPositions
from schemas.vocabulary import PositionMethod

_ELEMENT_COLUMNS = ("ifc_class", "element_name", "material")


@dataclass(frozen=True, kw_only=True, eq=False)
class DefectTable:
    """Table ``defects``, and its ``row`` (g,) of each group."""

    table: pa.Table
    row: RowIndices


def build_defects_table(
    registered_rows: pa.Table,
    observations: ObservationArrays,
    group: RowIndices,
    scores: Float64N,
    positions: DefectPositions,
    building: BuildingModel,
    *,
    prefix: str,
) -> DefectTable:
    """Build table ``defects``.

    Sizes are medians over the observations, weighted by how well each shows the defect (cosine of the incidence over
    GSD, squared), a crack's width by its own error. The patch is that of the best observation. Element, storey, facade
    and class are the most common ones.

    Args:
        registered_rows: registered rows (n) of table ``observations``.
        observations: the same as arrays.
        group: group (n,) of each, from 0.
        scores: score (n,) of each detection.
        positions: positions (g) of the groups.
        building: elements and frames.
        prefix: defect ids are ``<prefix>-D0001`` on.
    """
    groups = len(positions.xyz_site_m)
    quality = np.cos(np.radians(read_column(registered_rows, "incidence_deg"))) / read_column(registered_rows, "gsd_mm")
    weight = quality**2
    best = _select_best_observations(group, quality, observations.photo, groups)
    element, guids = encode_column(registered_rows, "element_guid")
    group_element = find_most_common(group, element, quality, groups)
    on_element = element == group_element[group]
    texts = {}
    for name in ("storey", "facade"):
        code, text_values = encode_column(registered_rows, name)
        chosen = find_most_common(group[on_element], code[on_element], quality[on_element], groups)
        texts[name] = pa.array(text_values, pa.string()).take(pa.array(chosen))
    facades = collect_facades(building.elements)
    azimuth_deg = [facades.get_azimuth_deg(name) for name in texts["facade"].to_pylist()]
    classes = find_most_common(group, observations.defect_class, quality, groups)
    sizes = {
        name: compute_weighted_medians(group, read_column(registered_rows, name), weight, groups)
        for name in ("width_m", "height_m", "length_m", "area_m2", "crack_length_m")
    }
    crack_width = estimate_crack_widths(registered_rows, group, weight, groups)
    sizes |= {
        "crack_width_mm": crack_width.width_mm,
        "crack_width_max_mm": crack_width.width_max_mm,
        "crack_width_sigma_mm": crack_width.sigma_mm,
        "crack_width_limit_mm": crack_width.limit_mm,
        "crack_width_blur_mm": crack_width.blur_mm,
    }
    distance = np.linalg.norm(observations.xyz_site_m - positions.xyz_site_m[group], axis=1)
    values: dict[str, Float64Array | pa.Array | RowIndices] = {
        "defect_class": pa.array(CLASSES).take(pa.array(classes)),
        "severity": _repeat_value("ungraded", groups),
        "severity_rule": _repeat_value("none", groups),
        **_split_axes(("x_site_m", "y_site_m", "z_site_m"), positions.xyz_site_m),
        **_split_axes(("normal_x", "normal_y", "normal_z"), positions.normal_site),
        **_split_axes(
            ("sigma_east_m", "sigma_north_m", "sigma_up_m"),
            np.sqrt(np.diagonal(positions.covariance_m2, axis1=1, axis2=2)),
        ),
        "covariance_site": _build_list_array(positions.covariance_m2.reshape(groups, 9)),
        "position_method": pa.array([str(PositionMethod.SURFACE), str(PositionMethod.TRIANGULATED)]).take(
            pa.array(positions.triangulated.astype(np.int64))
        ),
        "deviation_from_model_m": _mask_missing(positions.triangulated, positions.deviation_m),
        "deviation_sigma_m": _mask_missing(positions.triangulated, positions.deviation_sigma_m),
        **{name: _mask_missing(np.isfinite(size), size) for name, size in sizes.items()},
        "crack_width_outcome": crack_width.outcome,
        "spread_m": compute_maxima(group, distance, groups),
        "photo_count": _count_photographs(group, observations.photo, groups),
        "score": compute_maxima(group, scores, groups),
        "best_photo_id": registered_rows.column("photo_id").combine_chunks().take(pa.array(best)),
        "patch": registered_rows.column("patch").combine_chunks().take(pa.array(best)),
        "element_guid": pa.array(guids, pa.string()).take(pa.array(group_element)),
        **texts,
        "facade_azimuth_deg": pa.array(azimuth_deg, pa.float64()),
        **_read_element_columns(building, [guids[i] for i in range(len(guids))], group_element),
        **_build_coordinate_columns(positions.xyz_site_m, building),
    }
    order = _sort_defects(values, positions.xyz_site_m, classes, observations.photo[best])
    ids = pa.array([f"{prefix}-D{row:04d}" for row in range(1, groups + 1)], pa.string())
    schema = get_stage_schema("defects")
    columns = [
        ids
        if field.name == "defect_id"
        else _cast_array(values[field.name], field.type).take(pa.array(order))
        if field.name in values
        else pa.nulls(groups, field.type)
        for field in schema
    ]
    row = np.empty(groups, dtype=np.int64)
    row[order] = np.arange(groups)
    return DefectTable(table=check_table("defects", pa.Table.from_arrays(columns, schema=schema)), row=row)


def _select_best_observations(group: RowIndices, quality: Float64N, photo: RowIndices, groups: int) -> RowIndices:
    """The best observation of each group; of equally good ones that of the last photograph.

    Args:
        group: group (n,) of each observation.
        quality: quality (n,) of each observation.
        photo: photograph (n,) of each observation.
        groups: number of groups.

    Returns:
        Rows (groups,).
    """
    order = np.lexsort((-photo, -quality, group))
    best = np.full(groups, -1, dtype=np.int64)
    selected = order[np.r_[True, np.diff(group[order]) != 0][: len(order)]]
    best[group[selected]] = selected
    return best


def _count_photographs(group: RowIndices, photo: RowIndices, groups: int) -> RowIndices:
    """Number (groups,) of photographs that show each group."""
    photo_count = int(photo.max(initial=0)) + 1
    pairs = np.unique(group * photo_count + photo)
    return np.bincount(pairs // photo_count, minlength=groups).astype(np.int64)


def _read_element_columns(building: BuildingModel, guids: list[str | None], element: RowIndices) -> dict[str, pa.Array]:
    """Columns of the elements ``element`` (g,), indices into ``guids``."""
    rows = {guid: i for i, guid in enumerate(building.elements.column("element_guid").to_pylist())}
    element_row = np.array([rows[str(guid)] for guid in guids], dtype=np.int64)[element]
    return {
        name: building.elements.column(name).combine_chunks().take(pa.array(element_row)) for name in _ELEMENT_COLUMNS
    }


def _build_coordinate_columns(xyz_site_m: Float64Nx3, building: BuildingModel) -> dict[str, Float64Array | pa.Array]:
    """The positions (g, 3) in EPSG:4979 and in the map CRS, transformed in one call."""
    if len(xyz_site_m) == 0:
        geo = on_map = np.zeros((0, 3))
    else:
        geo, on_map = building.origin.geo_from_site(xyz_site_m), building.map_from_site(xyz_site_m)
    return {
        **_split_axes(("lon_deg", "lat_deg", "height_ellipsoidal_m"), geo),
        **_split_axes(("east_map_m", "north_map_m", "height_map_m"), on_map),
        "geometry": pa.array(shapely.to_wkb(shapely.points(geo), output_dimension=3), pa.binary()),
    }


def _sort_defects(
    values: dict[str, Float64Array | pa.Array | RowIndices],
    xyz_site_m: Float64Nx3,
    classes: RowIndices,
    photo: RowIndices,
) -> RowIndices:
    """Order of the defects: by facade, storey from the top, position along the facade from the left, and height.

    Args:
        values: columns of the defects.
        xyz_site_m: their positions (g, 3).
        classes: codes (g,) of their classes.
        photo: codes (g,) of their best photographs.

    Returns:
        Groups in the order of the table.
    """
    if len(xyz_site_m) == 0:
        return np.zeros(0, dtype=np.int64)
    facade_text, storey_text = pa.array(values["facade"]), pa.array(values["storey"])
    encoded = pc.dictionary_encode(facade_text)
    indices, facades = encoded.indices.to_numpy(), encoded.dictionary.to_pylist()
    ranks = {facade: rank for rank, facade in enumerate(sorted(facades, key=_rank_facade))}
    rank = np.array([ranks[facade] for facade in facades], dtype=np.int64)[indices]
    storey, names = encode_column(pa.table({"storey": storey_text}), "storey")
    storey_height = compute_weighted_medians(storey, xyz_site_m[:, 2], np.ones(len(storey)), len(names))
    azimuth_deg = pa.array(values["facade_azimuth_deg"]).fill_null(0.0).to_numpy(zero_copy_only=False)
    right = np.array([compute_facade_axes(azimuth)[0] for azimuth in azimuth_deg])
    along = np.einsum("gi,gi->g", right, xyz_site_m)
    height = -np.round(xyz_site_m[:, 2], 3)
    order: RowIndices = np.lexsort((photo, classes, height, np.round(along, 3), storey, -storey_height[storey], rank))
    return order


def _rank_facade(facade: str) -> tuple[int, float, str]:
    """Sort key of a facade: compass point, bearing in degrees, name; "N" first, "level" and the like last.

    Where two facades face one compass point their names state the bearing ("E-075").
    """
    point, _, degrees = facade.partition("-")
    if point not in COMPASS:
        return len(COMPASS), 0.0, facade
    sector = COMPASS.index(point)
    return sector, float(degrees) if degrees else 45.0 * sector, facade


def _repeat_value(value: str, count: int) -> pa.Array:
    """A text column (count,) of one value."""
    return pa.array([value], pa.string()).take(pa.array(np.zeros(count, dtype=np.int64)))


def _split_axes(names: tuple[str, str, str], values: Float64Array) -> dict[str, Float64Array]:
    """The columns of ``values`` (g, 3) by their names."""
    return {name: values[:, axis] for axis, name in enumerate(names)}


def _build_list_array(values: Float64Array) -> pa.Array:
    """Rows of ``values`` (g, k) as lists."""
    offsets = np.arange(0, values.size + 1, values.shape[1], dtype=np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(values.ravel()))


def _mask_missing(kept: BoolArray, values: Float64Array) -> pa.Array:
    """``values`` (g,), empty where not ``kept``."""
    return pa.array(values, mask=~kept)


def _cast_array(values: Float64Array | pa.Array | RowIndices, arrow_type: pa.DataType) -> pa.Array:
    """``values`` as an Arrow array of ``arrow_type``."""
    return pa.array(values, arrow_type) if isinstance(values, np.ndarray) else values.cast(arrow_type)
