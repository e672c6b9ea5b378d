"""Task: compare the as-built surface with the building model, view by view."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from prefect import task

from facadelake.frames import read_similarity
from facadelake.geobim.model import read_building
from facadelake.geobim.surface import Surface
from facadelake.integrity.views import integrity_views
from facadelake.pose.surface_mesh import read_mesh
from facadelake.posed import posed_cameras
from facadelake.tables import read_table, write_table
from tasks.georeference import SITE_FROM_SFM
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage


@task(name="verify model")
def verify_model(job: InspectionJob, model: StageResult, block: StageResult, placed: StageResult) -> StageResult:
    """Table ``integrity_views``."""

    def make(folder: Path) -> Counts:
        vertices_sfm, triangles = read_mesh(block.folder)
        as_built = Surface.from_mesh(read_similarity(placed.folder / SITE_FROM_SFM).apply(vertices_sfm), triangles)
        posed = posed_cameras(read_table("poses", placed.folder))
        table = integrity_views(posed, Surface(read_building(model.folder)), as_built)
        write_table("integrity_views", table, folder)
        return Counter(table.column("integrity_outcome").to_pylist())

    inputs = {"model": model.key, "block": block.key, "poses": placed.key}
    return run_stage(job, "verify-model", code=["integrity", "geobim", "posed.py"], inputs=inputs, make=make)
