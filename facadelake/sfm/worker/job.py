"""The reconstruction job, from photographs to arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pycolmap

from facadelake.sfm.worker.export import MappingResult, export_reconstruction
from facadelake.sfm.worker.features import extract_features, match_pairs, open_database
from facadelake.sfm.worker.focal_deviations import separate_focal_deviations
from facadelake.sfm.worker.joining import join_blocks
from facadelake.sfm.worker.mapping import adjust_block, map_photographs
from facadelake.sfm.worker.report import ProgressReport
from facadelake.sfm.worker.resection import resect_remaining
from facadelake.sfm.worker.retrieval import pair_by_appearance, pair_transitively


def run_job(job: dict[str, Any], folder: Path, report: ProgressReport) -> None:
    """Extract and match features, map, join and adjust blocks, resect the rest, and export the result into ``folder``.

    Expensive intermediate results are in the folder ``job["work"]`` as soon as they exist: the features of each
    photograph and the matches of each pair in a database, the block in snapshots. An interrupted job resumes from
    there.
    """
    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.WARNING.value)
    pycolmap.set_random_seed(job["settings"]["seed"])
    database_path = Path(job["work"]) / "features.db"
    image_id_of = open_database(job, database_path)
    extract_features(job, database_path, image_id_of, report)
    uncertain, partners = job["uncertain_positions"], job["settings"]["neighbours"] // 2
    similar = pair_by_appearance(job, uncertain, partners, database_path, image_id_of)
    pairs = sorted({(int(i), int(j)) for i, j in [*job["pairs"], *similar]})
    match_pairs(job, pairs, database_path, image_id_of, report)
    match_pairs(
        job,
        pair_transitively(uncertain, pairs, partners, database_path, image_id_of),
        database_path,
        image_id_of,
        report,
    )
    block, separate = join_blocks(map_photographs(job, database_path, report), database_path, report)
    adjust_block(block, job, report)
    mapped = frozenset(block.reg_image_ids())
    failures = resect_remaining(block, job, database_path, report)
    deviations = separate_focal_deviations(block, job, database_path, failures, report)
    result = MappingResult(
        block=block,
        mapped=mapped - {deviation.image_id for deviation in deviations},
        separate_blocks=separate,
        resection_failures=failures,
        focal_deviations={deviation.image_id: deviation for deviation in deviations},
    )
    export_reconstruction(result, job, image_id_of, database_path, folder, report)
