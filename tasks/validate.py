"""Task: check every table before anything is committed."""

from __future__ import annotations

from pathlib import Path

from prefect import task

from facadelake.core.errors import SchemaError
from facadelake.core.progress import report_progress
from facadelake.core.tables import read_table, write_table
from facadelake.lake import format_failures, select_failures, validate
from schemas.tables import HISTORY_TABLES
from tasks.job import InspectionJob, StageResult, StageResults
from tasks.record import assemble_campaign
from tasks.stage import Counts, run_stage


@task(name="validate")
def validate_tables(job: InspectionJob, results: StageResults, tracked: StageResult) -> StageResult:
    """Table ``checks``: results of all expectations of schemas/ and sql/checks; a failure ends the run."""

    def make(folder: Path) -> Counts:
        with report_progress("Checking the tables"):
            _, tables = assemble_campaign(job, results)
            history = {name: read_table(name, tracked.folder) for name in HISTORY_TABLES}
            checks = validate({**tables, **history})
        write_table("checks", checks, folder)
        return {"checks": len(checks), "failed": len(select_failures(checks))}

    result = run_stage(job, "validate", reads={**results.map_by_name(), "tracked": tracked}, inputs={}, make=make)
    checks = read_table("checks", result.folder)
    failed = len(select_failures(checks))
    if failed:
        raise SchemaError(
            f"{failed} of {len(checks)} checks failed, so nothing was committed (all results: "
            f"{result.folder / 'checks.parquet'}):\n{format_failures(checks)}"
        )
    return result
