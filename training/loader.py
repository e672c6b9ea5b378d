"""Training examples from a separate process, while the network computes; without torch, to limit its memory."""

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

from facadelake.core.arrays import Float64Array, Int64Array, UInt8Image
from training.data.sample import Sample
from training.mix import Example, Mix, Pool
from training.sources import Source, read_training_sources
from training.view import View, read_view

Batch = tuple[UInt8Image, list[Float64Array], list[Int64Array]]
_QUEUE_BATCHES = 6  # largest number of batches in the queue
_TILE_PX = 640


def read_pool(source: Source) -> Pool:
    """Read the pictures of a source; the weight of a site is the square root of its number of pictures."""
    views: list[View] = []
    sites: list[str] = []
    for sample in source.samples:
        sample_views = _read_views(sample)
        views += sample_views
        sites += [sample.site] * len(sample_views)
    counts = Counter(sites)
    weights = np.array([counts[site] ** -0.5 for site in sites])
    return Pool(name=source.name, share=source.share, views=views, weights=weights / weights.sum())


def _read_views(sample: Sample) -> list[View]:
    """The whole picture; if it is large and free of defects, also its tiles in full resolution."""
    views = [read_view(sample)]
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


def read_mix(sources: Sequence[Source], side_px: int) -> Mix:
    """Read the pictures of all sources."""
    pools = [read_pool(source) for source in sources]
    walls = next(pool for pool in pools if pool.name == "negatives")
    return Mix(pools=pools, walls=walls, side_px=side_px, transplant_share=0.2, mosaic_share=0.35)


@dataclass(frozen=True, kw_only=True)
class LoaderOptions:
    """Sources, size of pictures and batches, and seed of a loading process."""

    data: Path
    generated: tuple[Path, ...]
    side_px: int
    batch: int
    seed: int


def generate_batches(options: LoaderOptions, *, stop: Event, mosaic: Event) -> Iterator[Batch]:
    """Generate batches in a separate process until ``stop`` is set, with mosaics while ``mosaic`` is set."""
    context = multiprocessing.get_context("spawn")
    batches = context.Queue(maxsize=_QUEUE_BATCHES)
    worker = context.Process(target=_produce_batches, args=(options, stop, mosaic, batches), daemon=True)
    worker.start()
    while not stop.is_set():
        try:
            yield batches.get(timeout=120)
        except queue.Empty:
            if not worker.is_alive():
                raise RuntimeError(
                    "the process that generates training examples has ended; its message is above"
                ) from None
    worker.join(timeout=10)


def _produce_batches(options: LoaderOptions, stop: Event, mosaic: Event, batches: multiprocessing.Queue[Batch]) -> None:
    cv2.setNumThreads(1)
    rng = np.random.default_rng(options.seed)
    mix = read_mix(read_training_sources(options.data, options.generated), options.side_px)
    while not stop.is_set():
        examples = [mix.draw_example(rng, mosaic_share=None if mosaic.is_set() else 0.0) for _ in range(options.batch)]
        batch = pack_batch(examples)
        while not stop.is_set():
            try:
                batches.put(batch, timeout=1)
                break
            except queue.Full:
                parent = multiprocessing.parent_process()
                if parent is None or not parent.is_alive():  # the parent was killed: no further batch is taken
                    batches.cancel_join_thread()
                    return


def pack_batch(examples: Sequence[Example]) -> Batch:
    """Arrays of a batch of examples."""
    images = np.stack([example.image for example in examples])
    return images, [example.boxes_px for example in examples], [example.classes for example in examples]
