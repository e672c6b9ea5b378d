"""Samples of the model's edges that a camera sees, and their pixels.

An edge is visible in a view where the surface differs on its two sides: it changes direction (a crease), or it ends
before something farther away (a silhouette). Seams between elements in one plane show nothing; samples with something
nearer on both sides are hidden. Both are decided by rays, so the elements need not be merged first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.building.surface import ModelEdges, Surface
from facadelake.core.arrays import BoolArray, Float64N, Float64Nx2, Float64Nx3, Int64Array
from facadelake.core.camera import PosedCamera

_CREASE_COSINE = np.cos(np.radians(20.0))
_SIDE_PX = 1.5  # distance of the rays beside an edge from it, in pixels of the photograph
_OWN_PLANE_M = 0.005
_MIN_DEPTH_M = 0.1
_MIN_SENSITIVITY = 0.35  # least share of a shift that must move an edge across itself


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeSamples:
    """Points on the edges: ``xyz_site_m`` (n, 3), unit ``direction`` (n, 3), their ``edge`` and ``feature`` (n,)."""

    xyz_site_m: Float64Nx3
    direction: Float64Nx3
    edge: Int64Array
    feature: Int64Array

    def take(self, which: BoolArray) -> EdgeSamples:
        """The samples selected by ``which`` (n,)."""
        return EdgeSamples(
            xyz_site_m=self.xyz_site_m[which],
            direction=self.direction[which],
            edge=self.edge[which],
            feature=self.feature[which],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class VisibleEdgeSamples:
    """Samples that a camera sees.

    ``row`` (k,) in the edge samples; ``xy_img`` and unit normal of the edge ``normal_img`` (k, 2) in pixels of the
    photograph; ``pixel_m`` (k,): size of a pixel at the sample, square to the view.
    """

    row: Int64Array
    xy_img: Float64Nx2
    normal_img: Float64Nx2
    pixel_m: Float64N

    def take(self, which: BoolArray) -> VisibleEdgeSamples:
        """The samples selected by ``which`` (k,)."""
        return VisibleEdgeSamples(
            row=self.row[which],
            xy_img=self.xy_img[which],
            normal_img=self.normal_img[which],
            pixel_m=self.pixel_m[which],
        )


def sample_edges(edges: ModelEdges, spacing_m: float) -> EdgeSamples:
    """Points along the edges, at most ``spacing_m`` apart, none at the ends (corners show other edges)."""
    count = np.maximum(1, np.ceil(edges.length_m / spacing_m).astype(np.int64))
    edge = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[edge]
    along = edges.end_site_m - edges.start_site_m
    return EdgeSamples(
        xyz_site_m=edges.start_site_m[edge] + share[:, None] * along[edge],
        direction=(along / np.maximum(edges.length_m, 1e-12)[:, None])[edge],
        edge=edge,
        feature=edges.feature[edge],
    )


def find_visible_samples(
    samples: EdgeSamples,
    posed: PosedCamera,
    surface: Surface,
    *,
    border_px: float,
    free_directions: Float64Nx3 | None = None,
) -> VisibleEdgeSamples:
    """The samples that a camera sees.

    Args:
        samples: samples of the model's edges.
        posed: the camera.
        surface: the model's surface, which hides samples.
        border_px: least distance of a sample from the border of the photograph.
        free_directions: unit directions of shift (j, 3) in site; if given, only edges that such a shift moves across
            themselves are returned.

    Returns:
        the visible samples.
    """
    projected = _project_samples(samples, posed, border_px)
    row = projected.row
    ray = samples.xyz_site_m[row] - posed.centre_site_m
    # Beside the edge as the camera sees it: across the plane of the edge and the camera's centre.
    beside = np.cross(samples.direction[row], ray)
    beside /= np.maximum(np.linalg.norm(beside, axis=1, keepdims=True), 1e-12)
    if free_directions is not None:
        sensitive = np.linalg.norm(beside @ free_directions.T, axis=1) > _MIN_SENSITIVITY
        projected, ray, beside = projected.take(sensitive), ray[sensitive], beside[sensitive]
    beside *= (_SIDE_PX * projected.pixel_m)[:, None]
    xyz, distance = samples.xyz_site_m[projected.row], np.linalg.norm(ray, axis=1)
    hidden, on_own_face, normals = np.zeros(len(xyz), dtype=bool), [], []
    for side in (-1.0, 1.0):
        hits = surface.cast(np.broadcast_to(posed.centre_site_m, ray.shape), ray + side * beside)
        normal = np.where(hits.hit[:, None], hits.normal_site, 0.0)
        plane_distance = np.abs(np.einsum("ij,ij->i", normal, xyz - np.where(hits.hit[:, None], hits.xyz_site_m, 0.0)))
        # The edge's own faces lie in planes through it; anything else in front hides it.
        on_own_face.append(hits.hit & (plane_distance < _OWN_PLANE_M))
        hidden |= ~on_own_face[-1] & (hits.distance_m < distance)
        normals.append(normal)
    crease = np.einsum("ij,ij->i", normals[0], normals[1]) < _CREASE_COSINE
    silhouette = on_own_face[0] ^ on_own_face[1]
    return projected.take(~hidden & (silhouette | (on_own_face[0] & on_own_face[1] & crease)))


def _project_samples(samples: EdgeSamples, posed: PosedCamera, border_px: float) -> VisibleEdgeSamples:
    """The samples that lie inside the photograph, hidden or not."""
    camera = posed.camera
    xyz_cam = posed.site_from_cam.invert().apply(samples.xyz_site_m)
    depth = xyz_cam[:, 2]
    # Distortion folds far outside the photograph: only points in its cone may be projected.
    width, height = camera.width_px, camera.height_px
    corners = camera.rays_cam_from_img(np.array([[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]]))
    widest = 1.02 * float(np.linalg.norm(corners[:, :2] / corners[:, 2:], axis=1).max())
    row = np.flatnonzero((depth > _MIN_DEPTH_M) & (np.linalg.norm(xyz_cam[:, :2], axis=1) < widest * depth))
    xy = camera.project(xyz_cam[row])
    inside = ((xy >= border_px) & (xy <= np.array([width, height]) - border_px)).all(axis=1)
    row, xy = row[inside], xy[inside]
    step = 0.5 * depth[row] / camera.fx_px  # half a pixel along the edge
    direction_cam = samples.direction[row] @ posed.site_from_cam.rotation
    along = camera.project(xyz_cam[row] + step[:, None] * direction_cam) - xy
    length = np.linalg.norm(along, axis=1)
    across_view = length > 0.1  # else the edge points at the camera
    along = along[across_view] / length[across_view, None]
    return VisibleEdgeSamples(
        row=row[across_view],
        xy_img=xy[across_view],
        normal_img=np.column_stack([-along[:, 1], along[:, 0]]),
        pixel_m=depth[row[across_view]] / camera.fx_px,
    )
