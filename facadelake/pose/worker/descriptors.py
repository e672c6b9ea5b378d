"""One descriptor for each tie point, by which a later campaign's points are matched with this one's."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

_DIMENSIONS = 128


def representative_descriptors(
    model: pycolmap.Reconstruction, database_path: Path, row_of_point: dict[int, int]
) -> NDArray[np.uint8]:
    """SIFT descriptors (m, 128) of the points, in the rows given: of each track the one nearest to its mean.

    It is one that a photograph really held, not the mean itself: a mean of histograms is smoother than any of them, so
    distances to it shrink, and a ratio test meant for single descriptors would no longer say what it should.
    """
    total = np.zeros((len(row_of_point), _DIMENSIONS), dtype=np.float32)
    sightings = np.zeros(len(row_of_point), dtype=np.float32)
    with pycolmap.Database.open(database_path) as database:
        for rows, found in _of_photographs(model, database, row_of_point):
            np.add.at(total, rows, found)
            np.add.at(sightings, rows, 1)
        mean = total / np.maximum(sightings, 1)[:, None]
        nearest = np.full(len(row_of_point), np.inf, dtype=np.float32)
        chosen = np.zeros((len(row_of_point), _DIMENSIONS), dtype=np.uint8)
        for rows, found in _of_photographs(model, database, row_of_point):
            distance = np.sum((found - mean[rows]) ** 2, axis=1)
            # Farthest first: where a photograph saw a point twice, the nearer one is written last.
            order = [k for k in np.argsort(-distance, kind="stable") if distance[k] < nearest[rows[k]]]
            nearest[rows[order]] = distance[order]
            chosen[rows[order]] = found[order]
    return chosen


def _of_photographs(
    model: pycolmap.Reconstruction, database: pycolmap.Database, row_of_point: dict[int, int]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.uint8]]]:
    """Of each posed photograph, the rows of the points that it saw and their descriptors there."""
    for image_id in sorted(model.reg_image_ids()):
        image = model.images[image_id]
        seen = [row_of_point[point.point3D_id] for point in image.get_observation_points2D()]
        if seen:
            found = database.read_descriptors(image_id).data[image.get_observation_point2D_idxs()]
            yield np.array(seen, dtype=np.int64), found
