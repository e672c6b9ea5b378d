"""Task: check every table before anything is committed."""

from __future__ import annotations

from pathlib import Path

from prefect import task

from facadelake.errors import SchemaError
from facadelake.lake.expectations import failures, validate
from facadelake.progress import stage_progress
from facadelake.tables import read_table, write_table
from tasks.job import InspectionJob, StageResult
from tasks.record import StageFolders, lake_form
from tasks.stage import Counts, run_stage


@task(name="validate")
def validate_tables(job: InspectionJob, folders: StageFolders) -> StageResult:
    """Table ``checks``: all expectations of schemas/ and sql/checks; a failed one ends the run before the commit."""

    def make(folder: Path) -> Counts:
        with stage_progress("Checking the tables"):
            checks = validate(lake_form(job, folders, checks=None))
        write_table("checks", checks, folder)
        return {"checks": len(checks), "failed": len(failures(checks))}

    result = run_stage(job, "validate", code=["lake"], inputs={"tables": folders.keys()}, make=make)
    failed = failures(read_table("checks", result.folder))
    if len(failed):
        first = failed.to_pylist()[0]
        raise SchemaError(
            f"{len(failed)} of {result.counts[0][1]} checks failed, so nothing was committed; the first: table "
            f"{first['table_name']}, {first['expectation']} on '{first['column_name']}', {first['unexpected']} rows: "
            f"{first['detail']}. All are in {result.folder / 'checks.parquet'}"
        )
    return result
