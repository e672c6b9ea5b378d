"""What a step of the reconstruction cost; the worker measures it, the parent reads it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class StepCost:
    """Wall and processor time of a step, and the peak memory of the worker process up to its end."""

    step: str
    seconds: float
    cpu_seconds: float
    peak_memory_mb: float
