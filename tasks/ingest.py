"""Task: find the photographs and read their metadata."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from prefect import task

from facadelake.building import check_registered_mesh, read_building
from facadelake.building.surface import build_horizontal_distance
from facadelake.core.hashing import hash_file, hash_files
from facadelake.core.tables import read_table, write_table
from facadelake.photos import (
    describe_unknown_offsets,
    find_photographs,
    ingest_photographs,
    read_registered_positions,
)
from schemas.vocabulary import PhotoOutcome
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage


@task(name="ingest")
def ingest(job: InspectionJob, model: StageResult | None) -> StageResult:
    """Table ``photos``: every file of the campaign's folder, the unusable ones with their reason.

    Without a ``model`` no photograph is close-range by its distance, only by its folder.
    """
    building, campaign_id = job.building, job.campaign_id
    root = building.locate_photographs(campaign_id)
    paths = find_photographs(root)
    position_file = building.locate_positions(campaign_id)
    close_range_below_m = building.tolerances.close_range_below_m

    def make(folder: Path) -> Counts:
        distance = build_horizontal_distance(read_building(model.folder)) if model else None
        photos = ingest_photographs(
            root,
            distance_to_model_m=distance,
            close_range_below_m=close_range_below_m,
            positions=read_registered_positions(building, campaign_id),
            used_kinds=[PhotoOutcome(kind) for kind in building.use_photographs],
            gnss_crs=building.crs.gnss,
        )
        check_registered_mesh(building, photos)
        write_table("photos", photos, folder)
        return Counter(photos.column("photo_outcome").to_pylist())

    inputs = {
        "photographs": [str(path.relative_to(root)) for path in paths],
        "bytes": hash_files(paths),
        "positions": building.positions.model_dump(exclude={"file"}) if building.positions else None,
        "position_file": [position_file.name, hash_file(position_file)] if position_file else None,
        "close_range_below_m": close_range_below_m,
        "use_photographs": list(building.use_photographs),
        "gnss": building.crs.gnss,
    }
    return run_stage(job, "ingest", reads={"model": model}, inputs=inputs, make=make)


def list_ingest_warnings(photos: StageResult) -> list[str]:
    """What concerns the campaign's photographs as a whole, for the user."""
    return [text for text in [describe_unknown_offsets(read_table("photos", photos.folder))] if text]
