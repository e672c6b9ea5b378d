"""The building as a campaign itself found it: the surface of its tie points, where there is no model at all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from facadelake.building import BuildingModel
from facadelake.building.mesh import attach_surface
from facadelake.core.arrays import Float64Array, Int64Array
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.sfm.reconstruction import Reconstruction
from facadelake.sfm.surface_mesh import mesh_tie_points
from facadelake.sfm.tie_point_covariance import compute_tie_point_covariance, estimate_pixel_sigma

_MAX_SIGMA_M = 0.1  # a tie point known worse than this, along its rays, dents the surface more than it shapes it
_MAX_POINTS = 100_000  # measured: 40 s of processor time and 3 GB
_NEIGHBOURS = 8
_ONE_SIGMA_PERCENTILE = 68.27
_MIN_SURFACE_SIGMA_M = 0.005


def build_as_built_model(
    place: BuildingModel, reconstruction: Reconstruction, posed: Mapping[str, PosedCamera]
) -> BuildingModel:
    """``place`` with the surface of the block's tie points, seen from the adjusted cameras ``posed`` (by photo_id).

    ``surface_sigma_m`` is how far tie points stand off the plane of those around them: their noise and the relief
    between them. Raises InputDataError where too few tie points are left for a surface.
    """
    block = triangulate_in_site(reconstruction, posed)
    vertices, triangles = mesh_tie_points(block, most_points=_MAX_POINTS)
    if len(triangles) == 0:
        raise InputDataError(
            f"the {len(block.xyz_sfm)} tie points make no surface: photograph with more overlap and from more sides, "
            "or give the registry a model"
        )
    return attach_surface(place, vertices, triangles, surface_sigma_m=estimate_roughness(vertices))


def triangulate_in_site(reconstruction: Reconstruction, posed: Mapping[str, PosedCamera]) -> Reconstruction:
    """The block with the frame ``site`` in the place of ``sfm``: cameras as adjusted, tie points intersected anew.

    A similarity of the free block would not do: the adjustment to control bends it by centimetres. Photographs without
    a pose, and tie points that the others leave open or know badly, are left out.
    """
    kept = [k for k, photo in enumerate(reconstruction.photos) if photo.photo_id in posed]
    number = np.full(len(reconstruction.photos), -1, dtype=np.int64)
    number[kept] = np.arange(len(kept))
    rows = number[reconstruction.image_point_photo] >= 0
    cameras = [posed[reconstruction.photos[k].photo_id] for k in kept]
    block = replace(
        reconstruction,
        photos=tuple(
            replace(reconstruction.photos[k], camera=camera.camera, sfm_from_cam=camera.site_from_cam)
            for k, camera in zip(kept, cameras, strict=True)
        ),
        image_point_photo=number[reconstruction.image_point_photo[rows]],
        image_point_tie_point=reconstruction.image_point_tie_point[rows],
        image_point_xy_img=reconstruction.image_point_xy_img[rows],
    )
    xyz = _triangulate(block, cameras)
    covariance = compute_tie_point_covariance(block, cameras, xyz, sigma_px=estimate_pixel_sigma(reconstruction))
    known = np.isfinite(xyz).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    worst = np.full(len(xyz), np.inf)
    worst[known] = np.sqrt(np.linalg.eigvalsh(covariance[known])[:, 2])
    good = (worst <= _MAX_SIGMA_M)[block.image_point_tie_point]
    return replace(
        block,
        xyz_sfm=np.where(np.isfinite(xyz), xyz, 0.0),
        image_point_photo=block.image_point_photo[good],
        image_point_tie_point=block.image_point_tie_point[good],
        image_point_xy_img=block.image_point_xy_img[good],
    )


def estimate_roughness(xyz_site_m: Float64Array) -> float:
    """One sigma, in metres, of how far points (n, 3) of a surface stand off the plane of the eight around each."""
    count = min(_NEIGHBOURS, len(xyz_site_m) - 1)
    near = cKDTree(xyz_site_m).query(xyz_site_m, k=count + 1)[1][:, 1:]
    around = xyz_site_m[near]
    middle = around.mean(axis=1)
    _, vectors = np.linalg.eigh(np.einsum("nij,nik->njk", around - middle[:, None], around - middle[:, None]))
    off = np.abs(np.einsum("ij,ij->i", xyz_site_m - middle, vectors[:, :, 0]))
    return max(float(np.percentile(off, _ONE_SIGMA_PERCENTILE)), _MIN_SURFACE_SIGMA_M)


def _triangulate(block: Reconstruction, cameras: list[PosedCamera]) -> Float64Array:
    """Tie points (m, 3) nearest to their rays, in angle: a second round weighs each ray by its distance; NaN: open."""
    xyz = np.full((len(block.xyz_sfm), 3), np.nan)
    rays = [_compute_rays(block, k, camera) for k, camera in enumerate(cameras)]
    for _ in range(2):
        information, moment = np.zeros((len(xyz), 3, 3)), np.zeros((len(xyz), 3))
        for (point, direction), camera in zip(rays, cameras, strict=True):
            distance = np.linalg.norm(xyz[point] - camera.centre_site_m, axis=1)
            weight = np.where(np.isfinite(distance) & (distance > 0), 1.0 / np.maximum(distance, 1e-9) ** 2, 1.0)
            across = (np.eye(3) - direction[:, :, None] * direction[:, None, :]) * weight[:, None, None]
            np.add.at(information, point, across)
            np.add.at(moment, point, across @ camera.centre_site_m)
        values = np.linalg.eigvalsh(information)
        fixed = values[:, 0] > 1e-6 * values[:, 2]
        xyz[fixed] = np.linalg.solve(information[fixed], moment[fixed][:, :, None])[:, :, 0]
    return xyz


def _compute_rays(block: Reconstruction, photo: int, camera: PosedCamera) -> tuple[Int64Array, Float64Array]:
    rows = block.image_point_photo == photo
    return block.image_point_tie_point[rows], camera.rays_site_from_img(block.image_point_xy_img[rows])[1]
