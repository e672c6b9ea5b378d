"""Computation on blocks of arrays in several threads: NumPy releases the global interpreter lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

_MAX_WORKERS = 8

S = TypeVar("S")
T = TypeVar("T")


def map_blocks(function: Callable[[S], T], blocks: Sequence[S]) -> list[T]:
    """The results of ``function`` on each of ``blocks``, in order, in up to as many threads as there are processors."""
    workers = min(len(os.sched_getaffinity(0)), _MAX_WORKERS, len(blocks))
    if workers < 2:
        return [function(block) for block in blocks]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(function, blocks))
