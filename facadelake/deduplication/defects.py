"""One row a defect from its sightings, as whole columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import shapely

from facadelake.building import BuildingModel
from facadelake.building.facades import COMPASS
from facadelake.core.arrays import BoolArray, Float64Array, Int64Array, RowIndices
from facadelake.core.tables import check_table, get_stage_schema
from facadelake.deduplication.crack_width import estimate_crack_widths
from facadelake.deduplication.group_statistics import compute_maxima, compute_weighted_medians, find_most_common
from facadelake.deduplication.observations import CLASSES, ObservationArrays, encode_column, read_column
from facadelake.deduplication.position import DefectPositions
from schemas.vocabulary import PositionMethod

_ELEMENT_COLUMNS = ("ifc_class", "element_name", "material")


@dataclass(frozen=True, kw_only=True, eq=False)
class DefectTable:
    """Table ``defects`` in its order, and the place (g,) that each group has in it."""

    table: pa.Table
    row: RowIndices


def build_defects_table(
    seen: pa.Table,
    sightings: ObservationArrays,
    group: RowIndices,
    scores: Float64Array,
    positions: DefectPositions,
    building: BuildingModel,
    *,
    prefix: str,
) -> DefectTable:
    """The defects of registered rows ``seen`` (n,) in ``group`` (n,), named ``<prefix>-D0001`` on.

    ``scores`` (n,) are the detections'. Sizes are medians over the sightings, weighted by how well each shows the
    defect (cosine of the incidence over GSD, squared), a crack's width by its own error; the outline is the best
    sighting's. Element, storey and facade are voted on.
    """
    groups = len(positions.xyz_site_m)
    quality = np.cos(np.radians(read_column(seen, "incidence_deg"))) / read_column(seen, "gsd_mm")
    weight = quality**2
    best = _select_best_observations(group, quality, sightings.photo, groups)
    element, guids = encode_column(seen, "element_guid")
    voted = find_most_common(group, element, quality, groups)
    own = element == voted[group]
    texts = {}
    for name in ("storey", "facade"):
        code, words = encode_column(seen, name)
        chosen = find_most_common(group[own], code[own], quality[own], groups)
        texts[name] = pa.array(words, pa.string()).take(pa.array(chosen))
    classes = find_most_common(group, sightings.defect_class, quality, groups)
    sizes = {
        name: compute_weighted_medians(group, read_column(seen, name), weight, groups)
        for name in ("width_m", "height_m", "length_m", "area_m2", "crack_length_m")
    }
    crack = estimate_crack_widths(seen, group, weight, groups)
    sizes |= {
        "crack_width_mm": crack.width_mm,
        "crack_width_max_mm": crack.width_max_mm,
        "crack_width_sigma_mm": crack.sigma_mm,
        "crack_width_limit_mm": crack.limit_mm,
    }
    gap = np.linalg.norm(sightings.xyz_site_m - positions.xyz_site_m[group], axis=1)
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
        "crack_width_outcome": crack.outcome,
        "spread_m": compute_maxima(group, gap, groups),
        "photo_count": _count_photographs(group, sightings.photo, groups),
        "score": compute_maxima(group, scores, groups),
        "best_photo_id": seen.column("photo_id").combine_chunks().take(pa.array(best)),
        "patch": seen.column("patch").combine_chunks().take(pa.array(best)),
        "element_guid": pa.array(guids, pa.string()).take(pa.array(voted)),
        **texts,
        **_read_element_columns(building, [guids[i] for i in range(len(guids))], voted),
        **_build_coordinate_columns(positions.xyz_site_m, building),
    }
    order = _sort_defects(values, positions.xyz_site_m, classes, sightings.photo[best])
    names = pa.array([f"{prefix}-D{place:04d}" for place in range(1, groups + 1)], pa.string())
    schema = get_stage_schema("defects")
    made = [
        names
        if field.name == "defect_id"
        else _cast_array(values[field.name], field.type).take(pa.array(order))
        if field.name in values
        else pa.nulls(groups, field.type)
        for field in schema
    ]
    place = np.empty(groups, dtype=np.int64)
    place[order] = np.arange(groups)
    return DefectTable(table=check_table("defects", pa.Table.from_arrays(made, schema=schema)), row=place)


def _select_best_observations(group: RowIndices, quality: Float64Array, photo: RowIndices, groups: int) -> RowIndices:
    """Row (groups,) of each group's best sighting; of equally good ones that of the last photograph."""
    order = np.lexsort((-photo, -quality, group))
    best = np.full(groups, -1, dtype=np.int64)
    leads = order[np.r_[True, np.diff(group[order]) != 0][: len(order)]]
    best[group[leads]] = leads
    return best


