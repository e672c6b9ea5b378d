"""Blocks of arrays worked on by several threads: numpy lets go of Python's lock while it computes."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

_MAX_WORKERS = 8

S = TypeVar("S")
T = TypeVar("T")


def map_blocks(work: Callable[[S], T], parts: Sequence[S]) -> list[T]:
    """The results of ``work`` on each of ``parts``, in their order, on as many threads as there are processors."""
    workers = min(len(os.sched_getaffinity(0)), _MAX_WORKERS, len(parts))
    if workers < 2:
        return [work(part) for part in parts]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(work, parts))
