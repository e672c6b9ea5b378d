"""Progress of long operations, reported to a listener (the command line draws bars; a server run logs).

The domain calls ``track`` or ``report_progress``; a front end installs a listener with ``listen_to_progress``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sized
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol, TypeVar

T = TypeVar("T")


class ProgressListener(Protocol):
    """Receives the begin, advance and end of operations."""

    def begin(self, label: str, total: int | None) -> int:
        """An operation of ``total`` steps (None: unknown) begins; returns its handle."""

    def advance(self, handle: int, steps: int) -> None:
        """``steps`` more steps are completed."""

    def end(self, handle: int) -> None:
        """The operation ended, with or without an error."""


class _NullListener:
    def begin(self, label: str, total: int | None) -> int:
        return 0

    def advance(self, handle: int, steps: int) -> None:
        pass

    def end(self, handle: int) -> None:
        pass


_NULL_LISTENER = _NullListener()
_listener: ContextVar[ProgressListener] = ContextVar("facadelake_progress", default=_NULL_LISTENER)


@contextmanager
def listen_to_progress(listener: ProgressListener) -> Iterator[None]:
    """Report all progress inside the block to ``listener``."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


class ProgressStep:
    """Handle of one operation: call ``advance`` for completed steps."""

    def __init__(self, listener: ProgressListener, handle: int) -> None:
        self._listener, self._handle = listener, handle

    def advance(self, steps: int = 1) -> None:
        """Report ``steps`` more completed steps."""
        self._listener.advance(self._handle, steps)


@contextmanager
def report_progress(label: str, total: int | None = None) -> Iterator[ProgressStep]:
    """Report the block as an operation of ``total`` steps (None: unknown); it ends with the block."""
    listener = _listener.get()
    handle = listener.begin(label, total)
    try:
        yield ProgressStep(listener, handle)
    finally:
        listener.end(handle)


def track(items: Iterable[T], *, label: str, total: int | None = None) -> Iterator[T]:
    """Iterate over ``items``, reporting one step for each; ``total`` is needed where the items have no length."""
    count = total if total is not None else (len(items) if isinstance(items, Sized) else None)
    with report_progress(label, count) as step:
        for item in items:
            yield item
            step.advance()
