"""Tie points of a reconstruction for the adjustment: a bounded selection, ordered so that neighbours stay together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64Nx2, Float64Nx3, Int64Array, RowIndices
from facadelake.core.frames import Similarity
from facadelake.georeferencing.adjustment.problem import Block
from facadelake.sfm import Reconstruction

# Each photograph keeps at least so many of its longest tracks: more raise the memory and not the accuracy.
TIE_POINTS_PER_PHOTO = 3000
# Lens distortion outside the camera model, and rolling shutters, shift neighbouring image points alike.
_CELLS = (6, 4)
_MIN_POINTS_PER_CELL = 5


@dataclass(frozen=True, kw_only=True, eq=False)
class TiePointSelection:
    """The selected tie points and their image points.

    ``reconstruction_point`` (t,) rows of the reconstruction's points, ``xyz_site_m`` (t, 3). Image point k: photograph
    ``photo[k]`` shows tie point ``point[k]`` (row of the selection) at ``xy_img[k]``.
    """

    reconstruction_point: RowIndices
    xyz_site_m: Float64Nx3
    photo: RowIndices
    point: RowIndices
    xy_img: Float64Nx2

    def __len__(self) -> int:
        return len(self.reconstruction_point)


def choose_tie_points(
    reconstruction: Reconstruction, site_from_sfm: Similarity, max_per_photo: int = TIE_POINTS_PER_PHOTO
) -> TiePointSelection:
    """The tie points among the ``max_per_photo`` longest tracks of any photograph, sorted by their first photograph."""
    photo, point = reconstruction.image_point_photo, reconstruction.image_point_tie_point
    length = np.bincount(point, minlength=len(reconstruction.xyz_sfm))
    # Rank of each image point within its photograph, longest track first.
    order = np.lexsort((point, -length[point], photo))
    begin = np.searchsorted(photo[order], np.arange(len(reconstruction.photos)))
    rank = np.empty(len(photo), dtype=np.int64)
    rank[order] = np.arange(len(photo)) - begin[photo[order]]
    best = np.full(len(length), np.iinfo(np.int64).max)
    np.minimum.at(best, point, rank)
    first = np.full(len(length), len(reconstruction.photos))
    np.minimum.at(first, point, photo)
    chosen = np.flatnonzero((best < max_per_photo) & (length >= 2))
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
    """The photographs of ``reconstruction`` transformed by ``site_from_sfm``; equal cameras are one camera."""
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


def estimate_tie_variance_factor(residual: Float64Nx2, photo: Int64Array, xy_img: Float64Nx2) -> float:
    """Factor (1 or more) on the variance of tie points' image coordinates, because neighbouring errors are correlated.

    Whitened residuals (k, 2) are averaged over cells of each photograph. The mean of n independent errors has a
    variance of 1/n; a larger one shows correlation. Without the factor an adjustment of ten thousand points states a
    precision of millimetres that its lens model does not support.
    """
    inlier = (residual**2).sum(axis=1) < 9.0  # outliers have no weight in the adjustment either
    residual, photo, xy_img = residual[inlier], photo[inlier], xy_img[inlier]
    span = xy_img.max(axis=0) + 1e-9
    cell = (xy_img / span * np.array(_CELLS)).astype(np.int64)
    number = (photo * _CELLS[0] + cell[:, 0]) * _CELLS[1] + cell[:, 1]
    count = np.bincount(number)
    used = count >= _MIN_POINTS_PER_CELL
    if not used.any():
        return 1.0
    sums = np.stack([np.bincount(number, weights=residual[:, axis]) for axis in range(2)], axis=1)
    squared = np.bincount(number, weights=(residual**2).sum(axis=1))
    # n |mean|^2 over the mean square of single residuals of the same cell: 1 where they are independent
    between = (sums[used] ** 2).sum(axis=1) / count[used]
    within = squared[used] / count[used]
    return max(1.0, float(between.sum() / within.sum()))
