"""The worker's events to its parent, with the cost of each step."""

from __future__ import annotations

import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from facadelake.core.processes.worker import EventStream
from facadelake.sfm.step_cost import StepCost


@dataclass(frozen=True, kw_only=True)
class ProgressReport(EventStream):
    """The stream of events to the parent, and the cost of the finished steps."""

    costs: list[StepCost] = field(default_factory=list)

    @contextmanager
    def step(self, label: str, total: int | None) -> Iterator[None]:
        """A step of ``total`` units of work; its cost is recorded at its end."""
        self.begin_step(label, total)
        started, cpu_before = time.perf_counter(), time.process_time()
        yield
        seconds, cpu_seconds = time.perf_counter() - started, time.process_time() - cpu_before
        peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        self.costs.append(StepCost(step=label, seconds=seconds, cpu_seconds=cpu_seconds, peak_memory_mb=peak_mb))
        self.log(
            f"{label}: {seconds:.1f} s ({cpu_seconds:.1f} s of processor time), peak {peak_mb:.0f} MB",
            logger=__name__,
        )
