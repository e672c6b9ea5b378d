"""The reconstruction job, from files to arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pycolmap

from facadelake.sfm.worker.export import MappingResult, export_reconstruction
from facadelake.sfm.worker.features import extract_features, match_pairs, open_database
from facadelake.sfm.worker.joining import join_blocks
from facadelake.sfm.worker.mapping import adjust_block, map_photographs
from facadelake.sfm.worker.report import ProgressReport
from facadelake.sfm.worker.resection import resect_remaining
from facadelake.sfm.worker.retrieval import pair_by_appearance, pair_transitively


def run_job(job: dict[str, Any], folder: Path, report: ProgressReport) -> None:
    """Features, matches, blocks joined and adjusted, the rest resected; the result is exported into ``folder``.

    What is expensive lies in the folder ``job["work"]`` as soon as it is done: each photograph's features and each
    pair's matches in a database, the block so far in snapshots. A job that was killed goes on from there.
    """
    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.WARNING.value)
    pycolmap.set_random_seed(job["settings"]["seed"])
    database_path = Path(job["work"]) / "features.db"
    image_id_of = open_database(job, database_path)
    extract_features(job, database_path, image_id_of, report)
    sought, partners = job["sought"], job["settings"]["neighbours"] // 2
    alike = pair_by_appearance(job, sought, partners, database_path, image_id_of)
    pairs = sorted({(int(i), int(j)) for i, j in [*job["pairs"], *alike]})
    match_pairs(job, pairs, database_path, image_id_of, report)
    match_pairs(
        job, pair_transitively(sought, pairs, partners, database_path, image_id_of), database_path, image_id_of, report
    )
    block, apart = join_blocks(map_photographs(job, database_path, report), database_path, report)
    adjust_block(block, job, report)
    mapped = frozenset(block.reg_image_ids())
    refused = resect_remaining(block, job, database_path, report)
    outcome = MappingResult(block=block, mapped=mapped, separate_blocks=apart, resection_failures=refused)
    export_reconstruction(outcome, job, image_id_of, database_path, folder, report)
