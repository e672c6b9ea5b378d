"""The reconstruction job, from files to arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pycolmap

from facadelake.sfm.worker.export import Outcome, export
from facadelake.sfm.worker.features import extract, match, open_database
from facadelake.sfm.worker.joining import join_blocks
from facadelake.sfm.worker.mapping import adjust, map_photographs
from facadelake.sfm.worker.report import Report
from facadelake.sfm.worker.resection import resect_others
from facadelake.sfm.worker.retrieval import pairs_by_chain, pairs_by_look


def reconstruct(job: dict[str, Any], folder: Path, report: Report) -> None:
    """Features, matches, blocks joined and adjusted, the rest resected; the result is exported into ``folder``.

    What is expensive lies in the folder ``job["work"]`` as soon as it is done: each photograph's features and each
    pair's matches in a database, the block so far in snapshots. A job that was killed goes on from there.
    """
    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.WARNING.value)
    pycolmap.set_random_seed(job["settings"]["seed"])
    database_path = Path(job["work"]) / "features.db"
    image_id_of = open_database(job, database_path)
    extract(job, database_path, image_id_of, report)
    sought, partners = job["sought"], job["settings"]["neighbours"] // 2
    alike = pairs_by_look(job, sought, partners, database_path, image_id_of)
    pairs = sorted({(int(i), int(j)) for i, j in [*job["pairs"], *alike]})
    match(job, pairs, database_path, image_id_of, report)
    match(job, pairs_by_chain(sought, pairs, partners, database_path, image_id_of), database_path, image_id_of, report)
    block, apart = join_blocks(map_photographs(job, database_path, report), database_path, report)
    adjust(block, job, report)
    mapped = frozenset(block.reg_image_ids())
    refused = resect_others(block, job, database_path, report)
    outcome = Outcome(block=block, mapped=mapped, apart=apart, refused=refused)
    export(outcome, job, image_id_of, database_path, folder, report)
