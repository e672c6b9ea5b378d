"""Differences between the defects of two models: their detections are registered and deduplicated together.

Where two models find one defect in different photographs alone, the boxes have no counterpart, but the defect stays.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import pyarrow as pa
import pyarrow.compute as pc

from facadelake.evaluation.model_comparison.box_changes import BoxChange, Change
from facadelake.reviews import AcceptedDetection
from schemas.vocabulary import DefectClass

_BOTH, _OLD, _NEW = "both:", "old:", "new:"


@dataclass(frozen=True, kw_only=True)
class DefectChange:
    """A defect of the joint detections and its change; ``detection_ids`` are those of the models' own tables."""

    change: Change
    defect_id: str
    defect_class: DefectClass
    detection_ids: tuple[str, ...]


def join_detections(changes: Sequence[BoxChange], old: pa.Table, new: pa.Table) -> pa.Table:
    """Table ``detections`` of both models; a pair of boxes that stays is one row. A renamed box is two rows: the old
    class vanishes, the new one appears."""
    both = [one.new for one in changes if one.change is Change.STAYS]
    only_old = [one.old for one in changes if one.change is not Change.STAYS]
    only_new = [one.new for one in changes if one.change is not Change.STAYS]
    return pa.concat_tables(
        [
            _mark_detections(new, both, _BOTH),
            _mark_detections(old, only_old, _OLD),
            _mark_detections(new, only_new, _NEW),
        ]
    )


def _mark_detections(table: pa.Table, boxes: Sequence[AcceptedDetection | None], prefix: str) -> pa.Table:
    """The rows of ``boxes``, with a prefix to their ids that names the models."""
    ids = pa.array([one.detection_id for one in boxes if one is not None], pa.string())
    rows = table.take(pc.index_in(ids, table.column("detection_id").combine_chunks()))
    index = rows.schema.get_field_index("detection_id")
    marked = pa.array([f"{prefix}{detection_id.as_py()}" for detection_id in ids], pa.string())
    return rows.set_column(index, rows.schema.field(index), marked)


def compare_defects(observations: pa.Table, defects: pa.Table) -> tuple[DefectChange, ...]:
    """The change of each defect of the joint detections, by the models whose boxes it has."""
    members: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for row in observations.select(["defect_id", "photo_id", "detection_id"]).to_pylist():
        if row["defect_id"] is not None:
            members[row["defect_id"]].append((row["photo_id"], row["detection_id"]))
    changes = []
    for row in defects.to_pylist():
        prefixes = {marked.split(":", 1)[0] + ":" for _, marked in members[row["defect_id"]]}
        change = Change.STAYS
        if prefixes == {_OLD}:
            change = Change.VANISHES
        elif prefixes == {_NEW}:
            change = Change.APPEARS
        changes.append(
            DefectChange(
                change=change,
                defect_id=row["defect_id"],
                defect_class=DefectClass(row["defect_class"]),
                detection_ids=tuple(marked.split(":", 1)[1] for _, marked in sorted(members[row["defect_id"]])),
            )
        )
    return tuple(changes)
