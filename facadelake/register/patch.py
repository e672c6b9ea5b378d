"""The part of the surface inside a box: which of its rays' hits hang together, and how large they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facadelake.frames import Array
from facadelake.geobim.surface import Hits

_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, kw_only=True, eq=False)
class Patches:
    """Patches of n boxes; NaN where the box's centre missed.

    ``inside`` (n, g, g): which hits belong to the patch. ``width_m`` (n,) along the horizontal tangent of the centre's
    surface, ``height_m`` (n,) across it, ``area_m2`` (n,). ``target_share`` (n,): rays that met the building.
    """

    inside: NDArray[np.bool_]
    width_m: Array
    height_m: Array
    area_m2: Array
    target_share: Array


def tangents_of(normals_site: Array) -> tuple[Array, Array]:
    """Unit horizontal and upward tangents (n, 3) of surfaces with ``normals_site`` (n, 3).

    On a level surface, which has no horizontal tangent of its own, they are east and north.
    """
    across = np.cross(_UP, normals_site)
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    level = length < 0.05
    across = np.where(level, np.array([1.0, 0.0, 0.0]), across / np.where(level, 1.0, length))
    upward = np.cross(normals_site, across)
    return across, upward / np.linalg.norm(upward, axis=-1, keepdims=True)


def patches_of(hits: Hits, boxes: int, side: int, step_m: float) -> Patches:
    """Patches of ``boxes`` boxes whose ``side`` x ``side`` rays follow one another in ``hits``, row by row."""
    grid = (boxes, side, side)
    xyz = hits.xyz_site_m.reshape(*grid, 3)
    normal = hits.normal_site.reshape(*grid, 3)
    hit = hits.hit.reshape(grid)
    inside = _connected(xyz, normal, hit, step_m)
    middle = side // 2
    centre, facing = xyz[:, middle, middle], normal[:, middle, middle]
    across, upward = tangents_of(np.where(np.isfinite(facing), facing, _UP))
    offset = xyz - centre[:, None, None]
    missed = ~hit[:, middle, middle]
    return Patches(
        inside=inside,
        width_m=_extent(np.einsum("nijk,nk->nij", offset, across), inside, missed),
        height_m=_extent(np.einsum("nijk,nk->nij", offset, upward), inside, missed),
        area_m2=np.where(missed, np.nan, _area(xyz, inside)),
        target_share=hit.reshape(boxes, -1).mean(axis=1),
    )


def _connected(xyz: Array, normal: Array, hit: NDArray[np.bool_], step_m: float) -> NDArray[np.bool_]:
    """Cells reached from the centre over neighbours that lie in one another's tangent planes to ``step_m``."""
    down = _continues(xyz[:, :-1], xyz[:, 1:], normal[:, :-1], normal[:, 1:], step_m)
    right = _continues(xyz[:, :, :-1], xyz[:, :, 1:], normal[:, :, :-1], normal[:, :, 1:], step_m)
    inside = np.zeros_like(hit)
    middle = hit.shape[1] // 2
    inside[:, middle, middle] = hit[:, middle, middle]
    before = -1
    while inside.sum() != before:
        before = int(inside.sum())
        inside[:, 1:] |= inside[:, :-1] & down
        inside[:, :-1] |= inside[:, 1:] & down
        inside[:, :, 1:] |= inside[:, :, :-1] & right
        inside[:, :, :-1] |= inside[:, :, 1:] & right
    return inside


def _continues(a: Array, b: Array, normal_a: Array, normal_b: Array, step_m: float) -> NDArray[np.bool_]:
    """Whether neighbours lie on one surface: round an edge one tangent plane still holds, over a jump neither does."""
    step = b - a
    off = np.minimum(np.abs((step * normal_a).sum(axis=-1)), np.abs((step * normal_b).sum(axis=-1)))
    return np.asarray(off < step_m)  # NaN, a miss, is never below


def _extent(along: Array, inside: NDArray[np.bool_], missed: NDArray[np.bool_]) -> Array:
    flat, kept = along.reshape(len(along), -1), inside.reshape(len(along), -1)
    high = np.where(kept, flat, -np.inf).max(axis=1)
    low = np.where(kept, flat, np.inf).min(axis=1)
    with np.errstate(invalid="ignore"):
        return np.where(missed, np.nan, high - low)


def _area(xyz: Array, inside: NDArray[np.bool_]) -> Array:
    """Area of the grid's cells whose four corners are in the patch, each as two triangles."""
    a, b, c, d = xyz[:, :-1, :-1], xyz[:, :-1, 1:], xyz[:, 1:, 1:], xyz[:, 1:, :-1]
    whole = inside[:, :-1, :-1] & inside[:, :-1, 1:] & inside[:, 1:, 1:] & inside[:, 1:, :-1]
    cell = np.linalg.norm(np.cross(b - a, c - a), axis=-1) + np.linalg.norm(np.cross(c - a, d - a), axis=-1)
    area: Array = np.where(whole, cell, 0.0).sum(axis=(1, 2)) / 2
    return area
