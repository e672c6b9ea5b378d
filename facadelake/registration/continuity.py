"""Which samples of a detection lie on one continuous surface, and on which side of it the defect is."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from facadelake.building.surface import Hits
from facadelake.core.arrays import BoolArray, Int64Array
from facadelake.registration.attribution import find_majority_elements
from facadelake.registration.outline import TREE_SEPARATION, Outlines

_REACH_PITCHES = 4.1  # over which a surface continues behind a thin occluder, such as a bar
_SAME_SIDE_COSINE = np.cos(np.radians(45.0))


def find_patch_members(outlines: Outlines, hits: Hits, step_m: float) -> BoolArray:
    """Which samples (k,) belong to their detection's patch: the continuous surface with the largest sum of weights.

    Adjacent samples are continuous where one lies in the other's tangent plane to ``step_m``: at an edge one of the two
    planes holds, at a depth jump neither does. Where adjacent samples are not continuous, those within a few pitches
    are compared too, so that a wall behind a railing or around a deep window remains one patch.
    """
    continuous = _are_continuous(hits, outlines.neighbours, step_m)
    split = np.zeros(len(outlines), dtype=bool)
    split[outlines.detection[outlines.neighbours[~continuous, 0]]] = True
    # Detections without a discontinuity, and those of a single sample, keep all their hits.
    member: BoolArray = ~split[outlines.detection] & hits.hit
    rows = np.flatnonzero(split[outlines.detection])
    if not len(rows):
        return member
    detection, weight = outlines.detection[rows], np.where(hits.hit[rows], outlines.weight[rows], 0.0)
    tree = cKDTree(np.column_stack([outlines.xy_img[rows] / outlines.pitch_px[detection], TREE_SEPARATION * detection]))
    near = tree.query_pairs(_REACH_PITCHES, output_type="ndarray")
    adjacent = outlines.neighbours[continuous & split[outlines.detection[outlines.neighbours[:, 0]]]]
    pairs = np.vstack([near[_are_continuous(hits, rows[near], step_m)], np.searchsorted(rows, adjacent)])
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(rows), len(rows)))
    components, component = connected_components(graph, directed=False)
    component_weight = np.bincount(component, weights=weight, minlength=components)
    first = np.full(components, len(rows))
    np.minimum.at(first, component, np.arange(len(rows)))
    # The heaviest component of each detection; of equal ones that whose first sample comes first.
    order = np.lexsort((first, -np.round(component_weight, 12), detection[first]))
    selected = order[np.unique(detection[first][order], return_index=True)[1]]
    member[rows] = np.isin(component, selected) & hits.hit[rows]
    return member


def _are_continuous(hits: Hits, pairs: Int64Array, step_m: float) -> BoolArray:
    """Which pairs (e, 2) of hits lie on one surface: one in the tangent plane of the other, to ``step_m``."""
    a, b = pairs.T
    step = hits.xyz_site_m[b] - hits.xyz_site_m[a]
    distance = np.minimum(
        np.abs(np.einsum("ij,ij->i", step, hits.normal_site[a])),
        np.abs(np.einsum("ij,ij->i", step, hits.normal_site[b])),
    )
    return np.asarray(distance < step_m)  # a miss is NaN, which compares false


def select_main_side(outlines: Outlines, hits: Hits, member: BoolArray) -> BoolArray:
    """Members (k,) on the side of the patch that the defect is on.

    They are those on the element with the largest sum of weights, facing as it faces on average. A crack in a wall that
    ends over the glass of a deep window lies in the plane of the wall, not on the glass or the reveal.
    """
    rows = np.flatnonzero(member)
    owner, count = outlines.detection[rows], len(outlines)
    on_element = (
        hits.element[rows] == find_majority_elements(owner, hits.element[rows], outlines.weight[rows], count)[owner]
    )
    rows, owner = rows[on_element], owner[on_element]
    normal = hits.normal_site[rows]
    facing = np.zeros((count, 3))
    np.add.at(facing, owner, normal * outlines.weight[rows, None])
    facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-12)
    aligned = np.einsum("ij,ij->i", normal, facing[owner]) > _SAME_SIDE_COSINE
    without_side = ~np.isin(owner, owner[aligned])  # an element that faces all ways: all of its sides
    selected = np.zeros_like(member)
    selected[rows[aligned | without_side]] = True
    return selected
