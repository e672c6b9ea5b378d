"""Task: compare the as-built surface with the building model, view by view."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import pyarrow as pa
from prefect import task

from facadelake.building import BuildingModel, read_building
from facadelake.building.surface import Surface
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.frames import read_similarity
from facadelake.core.pose_table import read_posed_cameras
from facadelake.core.tables import read_table, write_table
from facadelake.integrity import compare_views, record_uncompared_views
from facadelake.sfm import read_mesh, write_as_built_mesh
from schemas.vocabulary import IntegrityOutcome, SurfaceKind
from tasks.georeference import SITE_FROM_SFM
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage

NOTHING_INDEPENDENT = (
    "the building has no model: its surface is the as-built surface itself, so there is nothing to compare it with"
)


@task(name="verify model")
def verify_model(job: InspectionJob, model: StageResult, block: StageResult | None, placed: StageResult) -> StageResult:
    """Table ``integrity_views``; without a ``block`` (poses were imported) there is nothing to compare."""

    def make(folder: Path) -> Counts:
        posed = read_posed_cameras(read_table("poses", placed.folder))
        building = read_building(model.folder)
        if building.surface_kind is SurfaceKind.AS_BUILT:
            table = record_uncompared_views(posed, NOTHING_INDEPENDENT, IntegrityOutcome.NO_MODEL)
        else:
            table = _compare_views(posed, building, block, placed, folder)
        write_table("integrity_views", table, folder)
        return Counter(table.column("integrity_outcome").to_pylist())

    return run_stage(
        job, "verify-model", reads={"model": model, "block": block, "placed": placed}, inputs={}, make=make
    )


def _compare_views(
    posed: Mapping[str, PosedCamera],
    building: BuildingModel,
    block: StageResult | None,
    placed: StageResult,
    folder: Path,
) -> pa.Table:
    try:
        if block is None:
            raise InputDataError("poses were imported, so there are no tie points for an as-built surface")
        write_as_built_mesh(block.folder, folder)
    except InputDataError as error:  # the block is too sparse; the campaign is committed without the comparison
        return record_uncompared_views(posed, str(error))
    return compare_views(posed, Surface(building), _read_as_built_surface(folder, placed.folder))


def read_as_built_surface(integrity: StageResult, placed: StageResult) -> Surface | None:
    """The as-built surface in site that was compared with the model; None where there was none."""
    is_compared = any(
        outcome == IntegrityOutcome.COMPARED
        for outcome in read_table("integrity_views", integrity.folder).column("integrity_outcome").to_pylist()
    )
    return _read_as_built_surface(integrity.folder, placed.folder) if is_compared else None


def _read_as_built_surface(mesh: Path, placed: Path) -> Surface:
    vertices_sfm, triangles = read_mesh(mesh)
    return Surface.from_mesh(read_similarity(placed / SITE_FROM_SFM).apply(vertices_sfm), triangles)
