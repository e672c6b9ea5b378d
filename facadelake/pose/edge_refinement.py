"""The last centimetres of a shift that the model's edges tell: sightings of edges, each feature with its own deviation.

The search compares shifts on a grid of centimetres. Here the edges are met to the pixel around the shift that was
found, and the shift is solved for together with a deviation of each feature from the model, robustly: a feature that
was built, or met, decimetres off loses its say. Only the directions that nothing else observes are moved; were edges
let loose on the whole block, those met at a frame's other side would turn and stretch it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

import numpy as np

from facadelake.camera import PosedCamera
from facadelake.frames import Array, Similarity
from facadelake.pose.adjustment.linearise import cauchy
from facadelake.pose.edge_matching import EdgeSightings

logger = logging.getLogger(__name__)

_ROUNDS = 3
_STEPS = 10
_REACH_M = 0.25
_STEP_M = 1e-3  # of the difference quotients
_SIGHTING_LIMIT = 2.4
_FEATURE_LIMIT = 1.5
_INDEPENDENT_ON_AN_EDGE = 4.0  # samples along one edge in one photograph err together


def refine_shift(
    cameras: Sequence[PosedCamera],
    sight: Callable[[Sequence[PosedCamera], float], EdgeSightings],
    free: Array,
    start_site_m: Array,
    feature_sigma_m: float,
) -> Array:
    """The shift (3,) of the cameras along ``free`` (j, 3), from ``start_site_m`` (3,) on; metres in site.

    ``feature_sigma_m``: how far a feature (a row of sills) may stand off the model. Where no edge is sighted the start
    is returned, for the search has told it.
    """
    shift = np.asarray(start_site_m, dtype=np.float64)
    for _ in range(_ROUNDS):
        now = [moved(camera, shift) for camera in cameras]
        seen = sight(now, _REACH_M)
        if not len(seen.photo):
            return shift
        step = _solved(now, seen, free, feature_sigma_m)
        shift = shift + step @ free
        logger.debug("edges move the shift by %s m", np.round(step, 4))
    return shift


def moved(camera: PosedCamera, shift_site_m: Array) -> PosedCamera:
    """The camera moved by ``shift_site_m`` (3,)."""
    pose = camera.site_from_cam
    return PosedCamera(
        camera=camera.camera,
        site_from_cam=Similarity(rotation=pose.rotation, translation=pose.translation + shift_site_m),
    )


def _solved(cameras: Sequence[PosedCamera], seen: EdgeSightings, free: Array, feature_sigma_m: float) -> Array:
    """The step (j,) along ``free``."""
    residual, by_point = _linearised(cameras, seen)
    by_shift = -by_point @ free.T
    _, feature = np.unique(seen.feature, return_inverse=True)
    feature = feature.ravel()
    _, piece, size = np.unique(
        np.column_stack([seen.photo, seen.feature]), axis=0, return_inverse=True, return_counts=True
    )
    share = np.minimum(_INDEPENDENT_ON_AN_EDGE / size[piece.ravel()], 1.0)
    rows = [np.flatnonzero(feature == number) for number in range(int(feature.max()) + 1)]
    step: Array = np.zeros(len(free))
    deviation: Array = np.zeros((len(rows), 3))
    for _ in range(_STEPS):
        left = residual + by_shift @ step + np.einsum("ki,ki->k", by_point, deviation[feature])
        weight = cauchy((left / seen.sigma_px) ** 2, _SIGHTING_LIMIT)[1] * share / seen.sigma_px**2
        trust = cauchy((deviation**2).sum(axis=1) / feature_sigma_m**2, _FEATURE_LIMIT)[1] / feature_sigma_m**2
        matrix, gradient = np.zeros((len(free), len(free))), np.zeros(len(free))
        solved = []
        for number, own in enumerate(rows):
            # The feature's deviation is eliminated: what is left of its sightings tells of the shift.
            weighted = by_point[own] * weight[own, None]
            inner = np.linalg.inv(weighted.T @ by_point[own] + np.eye(3) * trust[number])
            cross, pull = weighted.T @ by_shift[own], weighted.T @ residual[own]
            matrix += by_shift[own].T @ (by_shift[own] * weight[own, None]) - cross.T @ inner @ cross
            gradient += by_shift[own].T @ (weight[own] * residual[own]) - cross.T @ inner @ pull
            solved.append((inner, cross, pull))
        step = -np.linalg.solve(matrix + 1e-9 * np.eye(len(free)), gradient).astype(np.float64)
        deviation = np.array([-inner @ (pull + cross @ step) for inner, cross, pull in solved])
    return step


def _linearised(cameras: Sequence[PosedCamera], seen: EdgeSightings) -> tuple[Array, Array]:
    """Residuals (k,) in pixels along the edges' normals, and their derivatives (k, 3) by the point in site."""
    residual, by_point = np.zeros(len(seen.photo)), np.zeros((len(seen.photo), 3))
    for photo in np.unique(seen.photo):
        own = np.flatnonzero(seen.photo == photo)
        at = cameras[photo].project_site(seen.xyz_site_m[own])
        residual[own] = ((at - seen.xy_img[own]) * seen.normal_img[own]).sum(axis=1)
        for axis in range(3):
            aside = np.zeros(3)
            aside[axis] = _STEP_M
            beside = cameras[photo].project_site(seen.xyz_site_m[own] + aside)
            by_point[own, axis] = ((beside - at) * seen.normal_img[own]).sum(axis=1) / _STEP_M
    return residual, by_point
