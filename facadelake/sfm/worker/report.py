"""Progress events that the worker sends to its parent, as JSON lines on what was its standard output."""

from __future__ import annotations

import json
import os
import resource
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TextIO

from facadelake.sfm.step_cost import StepCost


@dataclass(frozen=True, kw_only=True)
class ProgressReport:
    """The stream of events to the parent, and the cost of the finished steps."""

    stream: TextIO
    costs: list[StepCost] = field(default_factory=list)

    @staticmethod
    def take_standard_output() -> ProgressReport:
        """Use standard output for events; all other output to it is redirected to the log (stderr)."""
        sys.stdout.flush()
        events = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
        os.dup2(2, 1)
        return ProgressReport(stream=events)

    def _send(self, **event: Any) -> None:
        """Write one event."""
        self.stream.write(json.dumps(event) + "\n")

    @contextmanager
    def step(self, label: str, total: int | None) -> Iterator[None]:
        """A step of ``total`` units of work; its cost is recorded at its end."""
        self._send(event="begin", label=label, total=total)
        started, cpu_before = time.perf_counter(), time.process_time()
        yield
        seconds, cpu_seconds = time.perf_counter() - started, time.process_time() - cpu_before
        peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        self.costs.append(StepCost(step=label, seconds=seconds, cpu_seconds=cpu_seconds, peak_memory_mb=peak_mb))
        self._send(
            event="note",
            text=f"{label}: {seconds:.1f} s ({cpu_seconds:.1f} s of processor time), peak {peak_mb:.0f} MB",
        )

    def advance(self, steps: int = 1) -> None:
        """``steps`` more units of the current step are done."""
        self._send(event="advance", steps=steps)

    def refuse(self, text: str) -> None:
        """The photographs cannot be reconstructed, for the reason ``text``."""
        self._send(event="refused", text=text)
