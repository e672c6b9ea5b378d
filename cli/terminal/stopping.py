"""Ctrl-C and termination end a run at once and quietly, whatever libraries say of their own broken connections."""

from __future__ import annotations

import logging
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from rich.console import Console

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # the last: the terminal was closed
STOPPED = 130  # what shells give for a program ended by SIGINT


@contextmanager
def stoppable(console: Console) -> Iterator[None]:
    """Inside the block SIGINT, SIGTERM and SIGHUP end the program with a line of what to do next, in silence else.

    Ctrl-C in a terminal reaches Prefect's temporary server too; what then goes wrong between the two must neither
    hide the interrupt nor print tracebacks.
    """
    stopped = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal stopped
        stopped = True
        logging.disable(logging.CRITICAL)
        raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in SIGNALS}
    try:
        yield
    except BaseException:
        if stopped:
            console.print("stopped; finished stages are kept, run the same command to go on")
            raise SystemExit(STOPPED) from None
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
