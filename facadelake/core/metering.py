"""How long a piece of work took and how much memory it held at most, its child processes included."""

from __future__ import annotations

import threading
import time
from types import TracebackType

import psutil


class Meter:
    """Measures the block it is the context of: ``seconds`` (wall), ``peak_mib`` (resident, children included).

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
        me = psutil.Process()
        while True:
            total = 0
            try:
                for process in [me, *me.children(recursive=True)]:
                    try:
                        total += process.memory_info().rss
                    except psutil.Error:
                        continue  # it ended meanwhile
            except psutil.Error:
                pass
            self.peak_mib = max(self.peak_mib, total / 2**20)
            if self._stop.wait(0.2):
                return
