"""When something was observed: by a clock that is never set, and by the calendar.

An upload is complete when nothing in it has changed for a time. Modification times are no evidence of that, because
``rsync -a`` and ``cp -p`` keep old ones, and the clock of the calendar can be set back or jump. Within one start of a
machine, the time between two observations is therefore that of its boot clock, which all processes share. Across a
restart, or between machines, it is the difference of the calendar's clocks, and never negative.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True, kw_only=True)
class ObservationTime:
    """A moment: seconds since 1970 (UTC), the machine's start, and the seconds since that start."""

    unix_s: float
    boot_id: str
    boot_s: float

    def measure_since(self, earlier: ObservationTime) -> float:
        """Seconds since an earlier observation, at least 0, whatever was done to the calendar's clock meanwhile."""
        if self.boot_id and self.boot_id == earlier.boot_id:
            return max(0.0, self.boot_s - earlier.boot_s)
        return max(0.0, self.unix_s - earlier.unix_s)


def read_clock() -> ObservationTime:
    """The present moment."""
    try:
        boot_id = _BOOT_ID.read_text(encoding="ascii").strip()
    except OSError:  # another system than Linux, or a container without /proc
        boot_id = ""
    return ObservationTime(
        unix_s=time.time(), boot_id=boot_id, boot_s=time.clock_gettime(time.CLOCK_BOOTTIME) if boot_id else 0.0
    )
