"""Observations to defects: every real defect once."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.camera import PosedCamera
from facadelake.geobim.model import BuildingModel
from facadelake.register.cluster import clusters_of
from facadelake.register.defects import Row, defect_row, in_stable_order, on_the_globe
from facadelake.register.gate import Sightings, candidates_of
from facadelake.register.settings import MergeSettings
from facadelake.tables import table_of_rows
from schemas.vocabulary import ObservationOutcome

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class MergeResult:
    """Table ``defects``, table ``observations`` with ``defect_id`` filled for the registered ones, table ``merges``."""

    defects: pa.Table
    observations: pa.Table
    merges: pa.Table


def merge(
    observations: pa.Table,
    detections: pa.Table,
    building: BuildingModel,
    posed: Mapping[str, PosedCamera],
    *,
    prefix: str,
    settings: MergeSettings | None = None,
) -> MergeResult:
    """Defects of the registered ``observations``; scores come from ``detections``, rays from ``posed`` by photo_id.

    Ids are ``<prefix>-D0001`` on, by facade, storey from the top, and place along the facade. The result does not
    depend on the order of the rows. Severity is left to the lake's rules ("ungraded", rule "none").
    """
    settings = settings or MergeSettings()
    rows = observations.to_pylist()
    seen = [row for row in rows if row["observation_outcome"] == ObservationOutcome.REGISTERED]
    seen.sort(key=lambda row: str(row["detection_id"]))
    sightings = sightings_of(seen, posed)
    numbers = clusters_of(candidates_of(sightings, settings), sightings.photo, settings.agreement)
    groups: list[list[int]] = [[] for _ in range(int(numbers.max(initial=-1)) + 1)]
    for index, number in enumerate(numbers.tolist()):
        groups[number].append(index)
    scores = {row["detection_id"]: row["score"] for row in detections.select(["detection_id", "score"]).to_pylist()}
    elements = {row["element_guid"]: row for row in building.elements.to_pylist()}
    found = [defect_row([seen[i] for i in group], sightings, group, scores, elements, settings) for group in groups]
    defects = on_the_globe(found, building)
    order = in_stable_order(defects)
    names = {position: f"{prefix}-D{place:04d}" for place, position in enumerate(order, start=1)}
    name_of = {seen[i]["detection_id"]: names[position] for position, group in enumerate(groups) for i in group}
    _log.info("%d registered observations of %d defects", len(seen), len(groups))
    return MergeResult(
        defects=table_of_rows("defects", [{"defect_id": names[i], **defects[i]} for i in order]),
        observations=table_of_rows(
            "observations", [{**row, "defect_id": name_of.get(row["detection_id"])} for row in rows]
        ),
        merges=table_of_rows("merges", []),
    )


def sightings_of(rows: Sequence[Row], posed: Mapping[str, PosedCamera]) -> Sightings:
    """Registered rows of table ``observations`` as arrays."""

    def columns(*names: str) -> Any:
        return np.array([[row[name] for name in names] for row in rows], dtype=np.float64).reshape(-1, len(names))

    def codes(name: str) -> Any:
        words = [row[name] for row in rows]
        return np.unique(words, return_inverse=True)[1].astype(np.int64) if words else np.zeros(0, dtype=np.int64)

    xyz = columns("x_site_m", "y_site_m", "z_site_m")
    centres = np.array([posed[row["photo_id"]].centre_site_m for row in rows]).reshape(-1, 3)
    rays = xyz - centres
    return Sightings(
        xyz_site_m=xyz,
        normal_site=columns("normal_x", "normal_y", "normal_z"),
        ray_site=rays / np.linalg.norm(rays, axis=1, keepdims=True),
        width_m=columns("width_m")[:, 0],
        height_m=columns("height_m")[:, 0],
        photo=codes("photo_id"),
        defect_class=codes("defect_class"),
    )
