"""Which true defect a detection and a defect show: by the annotation that was imported, never by distance."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import pyarrow as pa

from facadelake.core.errors import InputDataError
from facadelake.evaluation.campaigns.samples import Row

COCO_PREFIX = "coco:"


def match_detections(
    detections: pa.Table, true_id_of_annotation: Mapping[tuple[str, str], str | None], path: Path
) -> dict[str, str | None]:
    """The true defect (or check point) of each imported detection; None for one that shows none.

    Args:
        detections: table ``detections``; those of a model have no annotation and are left out.
        true_id_of_annotation: truth by (file, annotation id); None for a false detection.
        path: the file of truth, for messages.

    Returns:
        True ids by ``detection_id``.

    Raises:
        InputDataError: truth has no line for the file of the detections, or an annotation was imported twice.
    """
    files = {file for file, _ in true_id_of_annotation}
    true_ids: dict[str, str | None] = {}
    imported: dict[tuple[str, str], str] = {}
    for row in detections.select(["detection_id", "detector", "source_annotation"]).to_pylist():
        if not row["detector"].startswith(COCO_PREFIX):
            continue
        key = (row["detector"].removeprefix(COCO_PREFIX), row["source_annotation"])
        if key[0] not in files:
            raise InputDataError(
                f"{path}, column file: no line for '{key[0]}', the source of the campaign's "
                f"detections (files: {', '.join(sorted(files))}); evaluate one of these, or add the file"
            )
        if key in imported:
            raise InputDataError(
                f"annotation {key[1]} of {key[0]} was imported as {imported[key]} and {row['detection_id']}; truth "
                "identifies annotations by id, so give each annotation its own id"
            )
        imported[key] = row["detection_id"]
        true_ids[row["detection_id"]] = true_id_of_annotation.get(key)
    return true_ids


def match_defects(
    defect_ids: Sequence[str], registered: Iterable[Row], true_id_of_detection: Mapping[str, str | None]
) -> list[str | None]:
    """The true defect (or check point) that most observations of each defect show; of equally many, the first by name.

    None for a defect most of whose observations show none.

    Args:
        defect_ids: the defects.
        registered: registered rows of table ``observations``.
        true_id_of_detection: true ids by ``detection_id``.
    """
    counts_by_defect: dict[str, Counter[str | None]] = defaultdict(Counter)
    for row in registered:
        if row["defect_id"]:
            counts_by_defect[row["defect_id"]][true_id_of_detection.get(row["detection_id"])] += 1
    return [
        min(counts, key=lambda name: (-counts[name], name is None, name or ""), default=None)
        for counts in (counts_by_defect[defect_id] for defect_id in defect_ids)
    ]
