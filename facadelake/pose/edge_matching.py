"""Where the photographs show the model's edges: one-dimensional observations along the edges' normals.

A single sample cannot tell a lintel from the frame below it. So candidates are gathered from all photographs, and
each piece of an edge votes as a whole, by its offset in metres and the sign of its contrast; a piece whose votes are
split gives no observation.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from facadelake.camera import PosedCamera
from facadelake.frames import Array
from facadelake.geobim.edges import ModelEdges
from facadelake.geobim.surface import Surface
from facadelake.pose.edge_views import EdgeSamples, SeenSamples, sample_edges, seen_samples
from facadelake.pose.gradients import GreyPhotographs, gradients, reduction_for

_log = logging.getLogger(__name__)

_SPACING_M = 0.05
_PIECE_M = 3.0  # a longer edge votes in pieces: it may sag, or be hidden by something the model does not know
_FINEST_M = 0.004  # photographs are reduced so that a pixel is no smaller than this
_SIGMA_PX = 1.0
_STEP_PX = 0.5
_LEAST_GRADIENT = 0.35  # of what is usual around, after ``gradients``
_LEAST_REACH_PX = 2.0
_PARALLEL = 0.94  # cosine
_BIN_M = 0.005
_VOTE_BLUR_M = 0.01
_LEAST_VOTES = 12
_LEAST_SHARE = 0.3  # of a piece's samples must agree
_SPLIT = 0.8  # the second answer's votes, over the first's
_AGREE_M = 0.02
_MOST_OF_ONE_EDGE = 12  # observations of one piece in one photograph: neighbours repeat one another
_LOCALISED_PX = 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeSightings:
    """k observations: the residual is ``normal_img . (project(xyz_site_m + deviation of the feature) - xy_img)``.

    ``photo`` (k,) row of the photographs, ``feature`` (k,) of the edges, ``xyz_site_m`` (k, 3) on the model's edge,
    ``xy_img`` (k, 2) where the photograph shows it, ``normal_img`` (k, 2) unit, ``sigma_px`` (k,).
    """

    photo: NDArray[np.int64]
    feature: NDArray[np.int64]
    xyz_site_m: Array
    xy_img: Array
    normal_img: Array
    sigma_px: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class _Candidates:
    """Places where a sample's normal crosses an image edge; ``offset_px`` along the normal, ``contrast`` signed."""

    photo: NDArray[np.int64]
    sample: NDArray[np.int64]
    xy_img: Array
    normal_img: Array
    offset_px: Array
    pixel_m: Array
    contrast: Array


def sight_edges(
    cameras: Sequence[PosedCamera],
    photographs: GreyPhotographs,
    edges: ModelEdges,
    surface: Surface,
    *,
    reach_m: float,
) -> EdgeSightings:
    """Find the visible edges of the model in the photographs, up to ``reach_m`` beside where the cameras expect them.

    Photograph k of ``photographs`` was taken by ``cameras[k]``. Half way to a parallel edge of the model the reach
    ends, so that neighbours are not confused. Empty where no camera sees an edge.
    """
    samples = sample_edges(edges, _SPACING_M)
    found, seen_count = [], np.zeros(len(samples.edge), dtype=np.int64)
    for k, posed in enumerate(cameras):
        seen = seen_samples(samples, posed, surface, border_px=8.0)
        if len(seen.row) == 0:
            continue
        seen_count[seen.row] += 1
        found.append(_candidates(k, posed, seen, samples, photographs, reach_m))
    if not found:
        nothing = np.zeros(0, dtype=np.int64)
        return EdgeSightings(
            photo=nothing,
            feature=nothing,
            xyz_site_m=np.zeros((0, 3)),
            xy_img=np.zeros((0, 2)),
            normal_img=np.zeros((0, 2)),
            sigma_px=np.zeros(0),
        )
    return _voted(_together(found), seen_count, samples, edges, reach_m)


def _candidates(
    photo: int,
    posed: PosedCamera,
    seen: SeenSamples,
    samples: EdgeSamples,
    photographs: GreyPhotographs,
    reach_m: float,
) -> _Candidates:
    """Peaks of the gradient along each sample's normal, to a fraction of a pixel."""
    reduction = reduction_for(_FINEST_M / float(np.median(seen.pixel_m)), posed.camera)
    level = gradients(photographs.grey(photo, reduction), reduction=reduction, sigma_px=_SIGMA_PX)
    step = _STEP_PX * reduction
    reach_px = reach_m / seen.pixel_m
    half = int(np.ceil(min(float(reach_px.max()), 64.0 * reduction) / step)) + 1
    offsets = np.arange(-half, half + 1, dtype=np.float64) * step
    lines = seen.xy_img[:, None, :] + offsets[None, :, None] * seen.normal_img[:, None, :]
    reach_px = np.minimum(reach_px, _half_way(seen, samples, level.x.shape, reduction, offsets))
    across = level.across(lines, np.broadcast_to(seen.normal_img[:, None, :], lines.shape))
    size = np.abs(across)
    peak = np.zeros(size.shape, dtype=bool)
    peak[:, 1:-1] = (size[:, 1:-1] > size[:, :-2]) & (size[:, 1:-1] >= size[:, 2:]) & (size[:, 1:-1] > _LEAST_GRADIENT)
    peak &= (np.abs(offsets)[None] <= reach_px[:, None]) & (reach_px[:, None] >= _LEAST_REACH_PX * reduction)
    row, column = np.nonzero(peak)
    before, here, after = (size[row, column + k] for k in (-1, 0, 1))
    fraction = 0.5 * (before - after) / np.minimum(before - 2 * here + after, -1e-9)
    return _Candidates(
        photo=np.full(len(row), photo, dtype=np.int64),
        sample=seen.row[row],
        xy_img=seen.xy_img[row],
        normal_img=seen.normal_img[row],
        offset_px=offsets[column] + np.clip(fraction, -0.5, 0.5) * step,
        pixel_m=seen.pixel_m[row],
        contrast=across[row, column].astype(np.float64),
    )