def _count_photographs(group: RowIndices, photo: RowIndices, groups: int) -> RowIndices:
    """How many photographs (groups,) show each group."""
    several = int(photo.max(initial=0)) + 1
    pairs = np.unique(group * several + photo)
    return np.bincount(pairs // several, minlength=groups).astype(np.int64)


def _read_element_columns(building: BuildingModel, guids: list[str | None], voted: RowIndices) -> dict[str, pa.Array]:
    rows = {guid: i for i, guid in enumerate(building.elements.column("element_guid").to_pylist())}
    at = np.array([rows[str(guid)] for guid in guids], dtype=np.int64)[voted]
    return {name: building.elements.column(name).combine_chunks().take(pa.array(at)) for name in _ELEMENT_COLUMNS}


def _build_coordinate_columns(xyz_site_m: Float64Array, building: BuildingModel) -> dict[str, Float64Array | pa.Array]:
    """The places in EPSG:4979 and on the map, all converted at once."""
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
    xyz_site_m: Float64Array,
    classes: RowIndices,
    photo: RowIndices,
) -> Int64Array:
    """Rows of the defects by facade, storey from the top, then along the facade as seen from outside, and height."""
    if len(xyz_site_m) == 0:
        return np.zeros(0, dtype=np.int64)
    facade_text, storey_text = pa.array(values["facade"]), pa.array(values["storey"])
    encoded = pc.dictionary_encode(facade_text)
    indices, words = encoded.indices.to_numpy(), encoded.dictionary.to_pylist()
    place = {word: number for number, word in enumerate(sorted(words, key=_rank_facade))}
    number = np.array([place[word] for word in words], dtype=np.int64)[indices]
    storey, names = encode_column(pa.table({"storey": storey_text}), "storey")
    level = compute_weighted_medians(storey, xyz_site_m[:, 2], np.ones(len(storey)), len(names))
    # Who stands before a wall that faces north has west to the right.
    angle = np.radians([_rank_facade(word)[1] for word in words])[indices]
    along = -np.cos(angle) * xyz_site_m[:, 0] + np.sin(angle) * xyz_site_m[:, 1]
    height = -np.round(xyz_site_m[:, 2], 3)
    order: Int64Array = np.lexsort((photo, classes, height, np.round(along, 3), storey, -level[storey], number))
    return order


def _rank_facade(facade: str) -> tuple[int, float, str]:
    """What puts facades in order, "N" first and "level" and the like last: compass point, bearing in degrees, name.

    Where two facades look to one point their names tell the bearing ("E-075").
    """
    point, _, degrees = facade.partition("-")
    if point not in COMPASS:
        return len(COMPASS), 0.0, facade
    sector = COMPASS.index(point)
    return sector, float(degrees) if degrees else 45.0 * sector, facade


def _repeat_value(word: str, count: int) -> pa.Array:
    return pa.array([word], pa.string()).take(pa.array(np.zeros(count, dtype=np.int64)))


def _split_axes(names: tuple[str, str, str], values: Float64Array) -> dict[str, Float64Array]:
    return {name: values[:, axis] for axis, name in enumerate(names)}


def _build_list_array(values: Float64Array) -> pa.Array:
    offsets = np.arange(0, values.size + 1, values.shape[1], dtype=np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(values.ravel()))


def _mask_missing(kept: BoolArray, values: Float64Array) -> pa.Array:
    return pa.array(values, mask=~kept)


def _cast_array(values: Float64Array | pa.Array | RowIndices, kind: pa.DataType) -> pa.Array:
    return pa.array(values, kind) if isinstance(values, np.ndarray) else values.cast(kind)
