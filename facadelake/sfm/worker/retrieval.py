"""Which photographs look alike, from the campaign's own descriptors: partners where position priors say too little."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from facadelake.core.arrays import Float32Array, Int64Array

# Measured on 29 street photographs without positions: 32 to 128 words find 93 to 96 % of the matching pairs among 12
# partners each (COLMAP's vocabulary tree, trained on the same descriptors: 88 %). With 6 partners each it is 81 %, and
# 100 % after the partners' partners.
_VISUAL_WORDS = 64
_LLOYD_ITERATIONS = 8
_TRAINING_DESCRIPTORS = 20_000  # descriptors
_MAX_FEATURES = 1000  # the largest: they are seen again from elsewhere


def pair_by_appearance(
    job: dict[str, Any], sought: list[int], partners: int, database_path: Path, image_id_of: dict[int, int]
) -> list[tuple[int, int]]:
    """Pairs (i < j) of each photograph in ``sought`` with the ``partners`` that look most like it.

    Photographs are compared as vectors of locally aggregated descriptors (Jegou et al. 2010), normalised within each
    word (Arandjelovic and Zisserman 2013); the words come from the campaign itself, so nothing is downloaded.
    """
    if not sought:
        return []
    rng = np.random.default_rng(job["settings"]["seed"])
    with pycolmap.Database.open(database_path) as database:
        image_ids = [image_id_of[index] for index in range(len(job["photos"]))]
        each = max(_TRAINING_DESCRIPTORS // len(image_ids), 20)
        sample = np.vstack(
            [rng.permutation(_read_largest_descriptors(database, image_id))[:each] for image_id in image_ids]
        )
        words = _cluster_visual_words(sample, rng)
        looks = np.array(
            [_compute_vlad(_read_largest_descriptors(database, image_id), words) for image_id in image_ids]
        )
    pairs: set[tuple[int, int]] = set()
    for i in sought:
        alike = looks @ looks[i]
        alike[i] = -np.inf
        nearest = np.argsort(-alike, kind="stable")[: min(partners, len(looks) - 1)]
        pairs |= {(min(i, int(j)), max(i, int(j))) for j in nearest}
    return sorted(pairs)


def pair_transitively(
    sought: list[int], pairs: list[tuple[int, int]], partners: int, database_path: Path, image_id_of: dict[int, int]
) -> list[tuple[int, int]]:
    """New pairs (i < j) of each photograph in ``sought`` with its verified partners' verified partners.

    At most ``partners`` each, those first to which the weaker links of the chains are strongest together.
    """
    with pycolmap.Database.open(database_path) as database:
        found = dict(zip(*database.read_two_view_geometry_num_inliers(), strict=True))
    strength: dict[int, dict[int, int]] = {}
    for i, j in pairs:
        inliers = found.get(pycolmap.image_pair_to_pair_id(image_id_of[i], image_id_of[j]), 0)
        if inliers:
            strength.setdefault(i, {})[j] = strength.setdefault(j, {})[i] = inliers
    compared, new = set(pairs), set()
    for i in sought:
        chains: dict[tuple[int, int], int] = {}
        for j, first in strength.get(i, {}).items():
            for k, second in strength[j].items():
                pair = (min(i, k), max(i, k))
                if k != i and pair not in compared:
                    chains[pair] = chains.get(pair, 0) + min(first, second)
        new |= set(sorted(chains, key=lambda pair: (-chains[pair], pair))[:partners])
    return sorted(new)


def _read_largest_descriptors(database: pycolmap.Database, image_id: int) -> Float32Array:
    """The descriptors of a photograph's largest features."""
    keypoints = np.asarray(database.read_keypoints(image_id)).reshape(-1, 6)  # x, y and a 2x2 matrix: turn and size
    found = database.read_descriptors(image_id).data.reshape(-1, 128)
    size = np.hypot(keypoints[:, 2], keypoints[:, 3])
    return found[np.argsort(-size, kind="stable")[:_MAX_FEATURES]].astype(np.float32)


def _assign_visual_words(found: Float32Array, words: Float32Array) -> Int64Array:
    nearest: Int64Array = np.argmin(np.sum(words**2, axis=1) - 2 * found @ words.T, axis=1)
    return nearest


def _cluster_visual_words(sample: Float32Array, rng: np.random.Generator) -> Float32Array:
    """Centres of the descriptors, by Lloyd's iteration."""
    words = rng.permutation(sample)[:_VISUAL_WORDS].copy()
    for _ in range(_LLOYD_ITERATIONS):
        nearest = _assign_visual_words(sample, words)
        for word in np.unique(nearest):
            words[word] = sample[nearest == word].mean(axis=0)
    return words


def _compute_vlad(found: Float32Array, words: Float32Array) -> Float32Array:
    """The photograph's vector of unit length (zero where it has no features)."""
    look = np.zeros(words.shape, dtype=np.float32)
    nearest = _assign_visual_words(found, words)
    np.add.at(look, nearest, found - words[nearest])
    look /= np.maximum(np.linalg.norm(look, axis=1, keepdims=True), 1e-9)
    vector = look.ravel()
    unit: Float32Array = vector / max(float(np.linalg.norm(vector)), 1e-9)
    return unit
