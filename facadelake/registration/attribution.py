"""Attribution of patches to building elements."""

from __future__ import annotations

import numpy as np

from facadelake.building import BuildingModel
from facadelake.building.surface import Hits, Surface
from facadelake.core.arrays import BoolArray, Float64N, RowIndices
from facadelake.registration.outline import Outlines

_FILLINGS = ("IfcWindow", "IfcDoor")  # also matches IfcWindowStandardCase and IfcDoorStandardCase
_LATERAL_COSINE = 0.5  # faces more than 60 deg off the plane of their window are lateral: frame sides, lining


class ElementAttribution:
    """Attributes patches to elements of ``building``; ``reach_m``: one sigma of the distance between surface and model.

    The element with the largest sum of sample weights (see ``sample_outlines``) is selected, so that a border, a joint
    or a bar at the centre ray does not decide alone. The lateral faces of a window or door lie next to the reveal:
    where the host wall is within ``reach_m``, their samples count for the wall.
    """

    def __init__(self, building: BuildingModel, reach_m: float) -> None:
        rows = building.elements.select(["element_guid", "ifc_class", "host_guid"]).to_pylist()
        row_by_guid = {row["element_guid"]: i for i, row in enumerate(rows)}
        self._host = np.array(
            [row_by_guid.get(row["host_guid"], -1) if row["ifc_class"].startswith(_FILLINGS) else -1 for row in rows],
            dtype=np.int64,
        )
        self._reach_m = reach_m
        self._facing = np.full((len(rows), 3), np.nan)
        self._hosts: Surface | None = None
        if (self._host >= 0).any():
            self._index_hosts(building)

    def _index_hosts(self, building: BuildingModel) -> None:
        """Compute the main plane of every element, and build the surface of the elements that host fillings."""
        element = building.element_of_triangle
        corners = building.vertices_site_m[building.triangles]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.maximum(np.linalg.norm(cross, axis=1), 1e-12)
        scatter = np.zeros((len(self._host), 3, 3))
        np.add.at(scatter, element, cross[:, :, None] * cross[:, None, :] / area[:, None, None])
        _, axes = np.linalg.eigh(scatter)
        self._facing = axes[:, :, 2]
        hosts = np.isin(element, self._host[self._host >= 0])
        if hosts.any():
            self._hosts = Surface.from_mesh(building.vertices_site_m, building.triangles[hosts], element[hosts])

    def attribute_patches(self, outlines: Outlines, hits: Hits, member: BoolArray) -> RowIndices:
        """Row of the element (n,) of each patch, from its samples ``member`` (k,); -1 where it has no member."""
        rows = np.flatnonzero(member)
        element = self._attribute_hits(hits, rows)
        return find_majority_elements(outlines.detection[rows], element, outlines.weight[rows], len(outlines))

    def _attribute_hits(self, hits: Hits, rows: RowIndices) -> RowIndices:
        """Element (m,) of the hits ``rows`` (m,); lateral faces of fillings count for their host where it is near."""
        element = hits.element[rows].copy()
        if self._hosts is None:
            return element
        facing = np.einsum("ij,ij->i", hits.normal_site[rows], self._facing[element])
        lateral = np.flatnonzero((self._host[element] >= 0) & (np.abs(facing) < _LATERAL_COSINE))
        if len(lateral):
            near = self._hosts.find_closest_points(hits.xyz_site_m[rows[lateral]])
            host = self._host[element[lateral]]
            on_host = (near.distance_m <= self._reach_m) & (near.element == host)
            element[lateral[on_host]] = host[on_host]
        return element


def find_majority_elements(detection: RowIndices, element: RowIndices, weight: Float64N, detections: int) -> RowIndices:
    """The element with the largest sum of weights of each detection.

    Args:
        detection: row of the detection (k,) of each sample.
        element: row of the element (k,) that the sample hit.
        weight: weight (k,) of the sample.
        detections: number n of detections.

    Returns:
        Row of the element (n,); -1 for a detection without samples.
    """
    elements = int(element.max(initial=0)) + 1
    pair, inverse = np.unique(detection * elements + element, return_inverse=True)
    pair_weight = np.bincount(inverse, weights=weight, minlength=len(pair))
    # Of equal elements, as where a joint runs through a box's centre, the lower row: the rule must not depend on the
    # other detections of the batch.
    order = np.lexsort((pair, -np.round(pair_weight, 12), pair // elements))
    selected_detection, first = np.unique(pair[order] // elements, return_index=True)
    selected = np.full(detections, -1, dtype=np.int64)
    selected[selected_detection] = pair[order][first] % elements
    return selected
