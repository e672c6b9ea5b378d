"""Examples made in processes of their own while the network computes. No torch in here: the processes stay small."""

from __future__ import annotations

import multiprocessing
import queue
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.synchronize import Event
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from training.data.sample import Sample
from training.mix import Example, Mix, Pool
from training.sources import Source, training_sources
from training.view import View, view_of

Batch = tuple[NDArray[np.uint8], list[NDArray[np.float64]], list[NDArray[np.int64]]]
_AHEAD = 6  # batches that wait
_TILE_PX = 640


def pool_of(source: Source) -> Pool:
    """Read a source's pictures; a site is drawn as often as the root of the number of its pictures says."""
    views: list[View] = []
    sites: list[str] = []
    for sample in source.samples:
        made = _views(sample)
        views += made
        sites += [sample.site] * len(made)
    counts = Counter(sites)
    weights = np.array([counts[site] ** -0.5 for site in sites])
    return Pool(name=source.name, share=source.share, views=views, weights=weights / weights.sum())


def _views(sample: Sample) -> list[View]:
    """The picture as a whole; where it is large and free of defects, tiles in full resolution too."""
    views = [view_of(sample)]
    if len(sample.classes):
        return views
    image = sample.read()
    height, width = image.shape[:2]
    if max(height, width) <= _TILE_PX * 1.3:
        return views
    for top in np.linspace(0, max(height - _TILE_PX, 0), max(1, round(height / _TILE_PX))).astype(int):
        for left in np.linspace(0, max(width - _TILE_PX, 0), max(1, round(width / _TILE_PX))).astype(int):
            tile = image[top : top + _TILE_PX, left : left + _TILE_PX].copy()
            views.append(View(image=tile, boxes_px=sample.boxes_px, classes=sample.classes, paths=()))
    return views


def mix_of(sources: Sequence[Source], side_px: int) -> Mix:
    """Everything to draw from."""
    pools = [pool_of(source) for source in sources]
    walls = next(pool for pool in pools if pool.name == "negatives")
    return Mix(pools=pools, walls=walls, side_px=side_px, transplant_share=0.2, mosaic_share=0.35)


@dataclass(frozen=True, kw_only=True)
class Order:
    """What a loading process is to make."""

    data: Path
    generated: tuple[Path, ...]
    side_px: int
    batch: int
    seed: int


def batches(order: Order, *, stop: Event, mosaic: Event) -> Iterator[Batch]:
    """Endless batches from a process of its own, until ``stop``; mosaics as long as ``mosaic`` is set."""
    context = multiprocessing.get_context("spawn")
    waiting = context.Queue(maxsize=_AHEAD)
    worker = context.Process(target=_work, args=(order, stop, mosaic, waiting), daemon=True)
    worker.start()
    while not stop.is_set():
        try:
            yield waiting.get(timeout=120)
        except queue.Empty:
            if not worker.is_alive():
                raise RuntimeError("the process that makes training pictures has ended; its message is above") from None
    worker.join(timeout=10)


def _work(order: Order, stop: Event, mosaic: Event, waiting: multiprocessing.Queue[Batch]) -> None:
    cv2.setNumThreads(1)
    rng = np.random.default_rng(order.seed)
    mix = mix_of(training_sources(order.data, order.generated), order.side_px)
    while not stop.is_set():
        examples = [mix.example(rng, mosaic_share=None if mosaic.is_set() else 0.0) for _ in range(order.batch)]
        made = pack(examples)
        while not stop.is_set():
            try:
                waiting.put(made, timeout=1)
                break
            except queue.Full:
                parent = multiprocessing.parent_process()
                if parent is None or not parent.is_alive():  # killed: nobody will take another batch
                    waiting.cancel_join_thread()
                    return


def pack(examples: Sequence[Example]) -> Batch:
    """Arrays for the queue."""
    images = np.stack([example.image for example in examples])
    return images, [example.boxes_px for example in examples], [example.classes for example in examples]
