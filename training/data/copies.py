"""Copies of pictures across splits: rotated, mirrored, brightened, grey and noisy copies are detected.

`python -m training.data.copies` prints the most similar pairs across splits. Shifted copies are not detected; they were
assigned to the same site by matched features (README.md).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from facadelake.core.arrays import Float32Array, UInt8Image
from training.data.cracks import read_crack_boxes
from training.data.sample import Sample

SIDE_PX = 96
COPY_MIN = 0.6  # correlation of copies; that of different pictures of one wall is below 0.4


@dataclass(frozen=True, kw_only=True)
class PicturePair:
    """Two pictures of different splits and their correlation (-1 to 1), the highest over rotations and mirroring."""

    first: Sample
    second: Sample
    correlation: float


def find_similar_pairs(samples: Sequence[Sample], count: int = 20) -> tuple[PicturePair, ...]:
    """The `count` most similar pairs of pictures of different splits, most similar first."""
    fields = [_compute_local_contrast(sample.read()) for sample in samples]
    plain = _normalise_rows(fields)
    best = np.full((len(samples), len(samples)), -1.0, dtype=np.float32)
    for turns in range(4):
        for mirrored in (False, True):
            transformed = [np.rot90(field[:, ::-1] if mirrored else field, turns) for field in fields]
            np.maximum(best, _normalise_rows(transformed) @ plain.T, out=best)
    splits = np.array([sample.split.value for sample in samples])
    best[splits[:, None] == splits[None, :]] = -1
    best = np.triu(np.maximum(best, best.T), 1)
    order = np.argsort(best, axis=None)[::-1][:count]
    pairs = zip(*np.unravel_index(order, best.shape), strict=True)
    return tuple(PicturePair(first=samples[i], second=samples[j], correlation=float(best[i, j])) for i, j in pairs)


def _compute_local_contrast(image: UInt8Image) -> Float32Array:
    """Local contrast (96, 96) of a picture, which does not depend on light, colour and noise."""
    grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (0, 0), image.shape[0] / 213)
    small = cv2.resize(grey, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA).astype(np.float32)
    high = small - cv2.GaussianBlur(small, (0, 0), 8)
    return np.asarray(high / (np.sqrt(cv2.GaussianBlur(high * high, (0, 0), 8)) + 1), dtype=np.float32)


def _normalise_rows(fields: Sequence[Float32Array]) -> Float32Array:
    rows = np.array(fields, dtype=np.float32).reshape(len(fields), -1)
    rows -= rows.mean(axis=1, keepdims=True)
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True), dtype=np.float32)


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m training.data.copies", description="Copies across splits.")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder with defects/")
    options = parser.parse_args()
    for pair in find_similar_pairs(read_crack_boxes(options.data / "defects")):
        ends = [f"{one.path.stem} ({one.site.split('/')[1]}, {one.split.value})" for one in (pair.first, pair.second)]
        print(f"{pair.correlation:.2f}  {'  '.join(ends)}{'  A COPY' if pair.correlation > COPY_MIN else ''}")


if __name__ == "__main__":
    main()
