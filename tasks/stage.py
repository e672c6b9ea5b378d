"""Run one stage: answered from the cache where its inputs and code are the same, metered and logged where not."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from facadelake.core.cache import code_hash, key_of
from facadelake.core.metering import Meter
from tasks.job import InspectionJob, StageResult

log = logging.getLogger("facadelake.tasks")

COMMON_CODE = ("camera.py", "frames.py", "geodesy.py", "tables.py", "cache.py")
Counts = Mapping[str, int]


def run_stage(
    job: InspectionJob,
    stage: str,
    *,
    code: Sequence[str],
    inputs: Mapping[str, Any],
    make: Callable[[Path], Counts],
) -> StageResult:
    """The stage's result folder, made by ``make(folder)`` unless the cache has it for these inputs and this code.

    ``code`` names the rooms of the domain that the result depends on; ``make`` returns what it counted.
    """
    key = key_of({"stage": stage, "code": code_hash(*code, *COMMON_CODE), **inputs})

    def make_and_count(folder: Path) -> None:
        counts = dict(make(folder))
        (folder / "counts.json").write_text(json.dumps(counts))

    with Meter() as meter:
        entry = job.cache.entry(stage, key, make_and_count)
    counts = json.loads((entry.folder / "counts.json").read_text())
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
        hit=entry.hit,
        seconds=meter.seconds,
        peak_mib=meter.peak_mib,
        counts=tuple(counts.items()),
    )
