"""Run one stage: from the cache where inputs and code are unchanged, else executed, metered and logged."""

from __future__ import annotations

import inspect
import json
import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from facadelake.core.cache import DIAGNOSTICS, compute_stage_key
from facadelake.core.code_version import require_unchanged_code
from facadelake.core.metering import Meter
from tasks.job import InspectionJob, StageResult, StageResults

log = logging.getLogger("facadelake.tasks")

Counts = Mapping[str, int]
Reads = Mapping[str, StageResult | None]
_COUNTS = "counts.json"


def run_stage(
    job: InspectionJob,
    stage: str,
    *,
    reads: Reads,
    inputs: Mapping[str, Any],
    make: Callable[[Path], Counts],
) -> StageResult:
    """The result of a stage, from the cache or made by ``make``.

    The key covers everything that ``make`` depends on, so that a change of any of it makes the result anew.

    Args:
        job: the inspection.
        stage: name of the stage, a folder of the cache.
        reads: results of earlier stages that ``make`` reads, by name; their contents enter the key.
        inputs: everything else: settings and hashes of files, JSON-able.
        make: writes the result into a folder and returns counts for the log; the code version of its module enters the
            key.

    Raises CodeVersionError where that code changed while the process ran; the result is then not stored.
    """
    _check_reads(stage, reads, make)
    contents = {name: result.content_sha256 if result else None for name, result in reads.items()}
    key = compute_stage_key(stage, make.__module__, contents, inputs)

    def make_and_count(folder: Path) -> None:
        counts = dict(make(folder))
        require_unchanged_code(make.__module__)
        (folder / DIAGNOSTICS).mkdir(exist_ok=True)
        (folder / DIAGNOSTICS / _COUNTS).write_text(json.dumps(counts))

    with Meter() as meter:
        entry = job.cache.get_or_make(stage, key, make_and_count)
    counts = json.loads((entry.folder / DIAGNOSTICS / _COUNTS).read_text())
    log.info(
        "%s %s: %s%s",
        job.building.id,
        stage,
        ", ".join(f"{count} {name}" for name, count in counts.items()) or "done",
        " (from the cache)" if entry.hit else f" in {meter.seconds:.1f} s",
    )
    return StageResult(
        stage=stage,
        key=key,
        folder=entry.folder,
        content_sha256=entry.content_sha256,
        hit=entry.hit,
        seconds=meter.seconds,
        peak_mib=meter.peak_mib,
        counts=tuple(counts.items()),
    )


def _check_reads(stage: str, reads: Reads, make: Callable[[Path], Counts]) -> None:
    """Require that all stage results ``make`` refers to are in ``reads``: else the cache could return stale ones."""
    for name, value in inspect.getclosurevars(make).nonlocals.items():
        seen = value.list_results() if isinstance(value, StageResults) else [value]
        for one in seen:
            if isinstance(one, StageResult):
                assert one in reads.values(), f"stage {stage} uses {name} without naming it in reads"
