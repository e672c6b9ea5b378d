"""Run time and peak memory of a block of code, child processes included."""

from __future__ import annotations

import threading
import time
from types import TracebackType

import psutil


class Meter:
    """Context manager that measures its block: ``seconds`` (wall time), ``peak_mib`` (resident set, children included).

    Memory is sampled five times a second, so a shorter peak can be missed.
    """

    seconds: float = 0.0
    peak_mib: float = 0.0

    def __enter__(self) -> Meter:
        self._stop = threading.Event()
        self._begin = time.perf_counter()
        self._thread = threading.Thread(target=self._sample, name="facadelake-meter", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.seconds = time.perf_counter() - self._begin
        self._stop.set()
        self._thread.join()

    def _sample(self) -> None:
        own_process = psutil.Process()
        while True:
            total = 0
            try:
                for process in [own_process, *own_process.children(recursive=True)]:
                    try:
                        total += process.memory_info().rss
                    except psutil.Error:
                        continue  # the process has ended
            except psutil.Error:
                pass
            self.peak_mib = max(self.peak_mib, total / 2**20)
            if self._stop.wait(0.2):
                return
