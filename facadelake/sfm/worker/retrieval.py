"""Image retrieval by the campaign's own descriptors: partners for photographs with uncertain positions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from facadelake.core.arrays import Float32Array, Int64Array

# Measured on 29 street photographs without positions: with 12 partners each, 32 to 128 visual words find 93 to 96 % of
# the matching pairs (COLMAP's vocabulary tree, trained on the same descriptors: 88 %). With 6 partners each it is 81 %,
# and 100 % after the partners' partners.
_VOCABULARY_SIZE = 64
_LLOYD_ITERATIONS = 8
_TRAINING_DESCRIPTORS = 20_000  # of all photographs together
_MAX_FEATURES = 1000  # the largest, which are visible from other viewpoints


def pair_by_appearance(
    job: dict[str, Any], queries: list[int], partners: int, database_path: Path, image_id_of: dict[int, int]
) -> list[tuple[int, int]]:
    """Pairs (i < j) of photographs with those most similar to them.

    Photographs are compared by their vectors of locally aggregated descriptors (VLAD, Jegou et al. 2010), normalised
    within each visual word (Arandjelovic and Zisserman 2013). The visual words come from the campaign itself, so
    nothing is downloaded.

    Args:
        job: the job, with photographs and seed.
        queries: indices of the photographs that need partners.
        partners: number of partners of each.
        database_path: COLMAP's database of the job, with features.
        image_id_of: index in the job -> image id.

    Returns:
        The pairs, sorted.
    """
    if not queries:
        return []
    rng = np.random.default_rng(job["settings"]["seed"])
    with pycolmap.Database.open(database_path) as database:
        image_ids = [image_id_of[index] for index in range(len(job["photos"]))]
        descriptors_per_photo = max(_TRAINING_DESCRIPTORS // len(image_ids), 20)
        sample = np.vstack(
            [
                rng.permutation(_read_largest_descriptors(database, image_id))[:descriptors_per_photo]
                for image_id in image_ids
            ]
        )
        visual_words = _build_vocabulary(sample, rng)
        vlads = np.array(
            [_compute_vlad(_read_largest_descriptors(database, image_id), visual_words) for image_id in image_ids]
        )
    pairs: set[tuple[int, int]] = set()
    for i in queries:
        similarity = vlads @ vlads[i]
        similarity[i] = -np.inf
        nearest = np.argsort(-similarity, kind="stable")[: min(partners, len(vlads) - 1)]
        pairs |= {(min(i, int(j)), max(i, int(j))) for j in nearest}
    return sorted(pairs)


def pair_transitively(
    queries: list[int], pairs: list[tuple[int, int]], partners: int, database_path: Path, image_id_of: dict[int, int]
) -> list[tuple[int, int]]:
    """New pairs (i < j) of photographs with the verified partners of their verified partners.

    As COLMAP's transitive matching, limited to ``partners`` for each photograph: those with the largest sum, over the
    connecting photographs, of the weaker link's inliers.

    Args:
        queries: indices of the photographs that need partners.
        pairs: the pairs matched so far.
        partners: largest number of new partners of each.
        database_path: COLMAP's database of the job, with verified matches.
        image_id_of: index in the job -> image id.

    Returns:
        Pairs not in ``pairs``, sorted.
    """
    with pycolmap.Database.open(database_path) as database:
        inliers_of_pair = dict(zip(*database.read_two_view_geometry_num_inliers(), strict=True))
    strength: dict[int, dict[int, int]] = {}
    for i, j in pairs:
        inliers = inliers_of_pair.get(pycolmap.image_pair_to_pair_id(image_id_of[i], image_id_of[j]), 0)
        if inliers:
            strength.setdefault(i, {})[j] = strength.setdefault(j, {})[i] = inliers
    matched, new = set(pairs), set()
    for i in queries:
        chains: dict[tuple[int, int], int] = {}
        for j, first_link in strength.get(i, {}).items():
            for k, second_link in strength[j].items():
                pair = (min(i, k), max(i, k))
                if k != i and pair not in matched:
                    chains[pair] = chains.get(pair, 0) + min(first_link, second_link)
        new |= set(sorted(chains, key=lambda pair: (-chains[pair], pair))[:partners])
    return sorted(new)


def _read_largest_descriptors(database: pycolmap.Database, image_id: int) -> Float32Array:
    """The descriptors of a photograph's largest features."""
    # Columns of a keypoint: x, y and a 2x2 matrix of rotation and scale.
    keypoints = np.asarray(database.read_keypoints(image_id)).reshape(-1, 6)
    descriptors = database.read_descriptors(image_id).data.reshape(-1, 128)
    size = np.hypot(keypoints[:, 2], keypoints[:, 3])
    return descriptors[np.argsort(-size, kind="stable")[:_MAX_FEATURES]].astype(np.float32)


def _assign_to_vocabulary(descriptors: Float32Array, visual_words: Float32Array) -> Int64Array:
    """The nearest visual word of each descriptor."""
    nearest: Int64Array = np.argmin(np.sum(visual_words**2, axis=1) - 2 * descriptors @ visual_words.T, axis=1)
    return nearest


def _build_vocabulary(sample: Float32Array, rng: np.random.Generator) -> Float32Array:
    """Centres of the descriptors, by Lloyd's iteration."""
    visual_words = rng.permutation(sample)[:_VOCABULARY_SIZE].copy()
    for _ in range(_LLOYD_ITERATIONS):
        nearest = _assign_to_vocabulary(sample, visual_words)
        for word in np.unique(nearest):
            visual_words[word] = sample[nearest == word].mean(axis=0)
    return visual_words


def _compute_vlad(descriptors: Float32Array, visual_words: Float32Array) -> Float32Array:
    """The VLAD of a photograph, of unit length (zero where it has no features)."""
    residuals = np.zeros(visual_words.shape, dtype=np.float32)
    nearest = _assign_to_vocabulary(descriptors, visual_words)
    np.add.at(residuals, nearest, descriptors - visual_words[nearest])
    residuals /= np.maximum(np.linalg.norm(residuals, axis=1, keepdims=True), 1e-9)
    vector = residuals.ravel()
    unit: Float32Array = vector / max(float(np.linalg.norm(vector)), 1e-9)
    return unit
