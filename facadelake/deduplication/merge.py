"""Merging of observations into defects: each physical defect once."""

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
from facadelake.core.arrays import Float64x6x6
from facadelake.core.camera import PosedCamera
from facadelake.deduplication.appearance import PhotographSource
from facadelake.deduplication.clustering import cluster_observations
from facadelake.deduplication.defects import build_defects_table
from facadelake.deduplication.merges_table import build_merges_table
from facadelake.deduplication.observations import encode_column, read_column, read_observations
from facadelake.deduplication.position import estimate_positions
from facadelake.deduplication.rear_surface import ReassignedObservations, reassign_to_rear_surface
from facadelake.deduplication.settings import MergeSettings
from facadelake.registration import compute_tangents
from schemas.vocabulary import ObservationOutcome

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class MergeResult:
    """Table ``defects``; table ``observations`` with ``defect_id`` of the registered ones; table ``merges``."""

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
    covariances: Mapping[str, Float64x6x6] | None = None,
    photographs: PhotographSource | None = None,
) -> MergeResult:
    """Merge the registered observations of a campaign into defects; the result does not depend on the order of rows.

    Args:
        observations: table ``observations``.
        detections: table ``detections``, for boxes and scores.
        building: the building's surface, elements and storeys.
        posed: cameras of the localised photographs by photo_id.
        prefix: defect ids are ``<prefix>-D0001`` on, by facade, storey from the top, and position along the facade.
        settings: gate, priors and control of the campaign; None: the defaults.
        covariances: covariances (6, 6) of poses by photo_id: centre (m, site), attitude (rad, about the camera's axes).
        photographs: where ambiguous pairs are compared by appearance; None, or where a photograph cannot be read: by
            position alone.

    Returns:
        The three tables; severity is "ungraded" by rule "none" until a rule pack grades the defects.
    """
    settings = settings or MergeSettings()
    is_registered = pc.equal(observations.column("observation_outcome"), str(ObservationOutcome.REGISTERED))
    registered_rows = observations.filter(is_registered).sort_by("detection_id")
    arrays = read_observations(registered_rows, detections, posed, covariances or {})
    compare = None if photographs is None else photographs.prepare_comparison(_list_photo_ids(registered_rows))
    clustering = cluster_observations(arrays, settings)
    reassigned = reassign_to_rear_surface(arrays, clustering, settings, Surface(building))
    if reassigned is not None:
        registered_rows, arrays = (
            _update_reassigned_rows(registered_rows, reassigned, building),
            reassigned.observations,
        )
    if reassigned is not None or compare is not None:
        clustering = cluster_observations(arrays, settings, compare)
    group = clustering.group
    positions = estimate_positions(clustering.unit_observations, clustering.unit_group, clustering.noise, settings)
    scores = read_column(detections, "score")[
        pc.index_in(
            registered_rows.column("detection_id"), detections.column("detection_id").combine_chunks()
        ).to_numpy()
    ]
    defects = build_defects_table(registered_rows, arrays, group, scores, positions, building, prefix=prefix)
    ids = defects.table.column("defect_id").combine_chunks().take(pa.array(defects.row[group]))
    row_of_registered = pc.index_in(
        observations.column("detection_id"), registered_rows.column("detection_id").combine_chunks()
    )
    column_index = observations.schema.get_field_index("defect_id")
    _log.info("merged %d registered observations into %d defects", len(registered_rows), len(defects.table))
    return MergeResult(
        defects=defects.table,
        observations=observations.set_column(
            column_index, observations.schema.field(column_index), ids.take(row_of_registered.combine_chunks())
        ),
        merges=build_merges_table(
            registered_rows.column("detection_id").combine_chunks(), ids, arrays, clustering, settings
        ),
    )


def _list_photo_ids(registered_rows: pa.Table) -> list[str]:
    """The photo_ids of the codes ``ObservationArrays.photo``."""
    return [str(name) for name in encode_column(registered_rows, "photo_id")[1]]


def _update_reassigned_rows(
    registered_rows: pa.Table, reassigned: ReassignedObservations, building: BuildingModel
) -> pa.Table:
    """The rows with element, storey, facade and patch of those that were reassigned to a rear surface."""
    guids, storeys, facades = (
        building.elements.column(name).to_pylist() for name in ("element_guid", "storey", "facade")
    )
    arrays, rows = reassigned.observations, reassigned.rows
    positions, normals = arrays.xyz_site_m[rows], arrays.normal_site[rows]
    directions = collect_facades(building.elements)
    across, upward = compute_tangents(normals)
    half_across, half_upward = across * arrays.width_m[rows, None] / 2, upward * arrays.height_m[rows, None] / 2
    corners = np.stack(
        [
            positions - half_across - half_upward,
            positions + half_across - half_upward,
            positions + half_across + half_upward,
            positions - half_across + half_upward,
        ],
        axis=1,
    )
    outlines = shapely.polygons(building.origin.geo_from_site(corners.reshape(-1, 3)).reshape(-1, 4, 3))
    columns = {
        "element_guid": [guids[row] for row in reassigned.element],
        "storey": find_storeys(
            building.storeys, storeys, building.compute_vertical_extents(), reassigned.element, positions[:, 2]
        ),
        "facade": [
            directions.assign_facade(facades[row], normal)
            for row, normal in zip(reassigned.element, normals, strict=True)
        ],
        "patch": shapely.to_wkb(outlines, output_dimension=3).tolist(),
    }
    for name, values in columns.items():
        column_index = registered_rows.schema.get_field_index(name)
        column = registered_rows.column(name).combine_chunks()
        mask = np.zeros(len(registered_rows), dtype=bool)
        mask[rows] = True
        ordered = pa.array([values[i] for i in np.argsort(rows)], column.type)
        registered_rows = registered_rows.set_column(
            column_index,
            registered_rows.schema.field(column_index),
            pc.replace_with_mask(column, pa.array(mask), ordered),
        )
    return registered_rows
