"""The building model of a campaign without a model: the surface of its own tie points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from facadelake.building import BuildingModel
from facadelake.building.mesh import attach_surface
from facadelake.core.arrays import Float64Nx3, Int64Array
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.sfm.reconstruction import Reconstruction
from facadelake.sfm.surface_mesh import mesh_tie_points
from facadelake.sfm.tie_point_covariance import compute_tie_point_covariance, estimate_pixel_sigma

_MAX_SIGMA_M = 0.1  # of a tie point along its rays; less certain points distort the surface
_MAX_POINTS = 100_000  # measured: 40 s of processor time and 3 GB
_NEIGHBOURS = 8
_ONE_SIGMA_PERCENTILE = 68.27
_MIN_SURFACE_SIGMA_M = 0.005


def build_as_built_model(
    place: BuildingModel, reconstruction: Reconstruction, posed: Mapping[str, PosedCamera]
) -> BuildingModel:
    """``place`` with the surface of the block's tie points.

    Args:
        place: site frame and settings of the building, without a surface.
        reconstruction: the block of the campaign, in the frame sfm.
        posed: the adjusted cameras by photo_id, in the frame site.

    Returns:
        ``place`` with surface and elements; its ``surface_sigma_m`` is the distance (one sigma) of tie points from the
        plane of their neighbours, which contains their noise and the relief between them.

    Raises:
        InputDataError: too few tie points are left for a surface.
    """
    block = triangulate_in_site(reconstruction, posed)
    vertices, triangles = mesh_tie_points(block, max_points=_MAX_POINTS)
    if len(triangles) == 0:
        raise InputDataError(
            f"the {len(block.xyz_sfm)} tie points form no surface; photograph with more overlap and from more sides, "
            "or register a building model"
        )
    return attach_surface(place, vertices, triangles, surface_sigma_m=estimate_roughness(vertices))


def triangulate_in_site(reconstruction: Reconstruction, posed: Mapping[str, PosedCamera]) -> Reconstruction:
    """The block in the frame ``site`` instead of ``sfm``: adjusted cameras, tie points triangulated again.

    A similarity transform of the free block is not enough: the adjustment to control bends the block by centimetres.
    Photographs without a pose are left out, and so are the image points of tie points that the remaining photographs do
    not determine, or determine with a sigma above 0.1 m.
    """
    kept = [k for k, photo in enumerate(reconstruction.photos) if photo.photo_id in posed]
    new_index = np.full(len(reconstruction.photos), -1, dtype=np.int64)
    new_index[kept] = np.arange(len(kept))
    rows = new_index[reconstruction.image_point_photo] >= 0
    cameras = [posed[reconstruction.photos[k].photo_id] for k in kept]
    block = replace(
        reconstruction,
        photos=tuple(
            replace(reconstruction.photos[k], camera=camera.camera, sfm_from_cam=camera.site_from_cam)
            for k, camera in zip(kept, cameras, strict=True)
        ),
        image_point_photo=new_index[reconstruction.image_point_photo[rows]],
        image_point_tie_point=reconstruction.image_point_tie_point[rows],
        image_point_xy_img=reconstruction.image_point_xy_img[rows],
    )
    xyz = _triangulate(block, cameras)
    covariance = compute_tie_point_covariance(block, cameras, xyz, sigma_px=estimate_pixel_sigma(reconstruction))
    determined = np.isfinite(xyz).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    largest_sigma_m = np.full(len(xyz), np.inf)
    largest_sigma_m[determined] = np.sqrt(np.linalg.eigvalsh(covariance[determined])[:, 2])
    good = (largest_sigma_m <= _MAX_SIGMA_M)[block.image_point_tie_point]
    return replace(
        block,
        xyz_sfm=np.where(np.isfinite(xyz), xyz, 0.0),
        image_point_photo=block.image_point_photo[good],
        image_point_tie_point=block.image_point_tie_point[good],
        image_point_xy_img=block.image_point_xy_img[good],
    )


def estimate_roughness(xyz_site_m: Float64Nx3) -> float:
    """One sigma, in metres, of the distance of points (n, 3) of a surface from the plane of their eight neighbours."""
    count = min(_NEIGHBOURS, len(xyz_site_m) - 1)
    neighbours = cKDTree(xyz_site_m).query(xyz_site_m, k=count + 1)[1][:, 1:]
    neighbour_xyz = xyz_site_m[neighbours]
    centroid = neighbour_xyz.mean(axis=1)
    _, vectors = np.linalg.eigh(
        np.einsum("nij,nik->njk", neighbour_xyz - centroid[:, None], neighbour_xyz - centroid[:, None])
    )
    distance_m = np.abs(np.einsum("ij,ij->i", xyz_site_m - centroid, vectors[:, :, 0]))
    return max(float(np.percentile(distance_m, _ONE_SIGMA_PERCENTILE)), _MIN_SURFACE_SIGMA_M)


def _triangulate(block: Reconstruction, cameras: list[PosedCamera]) -> Float64Nx3:
    """Tie points (m, 3) from their rays by least squares of angles, in two iterations; NaN where undetermined."""
    xyz = np.full((len(block.xyz_sfm), 3), np.nan)
    rays = [_compute_rays(block, k, camera) for k, camera in enumerate(cameras)]
    for _ in range(2):
        information, moment = np.zeros((len(xyz), 3, 3)), np.zeros((len(xyz), 3))
        for (point, direction), camera in zip(rays, cameras, strict=True):
            distance = np.linalg.norm(xyz[point] - camera.centre_site_m, axis=1)
            weight = np.where(np.isfinite(distance) & (distance > 0), 1.0 / np.maximum(distance, 1e-9) ** 2, 1.0)
            projector = (np.eye(3) - direction[:, :, None] * direction[:, None, :]) * weight[:, None, None]
            np.add.at(information, point, projector)
            np.add.at(moment, point, projector @ camera.centre_site_m)
        values = np.linalg.eigvalsh(information)
        determined = values[:, 0] > 1e-6 * values[:, 2]
        xyz[determined] = np.linalg.solve(information[determined], moment[determined][:, :, None])[:, :, 0]
    return xyz


def _compute_rays(block: Reconstruction, photo: int, camera: PosedCamera) -> tuple[Int64Array, Float64Nx3]:
    """Rows of the tie points of a photograph, and the directions (k, 3) of the rays to them, in site."""
    rows = block.image_point_photo == photo
    return block.image_point_tie_point[rows], camera.rays_site_from_img(block.image_point_xy_img[rows])[1]
