"""Which process does something, so that another one can tell whether it is still there (Linux)."""

from __future__ import annotations

import json
import os
import socket
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Self

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True, kw_only=True)
class ProcessIdentity:
    """A process for good: numbers of processes are used again, and the clock can be set back.

    ``start_ticks``: clock ticks between the boot and the start of the process (proc(5), field 22 of stat).
    """

    host: str
    boot_id: str
    pid: int
    start_ticks: int

    @classmethod
    def from_pid(cls, pid: int) -> Self:
        """The process ``pid`` of this machine. Raises ProcessLookupError where there is none."""
        ticks = _read_start_ticks(pid)
        if ticks is None:
            raise ProcessLookupError(f"there is no process {pid}")
        return cls(host=socket.gethostname(), boot_id=_read_boot_id(), pid=pid, start_ticks=ticks)

    @classmethod
    def from_this_process(cls) -> Self:
        """The process that asks."""
        return cls.from_pid(os.getpid())

    @classmethod
    def read(cls, path: Path) -> Self | None:
        """The identity in a file; None where the file is missing or not whole."""
        try:
            return cls(**json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):
            return None

    def write(self, path: Path) -> None:
        """Write the identity to a file, in one step; its folder is made."""
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(f".{path.name}.{os.getpid()}")
        temporary.write_text(json.dumps(asdict(self)), encoding="utf-8")
        temporary.replace(path)

    @property
    def is_of_this_machine(self) -> bool:
        """Whether this machine can tell if the process is there."""
        return self.host == socket.gethostname()

    def is_running(self) -> bool:
        """Whether the process is there. Raises ValueError where it is of another machine."""
        if not self.is_of_this_machine:
            raise ValueError(f"process {self.pid} is of {self.host}, which only that machine can tell")
        return self.boot_id == _read_boot_id() and _read_start_ticks(self.pid) == self.start_ticks


def _read_boot_id() -> str:
    return _BOOT_ID.read_text(encoding="ascii").strip()


def _read_start_ticks(pid: int) -> int | None:
    """Field 22 of the process's stat; None where there is no such process, or it has ended and waits for its parent."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    state, *rest = stat.rpartition(")")[2].split()  # the name before it can contain spaces and brackets
    return None if state in "ZX" else int(rest[18])