def _half_way(seen: SeenSamples, samples: EdgeSamples, shape: tuple[int, ...], reduction: int, offsets: Array) -> Array:
    """Half the distance (n,) in pixels along the normal to the nearest other parallel edge of the model; inf: none."""
    edge = samples.edge[seen.row]
    drawn = np.zeros(shape[:2], dtype=np.int32)
    at = np.clip((seen.xy_img / reduction).astype(np.int32), 0, np.array(shape[1::-1]) - 1)
    joined = (edge[1:] == edge[:-1]) & (seen.row[1:] == seen.row[:-1] + 1)
    for k in np.flatnonzero(joined):
        cv2.line(drawn, at[k].tolist(), at[k + 1].tolist(), int(k) + 1, 1)
    lines = seen.xy_img[:, None, :] + offsets[None, :, None] * seen.normal_img[:, None, :]
    where = np.clip((lines / reduction).astype(np.int64), 0, np.array(shape[1::-1]) - 1)
    other = drawn[where[..., 1], where[..., 0]] - 1
    alike = np.abs(np.einsum("nki,ni->nk", seen.normal_img[other], seen.normal_img)) > _PARALLEL
    beside = (other >= 0) & (edge[other] != edge[:, None]) & alike & (np.abs(offsets) > 1.5 * reduction)[None]
    half: Array = np.where(beside, np.abs(offsets)[None] / 2, np.inf).min(axis=1)
    return half


def _together(parts: list[_Candidates]) -> _Candidates:
    names = ("photo", "sample", "xy_img", "normal_img", "offset_px", "pixel_m", "contrast")
    return _Candidates(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def _voted(
    found: _Candidates, seen_count: NDArray[np.int64], samples: EdgeSamples, edges: ModelEdges, reach_m: float
) -> EdgeSightings:
    """The candidates that agree with the vote of their piece of edge, thinned."""
    along = np.einsum("ij,ij->i", samples.xyz_site_m - edges.start_site_m[samples.edge], samples.direction)
    number = np.floor(along / _PIECE_M).astype(np.int64)
    _, piece = np.unique(np.column_stack([samples.edge, number]), axis=0, return_inverse=True)
    piece = piece.ravel()
    offset_m = found.offset_px * found.pixel_m
    bins = int(np.ceil(reach_m / _BIN_M)) * 2 + 1
    at = np.clip(np.round(offset_m / _BIN_M).astype(np.int64) + bins // 2, 0, bins - 1)
    of, dark = piece[found.sample], (found.contrast < 0).astype(np.int64)
    pieces = int(piece.max(initial=-1)) + 1
    votes = np.zeros((pieces, 2, bins))
    np.add.at(votes, (of, dark, at), np.abs(found.contrast))
    votes = gaussian_filter1d(votes, _VOTE_BLUR_M / _BIN_M, axis=2, mode="constant")
    # Equal votes far off and near: the near one is the edge, as-built is not that far from as-designed.
    centred = np.exp(-0.5 * ((np.arange(bins) - bins // 2) * _BIN_M / reach_m) ** 2)
    flat = (votes * centred).reshape(pieces, -1)
    first = flat.argmax(axis=1)
    chosen_m = (first % bins - bins // 2) * _BIN_M
    far = np.abs((np.arange(2 * bins) % bins - bins // 2) * _BIN_M - chosen_m[:, None]) > 2 * _AGREE_M
    second = np.where(far, flat, 0.0).max(axis=1)
    clear = second < _SPLIT * flat.max(axis=1)
    agree = clear[of] & (dark == (first // bins)[of]) & (np.abs(offset_m - chosen_m[of]) < _AGREE_M)
    support = np.bincount(of[agree], minlength=pieces)
    seen = np.bincount(piece, weights=seen_count, minlength=pieces)
    strong = (support >= _LEAST_VOTES) & (support >= _LEAST_SHARE * seen)
    _log.info("edges: %d pieces seen, %d clear, %d strong", int((seen > 0).sum()), int(clear.sum()), int(strong.sum()))
    kept = _thinned(np.flatnonzero(agree & strong[of]), found, of)
    return EdgeSightings(
        photo=found.photo[kept],
        feature=samples.feature[found.sample[kept]],
        xyz_site_m=samples.xyz_site_m[found.sample[kept]],
        xy_img=found.xy_img[kept] + found.offset_px[kept, None] * found.normal_img[kept],
        normal_img=found.normal_img[kept],
        sigma_px=np.maximum(_LOCALISED_PX, _LOCALISED_PX * _FINEST_M / found.pixel_m[kept]),
    )


def _thinned(rows: NDArray[np.int64], found: _Candidates, piece: NDArray[np.int64]) -> NDArray[np.int64]:
    """At most ``_MOST_OF_ONE_EDGE`` of the rows for each piece and photograph, evenly along it."""
    order = rows[np.lexsort((found.sample[rows], piece[rows], found.photo[rows]))]
    key = np.column_stack([found.photo[order], piece[order]])
    new = np.r_[True, (key[1:] != key[:-1]).any(axis=1)]
    first = np.flatnonzero(new)
    count = np.diff(np.r_[first, len(order)])
    rank = np.arange(len(order)) - np.repeat(first, count)
    total = np.repeat(count, count)
    most = np.minimum(total, _MOST_OF_ONE_EDGE)
    # Kept where the even ladder of ``most`` rungs takes a step.
    kept = (rank * most) // total != ((rank - 1) * most) // total
    thinned: NDArray[np.int64] = order[kept]
    return thinned
