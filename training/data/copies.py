"""Is a picture of one split a copy of one in another? Turned, mirrored, brightened, grey and noisy copies are found.

`python -m training.data.copies` prints the likest pairs across splits. Shifted copies are not found: those were joined
into sites by matched features (README.md).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from training.data.cracks import read_crack_boxes
from training.data.sample import Sample

SIDE_PX = 96
COPY = 0.6  # correlation above which two pictures are one; different pictures of one wall stay below 0.4


@dataclass(frozen=True, kw_only=True)
class Likeness:
    """Two pictures of unlike split and their correlation (-1 to 1) in the best of eight positions."""

    first: Sample
    second: Sample
    correlation: float


def likest_across_splits(samples: Sequence[Sample], count: int = 20) -> tuple[Likeness, ...]:
    """The `count` likest pairs whose splits differ, likest first."""
    fields = [_relief(sample.read()) for sample in samples]
    plain = _rows(fields)
    best = np.full((len(samples), len(samples)), -1.0, dtype=np.float32)
    for turns in range(4):
        for mirrored in (False, True):
            moved = [np.rot90(field[:, ::-1] if mirrored else field, turns) for field in fields]
            np.maximum(best, _rows(moved) @ plain.T, out=best)
    splits = np.array([sample.split.value for sample in samples])
    best[splits[:, None] == splits[None, :]] = -1
    best = np.triu(np.maximum(best, best.T), 1)
    order = np.argsort(best, axis=None)[::-1][:count]
    pairs = zip(*np.unravel_index(order, best.shape), strict=True)
    return tuple(Likeness(first=samples[i], second=samples[j], correlation=float(best[i, j])) for i, j in pairs)


def _relief(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """What stays when light, colour and noise are taken away: a small picture of local contrast."""
    grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (0, 0), image.shape[0] / 213)
    small = cv2.resize(grey, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA).astype(np.float32)
    high = small - cv2.GaussianBlur(small, (0, 0), 8)
    return np.asarray(high / (np.sqrt(cv2.GaussianBlur(high * high, (0, 0), 8)) + 1), dtype=np.float32)


def _rows(fields: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    rows = np.array(fields, dtype=np.float32).reshape(len(fields), -1)
    rows -= rows.mean(axis=1, keepdims=True)
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True), dtype=np.float32)


def main() -> None:
    """Read the command line and print."""
    parser = argparse.ArgumentParser(prog="python -m training.data.copies", description="Copies across splits.")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="holds defects/")
    given = parser.parse_args()
    for pair in likest_across_splits(read_crack_boxes(given.data / "defects")):
        ends = [f"{one.path.stem} ({one.site.split('/')[1]}, {one.split.value})" for one in (pair.first, pair.second)]
        print(f"{pair.correlation:.2f}  {'  '.join(ends)}{'  A COPY' if pair.correlation > COPY else ''}")


if __name__ == "__main__":
    main()
