"""The reconstruction job, from files to arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pycolmap

from facadelake.pose.worker.export import export
from facadelake.pose.worker.features import extract, fill_database, match
from facadelake.pose.worker.mapping import adjust, map_photographs
from facadelake.pose.worker.report import Report


def reconstruct(job: dict[str, Any], folder: Path, report: Report) -> None:
    """Features, matches, block, final adjustment, export into ``folder``.

    The database (hundreds of megabytes of descriptors) is removed at the end: nothing later reads it.
    """
    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.WARNING.value)
    pycolmap.set_random_seed(job["settings"]["seed"])
    database_path = folder / "features.db"
    image_id_of = fill_database(job, database_path)
    extract(job, database_path, report)
    match(job, database_path, report)
    model = map_photographs(job, database_path, report)
    adjust(model, job, report)
    export(model, job, image_id_of, database_path, folder, report)
    for left in folder.glob("features.db*"):
        left.unlink()
