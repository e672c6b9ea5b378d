"""Which element a patch is on."""

from __future__ import annotations

import numpy as np

from facadelake.building import BuildingModel
from facadelake.building.surface import Hits, Surface
from facadelake.core.arrays import BoolArray, Float64Array, Int64Array
from facadelake.registration.outline import Outlines

_FILLINGS = ("IfcWindow", "IfcDoor")  # and their standard cases
_ACROSS_COSINE = 0.5  # a face turned by more than 60 deg from its window's own plane stands across the opening


class ElementAttribution:
    """Elements of patches on ``building``; ``reach_m`` is how far the real surface may stand off the model's.

    An element wins by the votes of the patch's rays (see ``outlines_of``), so a border, a joint or a bar that the
    middle ray happens to meet does not decide alone. The sides of a window or door that stand across its opening lie
    against the reveal: where the wall that hosts them is within ``reach_m``, what is seen there counts with the wall.
    """

    def __init__(self, building: BuildingModel, reach_m: float) -> None:
        rows = building.elements.select(["element_guid", "ifc_class", "host_guid"]).to_pylist()
        place = {row["element_guid"]: i for i, row in enumerate(rows)}
        self._host = np.array(
            [place.get(row["host_guid"], -1) if row["ifc_class"].startswith(_FILLINGS) else -1 for row in rows],
            dtype=np.int64,
        )
        self._reach_m = reach_m
        self._facing = np.full((len(rows), 3), np.nan)
        self._hosts: Surface | None = None
        if (self._host >= 0).any():
            self._index_hosts(building)

    def _index_hosts(self, building: BuildingModel) -> None:
        owner = building.element_of_triangle
        corners = building.vertices_site_m[building.triangles]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.maximum(np.linalg.norm(cross, axis=1), 1e-12)
        scatter = np.zeros((len(self._host), 3, 3))
        np.add.at(scatter, owner, cross[:, :, None] * cross[:, None, :] / area[:, None, None])
        _, axes = np.linalg.eigh(scatter)
        self._facing = axes[:, :, 2]
        hosts = np.isin(owner, self._host[self._host >= 0])
        if hosts.any():
            self._hosts = Surface.from_mesh(building.vertices_site_m, building.triangles[hosts], owner[hosts])

    def attribute_patches(self, outlines: Outlines, hits: Hits, member: BoolArray) -> Int64Array:
        """Row of the element (n,) that each patch is on; -1 where it has no member."""
        kept = np.flatnonzero(member)
        element = self._attribute_hits(hits, kept)
        return find_majority_elements(outlines.detection[kept], element, outlines.weight[kept], len(outlines))

    def _attribute_hits(self, hits: Hits, kept: Int64Array) -> Int64Array:
        element = hits.element[kept].copy()
        if self._hosts is None:
            return element
        facing = np.einsum("ij,ij->i", hits.normal_site[kept], self._facing[element])
        across = np.flatnonzero((self._host[element] >= 0) & (np.abs(facing) < _ACROSS_COSINE))
        if len(across):
            near = self._hosts.find_closest_points(hits.xyz_site_m[kept[across]])
            host = self._host[element[across]]
            at_wall = (near.distance_m <= self._reach_m) & (near.element == host)
            element[across[at_wall]] = host[at_wall]
        return element


def find_majority_elements(
    detection: Int64Array, element: Int64Array, vote: Float64Array, detections: int
) -> Int64Array:
    """The element (n,) with most of each detection's votes; -1 where there are none.

    ``detection``, ``element`` and ``weight`` (k,) say which of the n ``detections`` votes how much for which element.
    """
    elements = int(element.max(initial=0)) + 1
    pair, where = np.unique(detection * elements + element, return_inverse=True)
    votes = np.bincount(where, weights=vote, minlength=len(pair))
    # Of elements with equal votes, as where a joint runs through a box's middle, the lower row: any rule will do that
    # does not depend on what else is in the batch.
    order = np.lexsort((pair, -np.round(votes, 12), pair // elements))
    patch, first = np.unique(pair[order] // elements, return_index=True)
    chosen = np.full(detections, -1, dtype=np.int64)
    chosen[patch] = pair[order][first] % elements
    return chosen
