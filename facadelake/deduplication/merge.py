"""Observations to defects: every real defect once."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import shapely

from facadelake.building import BuildingModel, find_storeys
from facadelake.building.facades import collect_facades
from facadelake.building.surface import Surface
from facadelake.core.arrays import Float64Array
from facadelake.core.camera import PosedCamera
from facadelake.deduplication.appearance import PhotographSource
from facadelake.deduplication.clustering import cluster_observations
from facadelake.deduplication.defects import build_defects_table
from facadelake.deduplication.merge_decisions import build_merges_table
from facadelake.deduplication.observations import encode_column, read_column, read_observations
from facadelake.deduplication.position import estimate_positions
from facadelake.deduplication.rear_surface import ReassignedObservations, reassign_to_rear_surface
from facadelake.deduplication.settings import MergeSettings
from facadelake.registration import compute_tangents
from schemas.vocabulary import ObservationOutcome

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class MergeResult:
    """Table ``defects``, table ``observations`` with ``defect_id`` filled for the registered ones, table ``merges``."""

    defects: pa.Table
    observations: pa.Table
    merges: pa.Table


def merge_observations(
    observations: pa.Table,
    detections: pa.Table,
    building: BuildingModel,
    posed: Mapping[str, PosedCamera],
    *,
    prefix: str,
    settings: MergeSettings | None = None,
    covariances: Mapping[str, Float64Array] | None = None,
    photographs: PhotographSource | None = None,
) -> MergeResult:
    """Defects of the registered ``observations``; boxes and scores come from ``detections``, rays from ``posed``.

    ``covariances`` (6, 6) by photo_id are the poses' (centre in m, attitude in rad). With ``photographs``, doubtful
    pairs are compared by their pictures; without, or where they cannot be read, geography alone decides. Ids are
    ``<prefix>-D0001`` on, by facade, storey from the top, and place along the facade. The result does not depend on
    the order of the rows.
    Severity is left to the lake's rules ("ungraded", rule "none").
    """
    settings = settings or MergeSettings()
    registered = pc.equal(observations.column("observation_outcome"), str(ObservationOutcome.REGISTERED))
    seen = observations.filter(registered).sort_by("detection_id")
    sightings = read_observations(seen, detections, posed, covariances or {})
    compare = None if photographs is None else photographs.prepare_comparison(_list_photo_ids(seen))
    grouping = cluster_observations(sightings, settings)
    moved = reassign_to_rear_surface(sightings, grouping, settings, Surface(building))
    if moved is not None:
        seen, sightings = _update_reassigned_rows(seen, moved, building), moved.observations
    if moved is not None or compare is not None:
        grouping = cluster_observations(sightings, settings, compare)
    group = grouping.group
    positions = estimate_positions(grouping.unit_observations, grouping.unit_group, grouping.noise, settings)
    scores = read_column(detections, "score")[
        pc.index_in(seen.column("detection_id"), detections.column("detection_id").combine_chunks()).to_numpy()
    ]
    named = build_defects_table(seen, sightings, group, scores, positions, building, prefix=prefix)
    ids = named.table.column("defect_id").combine_chunks().take(pa.array(named.row[group]))
    at = pc.index_in(observations.column("detection_id"), seen.column("detection_id").combine_chunks())
    place = observations.schema.get_field_index("defect_id")
    _log.info("%d registered observations of %d defects", len(seen), len(named.table))
    return MergeResult(
        defects=named.table,
        observations=observations.set_column(place, observations.schema.field(place), ids.take(at.combine_chunks())),
        merges=build_merges_table(seen.column("detection_id").combine_chunks(), ids, sightings, grouping, settings),
    )


def _list_photo_ids(seen: pa.Table) -> list[str]:
    return [str(name) for name in encode_column(seen, "photo_id")[1]]


def _update_reassigned_rows(seen: pa.Table, moved: ReassignedObservations, building: BuildingModel) -> pa.Table:
    """The rows ``assign_facade`` with element, storey, facade and outline of those moved to what they look at behind."""
    guids, storeys, facades = (
        building.elements.column(name).to_pylist() for name in ("element_guid", "storey", "facade")
    )
    sightings, rows = moved.observations, moved.rows
    places, normals = sightings.xyz_site_m[rows], sightings.normal_site[rows]
    directions = collect_facades(building.elements)
    across, upward = compute_tangents(normals)
    wide, high = across * sightings.width_m[rows, None] / 2, upward * sightings.height_m[rows, None] / 2
    corners = np.stack([places - wide - high, places + wide - high, places + wide + high, places - wide + high], axis=1)
    outlines = shapely.polygons(building.origin.geo_from_site(corners.reshape(-1, 3)).reshape(-1, 4, 3))
    told = {
        "element_guid": [guids[row] for row in moved.element],
        "storey": find_storeys(
            building.storeys, storeys, building.compute_vertical_extents(), moved.element, places[:, 2]
        ),
        "facade": [
            directions.assign_facade(facades[row], normal) for row, normal in zip(moved.element, normals, strict=True)
        ],
        "patch": shapely.to_wkb(outlines, output_dimension=3).tolist(),
    }
    for name, values in told.items():
        place = seen.schema.get_field_index(name)
        column_ = seen.column(name).combine_chunks()
        mask = np.zeros(len(seen), dtype=bool)
        mask[rows] = True
        ordered = pa.array([values[i] for i in np.argsort(rows)], column_.type)
        seen = seen.set_column(place, seen.schema.field(place), pc.replace_with_mask(column_, pa.array(mask), ordered))
    return seen
