"""Which of the waiting campaigns can start now, within the memory and the number of inspections of a machine."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil

from facadelake.registry import RunLimits
from facadelake.scheduling.memory_need import MIB
from facadelake.scheduling.plan import WaitingCampaign

_FREE_SHARE = 0.8
_CGROUP = Path("/sys/fs/cgroup")


@dataclass(frozen=True, kw_only=True)
class InspectionLimits:
    """Memory of all inspections together, and how many run at once."""

    memory_mib: float
    side_by_side: int


def find_limits(limits: RunLimits) -> InspectionLimits:
    """The limits of the settings, else those of the machine: 80 % of its free memory, an inspection for two cores.

    An inspection uses all cores in its longest stage, and one in many others.
    """
    memory_mib = limits.memory_gib * 1024 if limits.memory_gib else _FREE_SHARE * _measure_free_bytes() / MIB
    return InspectionLimits(
        memory_mib=memory_mib, side_by_side=limits.side_by_side or max(1, (os.cpu_count() or 1) // 2)
    )


def _measure_free_bytes() -> float:
    """Free memory of the machine, or of the container where that is less."""
    free = float(psutil.virtual_memory().available)
    try:
        limit = (_CGROUP / "memory.max").read_text().strip()
        used = float((_CGROUP / "memory.current").read_text())
    except OSError:
        return free
    return free if limit == "max" else min(free, float(limit) - used)


def choose_startable(
    waiting: Sequence[WaitingCampaign], running: Sequence[WaitingCampaign], limits: InspectionLimits
) -> WaitingCampaign | None:
    """The first of ``waiting`` that can start beside ``running``; None: none can.

    Campaigns of one building run one after another, because each is placed and tracked by those before it. Where the
    next one waits for memory, no smaller one overtakes it: it would wait for long.
    """
    if len(running) >= limits.side_by_side:
        return None
    busy = {one.building_id for one in running}
    taken_mib = sum(one.need.mib for one in running)
    for one in waiting:
        if one.building_id not in busy:
            return one if taken_mib + one.need.mib <= limits.memory_mib else None
    return None
