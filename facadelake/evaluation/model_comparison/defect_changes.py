"""Two models' boxes registered together: which defects of the wall stay, appear and vanish.

A defect seen by both models in different photographs alone is still one defect, which photographs apart cannot tell.
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
    """A defect of the wall and what becomes of it; ``sightings`` are (photo_id, detection_id) as the models had it."""

    change: Change
    defect_id: str
    defect_class: DefectClass
    facade: str
    storey: str | None
    sightings: tuple[tuple[str, str], ...]


def join_detections(changes: Sequence[BoxChange], old: pa.Table, new: pa.Table) -> pa.Table:
    """Table ``detections`` of both models, what both found once, to be registered and merged as one.

    A renamed box is two: the old class vanishes, the new one appears.
    """
    both = [one.new for one in changes if one.change is Change.STAYS]
    gone = [one.old for one in changes if one.change is not Change.STAYS]
    come = [one.new for one in changes if one.change is not Change.STAYS]
    return pa.concat_tables(
        [_mark_detections(new, both, _BOTH), _mark_detections(old, gone, _OLD), _mark_detections(new, come, _NEW)]
    )


def _mark_detections(table: pa.Table, boxes: Sequence[AcceptedDetection | None], mark: str) -> pa.Table:
    """The rows of ``boxes`` with the mark before their ids."""
    ids = pa.array([one.detection_id for one in boxes if one is not None], pa.string())
    rows = table.take(pc.index_in(ids, table.column("detection_id").combine_chunks()))
    at = rows.schema.get_field_index("detection_id")
    return rows.set_column(at, rows.schema.field(at), pa.array([f"{mark}{key.as_py()}" for key in ids], pa.string()))


def compare_defects(observations: pa.Table, defects: pa.Table) -> tuple[DefectChange, ...]:
    """What becomes of each merged defect, by the models that saw it."""
    seen: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for row in observations.select(["defect_id", "photo_id", "detection_id"]).to_pylist():
        if row["defect_id"] is not None:
            seen[row["defect_id"]].append((row["photo_id"], row["detection_id"]))
    out = []
    for row in defects.to_pylist():
        marks = {key.split(":", 1)[0] + ":" for _, key in seen[row["defect_id"]]}
        change = Change.STAYS
        if marks == {_OLD}:
            change = Change.VANISHES
        elif marks == {_NEW}:
            change = Change.APPEARS
        out.append(
            DefectChange(
                change=change,
                defect_id=row["defect_id"],
                defect_class=DefectClass(row["defect_class"]),
                facade=row["facade"],
                storey=row["storey"],
                sightings=tuple((photo, key.split(":", 1)[1]) for photo, key in sorted(seen[row["defect_id"]])),
            )
        )
    return tuple(out)
