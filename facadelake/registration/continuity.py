"""What of a detection's pixels is one surface, and which side of it the defect is on."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from facadelake.building.surface import Hits
from facadelake.core.arrays import BoolArray, Int64Array
from facadelake.registration.attribution import find_majority_elements
from facadelake.registration.outline import TREE_SEPARATION, Outlines

_REACH = 4.1  # pitches over which a surface is found again behind what parts it in a picture
_SAME_SIDE_COSINE = np.cos(np.radians(45.0))


def find_patch_members(outlines: Outlines, hits: Hits, step_m: float) -> BoolArray:
    """Which pixels (k,) belong to their detection's patch: those that hang together on the surface with most votes.

    Neighbours hang together where one lies in the other's tangent plane to ``step_m``: round an edge one plane still
    holds, over a jump neither does. Where neighbours part, those a little further off are asked too, so that a wall
    seen through a railing, or round a deep window, stays one patch.
    """
    holds = _are_continuous(hits, outlines.neighbours, step_m)
    parted = np.zeros(len(outlines), dtype=bool)
    parted[outlines.detection[outlines.neighbours[~holds, 0]]] = True
    member: BoolArray = ~parted[outlines.detection] & hits.hit  # without neighbours: one pixel alone
    own = np.flatnonzero(parted[outlines.detection])
    if not len(own):
        return member
    detection, vote = outlines.detection[own], np.where(hits.hit[own], outlines.weight[own], 0.0)
    tree = cKDTree(np.column_stack([outlines.xy_img[own] / outlines.pitch_px[detection], TREE_SEPARATION * detection]))
    near = tree.query_pairs(_REACH, output_type="ndarray")
    beside = outlines.neighbours[holds & parted[outlines.detection[outlines.neighbours[:, 0]]]]
    pairs = np.vstack([near[_are_continuous(hits, own[near], step_m)], np.searchsorted(own, beside)])
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(own), len(own)))
    parts, part = connected_components(graph, directed=False)
    votes = np.bincount(part, weights=vote, minlength=parts)
    first = np.full(parts, len(own))
    np.minimum.at(first, part, np.arange(len(own)))
    # The best part of each detection; of parts with equal votes the one whose first pixel comes first.
    order = np.lexsort((first, -np.round(votes, 12), detection[first]))
    best = order[np.unique(detection[first][order], return_index=True)[1]]
    member[own] = np.isin(part, best) & hits.hit[own]
    return member


def _are_continuous(hits: Hits, pairs: Int64Array, step_m: float) -> BoolArray:
    """Which pairs (e, 2) of hits lie on one surface, one in the other's tangent plane."""
    a, b = pairs.T
    step = hits.xyz_site_m[b] - hits.xyz_site_m[a]
    off = np.minimum(
        np.abs(np.einsum("ij,ij->i", step, hits.normal_site[a])),
        np.abs(np.einsum("ij,ij->i", step, hits.normal_site[b])),
    )
    return np.asarray(off < step_m)  # NaN, a miss, is never below


def select_main_side(outlines: Outlines, hits: Hits, member: BoolArray) -> BoolArray:
    """Members (k,) on the side of the patch that the defect is on: of the element with most votes, facing as it mainly
    does. A wall's crack that ends over a deep window's glass lies in the wall's face, not on glass or reveal."""
    kept = np.flatnonzero(member)
    owner, count = outlines.detection[kept], len(outlines)
    of_main = (
        hits.element[kept] == find_majority_elements(owner, hits.element[kept], outlines.weight[kept], count)[owner]
    )
    kept, owner = kept[of_main], owner[of_main]
    normal = hits.normal_site[kept]
    facing = np.zeros((count, 3))
    np.add.at(facing, owner, normal * outlines.weight[kept, None])
    facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-12)
    ahead = np.einsum("ij,ij->i", normal, facing[owner]) > _SAME_SIDE_COSINE
    without = ~np.isin(owner, owner[ahead])  # an element that faces all ways: any of its sides
    main = np.zeros_like(member)
    main[kept[ahead | without]] = True
    return main
