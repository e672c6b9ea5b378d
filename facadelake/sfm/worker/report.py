"""What the worker tells its parent: progress events as JSON lines, on what was its standard output."""

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


@dataclass(frozen=True, kw_only=True)
class StepCost:
    """Wall and processor time of a step, and the process's peak memory up to its end."""

    step: str
    seconds: float
    cpu_seconds: float
    peak_memory_mb: float


@dataclass(frozen=True, kw_only=True)
class ProgressReport:
    """The line to the parent, and the cost of the steps done so far."""

    stream: TextIO
    costs: list[StepCost] = field(default_factory=list)

    @staticmethod
    def take_standard_output() -> ProgressReport:
        """Take standard output for events; everything else that would be printed there goes to the log (stderr)."""
        sys.stdout.flush()
        events = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
        os.dup2(2, 1)
        return ProgressReport(stream=events)

    def _send(self, **event: Any) -> None:
        self.stream.write(json.dumps(event) + "\n")

    @contextmanager
    def step(self, label: str, total: int | None) -> Iterator[None]:
        """A piece of work of ``total`` steps; its cost is noted at its end."""
        self._send(event="begin", label=label, total=total)
        started, cpu_before = time.perf_counter(), time.process_time()
        yield
        seconds, cpu_seconds = time.perf_counter() - started, time.process_time() - cpu_before
        peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        self.costs.append(StepCost(step=label, seconds=seconds, cpu_seconds=cpu_seconds, peak_memory_mb=peak_mb))
        self._send(
            event="note", text=f"{label}: {seconds:.1f} s ({cpu_seconds:.1f} s of processor), peak {peak_mb:.0f} MB"
        )

    def advance(self, steps: int = 1) -> None:
        """``steps`` more of the current piece are done."""
        self._send(event="advance", steps=steps)

    def refuse(self, text: str) -> None:
        """The photographs cannot be reconstructed, and why."""
        self._send(event="refused", text=text)
