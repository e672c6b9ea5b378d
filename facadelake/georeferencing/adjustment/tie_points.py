"""Tie points of a reconstruction as sightings of nodes: a bounded choice of them, in an order that keeps neighbours
together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64Array, Int64Array, RowIndices
from facadelake.core.frames import Similarity
from facadelake.georeferencing.adjustment.problem import Block
from facadelake.sfm import Reconstruction

# Each photograph keeps at least so many of its longest tracks: beyond it accuracy no longer grows, memory does.
TIE_POINTS_PER_PHOTO = 3000
# Lens distortion that the model does not have, and rolling shutters, push neighbouring points the same way.
_CELLS = (6, 4)
_MIN_POINTS_PER_CELL = 5


@dataclass(frozen=True, kw_only=True, eq=False)
class TiePointSelection:
    """The chosen tie points: ``point`` (t,) rows of the reconstruction's points, ``xyz_site_m`` (t, 3), and their
    sightings: ``photo`` (k,), ``point`` (k,) row of ``point``, ``xy_img`` (k, 2)."""

    reconstruction_point: RowIndices
    xyz_site_m: Float64Array
    photo: RowIndices
    point: RowIndices
    xy_img: Float64Array


def choose_tie_points(
    reconstruction: Reconstruction, site_from_sfm: Similarity, most_per_photo: int = TIE_POINTS_PER_PHOTO
) -> TiePointSelection:
    """The tie points that are among the longest tracks of any photograph that sees them, sorted by first photograph."""
    photo, point = reconstruction.image_point_photo, reconstruction.image_point_tie_point
    length = np.bincount(point, minlength=len(reconstruction.xyz_sfm))
    # Rank of each sighting within its photograph, longest track first.
    order = np.lexsort((point, -length[point], photo))
    begin = np.searchsorted(photo[order], np.arange(len(reconstruction.photos)))
    rank = np.empty(len(photo), dtype=np.int64)
    rank[order] = np.arange(len(photo)) - begin[photo[order]]
    best = np.full(len(length), np.iinfo(np.int64).max)
    np.minimum.at(best, point, rank)
    first = np.full(len(length), len(reconstruction.photos))
    np.minimum.at(first, point, photo)
    chosen = np.flatnonzero((best < most_per_photo) & (length >= 2))
    chosen = chosen[np.argsort(first[chosen], kind="stable")]
    row = np.full(len(length), -1)
    row[chosen] = np.arange(len(chosen))
    kept = row[point] >= 0
    return TiePointSelection(
        reconstruction_point=chosen,
        xyz_site_m=site_from_sfm.apply(reconstruction.xyz_sfm[chosen]),
        photo=photo[kept],
        point=row[point[kept]],
        xy_img=reconstruction.image_point_xy_img[kept],
    )


def build_block(reconstruction: Reconstruction, site_from_sfm: Similarity) -> Block:
    """The photographs of ``reconstruction`` placed by ``site_from_sfm``; equal cameras are one camera."""
    cameras = tuple(dict.fromkeys(photo.camera for photo in reconstruction.photos))
    number = {camera: k for k, camera in enumerate(cameras)}
    return Block(
        cameras=cameras,
        camera_of_photo=np.array([number[photo.camera] for photo in reconstruction.photos]),
        centre_site_m=site_from_sfm.apply(reconstruction.centres_sfm),
        site_from_cam=np.array(
            [site_from_sfm.rotation @ photo.sfm_from_cam.rotation for photo in reconstruction.photos]
        ).reshape(-1, 3, 3),
    )


def estimate_tie_variance_factor(residual: Float64Array, photo: Int64Array, xy_img: Float64Array) -> float:
    """By what factor (1 or more) the tie points' variance must grow because their errors are not independent.

    Whitened residuals (k, 2) are averaged over cells of each photograph. The mean of n independent errors has a
    variance of 1/n; where it has more, the same number of points knows less. Without it an adjustment of ten
    thousand points claims millimetres that its lens model does not hold.
    """
    inner = (residual**2).sum(axis=1) < 9.0  # outliers have no weight in the adjustment either
    residual, photo, xy_img = residual[inner], photo[inner], xy_img[inner]
    span = xy_img.max(axis=0) + 1e-9
    cell = (xy_img / span * np.array(_CELLS)).astype(np.int64)
    place = (photo * _CELLS[0] + cell[:, 0]) * _CELLS[1] + cell[:, 1]
    count = np.bincount(place)
    crowded = count >= _MIN_POINTS_PER_CELL
    if not crowded.any():
        return 1.0
    sums = np.stack([np.bincount(place, weights=residual[:, axis]) for axis in range(2)], axis=1)
    squared = np.bincount(place, weights=(residual**2).sum(axis=1))
    # n |mean|^2 against what single residuals of the same cell say: 1 where they are independent
    between = (sums[crowded] ** 2).sum(axis=1) / count[crowded]
    within = squared[crowded] / count[crowded]
    return max(1.0, float(between.sum() / within.sum()))
