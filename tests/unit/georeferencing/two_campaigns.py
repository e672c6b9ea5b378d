"""Two campaigns of a made building without photographs: points on its faces, seen with pixel noise from a ring."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.sfm.reconstruction import LocalisedPhoto, Reconstruction

ORIGIN = SiteOrigin(lon_deg=9.1, lat_deg=48.74, height_ellipsoidal_m=480.0)
CAMERA = Camera(width_px=4000, height_px=3000, fx_px=3000, fy_px=3000, cx_px=2000, cy_px=1500)
NOISE_PX = 0.5
PHOTOGRAPHS = 16


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """A block in its own sfm frame, and the truth that made it."""

    reconstruction: Reconstruction
    descriptors: NDArray[np.uint8]
    site_from_sfm: Similarity
    xyz_true_m: NDArray[np.float64]

    @property
    def cameras(self) -> list[PosedCamera]:
        """The photographs as truth places them."""
        return [
            PosedCamera(
                camera=CAMERA,
                site_from_cam=Similarity(
                    rotation=self.site_from_sfm.rotation @ photo.sfm_from_cam.rotation,
                    translation=self.site_from_sfm.apply(photo.sfm_from_cam.translation),
                ),
            )
            for photo in self.reconstruction.photos
        ]


def draw_facade_points(count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Points (n, 3) on the south and east faces of a building 20 x 12 x 9 m, with 5 cm of relief."""
    along, up, relief = rng.uniform(0, 32, count), rng.uniform(0, 9, count), rng.uniform(0, 0.05, count)
    south = along < 20
    return np.column_stack([np.where(south, along, 20 + relief), np.where(south, -relief, along - 20), up])


def build_poses() -> list[Similarity]:
    """site_from_cam of photographs on an arc round the south-east corner, 15 m off, at three heights."""
    poses = []
    for k, azimuth in enumerate(np.linspace(-110, 20, PHOTOGRAPHS)):
        target = np.array([13.0, 4.0, 4.5])
        away = np.array([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth)), 0.0])
        centre = target + 22.0 * away + [0, 0, 3.0 * (k % 3 - 1)]
        z = (target - centre) / np.linalg.norm(target - centre)
        x = np.cross(z, [0, 0, 1.0])
        x /= np.linalg.norm(x)
        poses.append(Similarity(rotation=np.column_stack([x, np.cross(z, x), z]), translation=centre))
    return poses


def build_campaign(
    xyz_m: NDArray[np.float64],
    descriptors: NDArray[np.uint8],
    site_from_sfm: Similarity,
    rng: np.random.Generator,
    *,
    noise_px: float = NOISE_PX,
) -> Campaign:
    """A block that sees ``xyz_m`` (n, 3) from the ring: its tie points are determined by noisy image points.

    The scatter of a point is drawn from the normal equations of its image points, written here independently.
    """
    poses, sfm_from_site = build_poses(), site_from_sfm.invert()
    information = np.zeros((len(xyz_m), 3, 3))
    photo, point, xy = [], [], []
    for k, pose in enumerate(poses):
        cam = (xyz_m - pose.translation) @ pose.rotation
        normal = np.where((xyz_m[:, 0] < 20)[:, None], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0])
        facing = ((pose.translation - xyz_m) * normal).sum(axis=1) > 2.0
        seen = np.flatnonzero(facing & (rng.random(len(xyz_m)) < 0.6))
        for row in seen:
            ray = cam[row] / np.linalg.norm(cam[row])
            across = np.linalg.svd(ray[None])[2][1:] @ pose.rotation.T  # two directions square to the ray, in site
            depth_m = cam[row, 2]
            information[row] += across.T @ across * (CAMERA.fx_px / depth_m / noise_px) ** 2
        photo.append(np.full(len(seen), k))
        point.append(seen)
        xy.append(CAMERA.project(cam[seen]))
    scatter = np.linalg.cholesky(np.linalg.inv(information + 1e-3 * np.eye(3)))
    found = xyz_m + np.einsum("nij,nj->ni", scatter, rng.normal(size=(len(xyz_m), 3)))
    return Campaign(
        reconstruction=Reconstruction(
            photos=tuple(
                LocalisedPhoto(
                    photo_id=f"IMG_{k:04}.JPG",
                    camera=CAMERA,
                    sfm_from_cam=Similarity(
                        rotation=sfm_from_site.rotation @ pose.rotation,
                        translation=sfm_from_site.apply(pose.translation),
                    ),
                    reprojection_error_px=1.2533 * noise_px,
                    tie_points=0,
                )
                for k, pose in enumerate(poses)
            ),
            unlocalised=(),
            xyz_sfm=sfm_from_site.apply(found),
            rgb=np.zeros((len(xyz_m), 3), dtype=np.uint8),
            image_point_photo=np.concatenate(photo),
            image_point_tie_point=np.concatenate(point),
            image_point_xy_img=np.concatenate(xy),
            mean_reprojection_error_px=1.2533 * noise_px,
            costs=(),
        ),
        descriptors=descriptors,
        site_from_sfm=site_from_sfm,
        xyz_true_m=xyz_m,
    )


def draw_descriptors(count: int, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Descriptors (n, 128) of surfaces that have nothing in common; skewed as SIFT's are."""
    return np.minimum(rng.exponential(30.0, (count, 128)), 255).astype(np.uint8)


def change_light(descriptors: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """The same surfaces under other light."""
    changed: NDArray[np.uint8] = np.clip(descriptors + rng.normal(0, 12.0, descriptors.shape), 0, 255).astype(np.uint8)
    return changed


def draw_similarity(seed: int) -> Similarity:
    """Some site_from_sfm: another scale, turn and place."""
    rng = np.random.default_rng(seed)
    return Similarity(
        rotation=Rotation.random(random_state=seed).as_matrix(),
        translation=rng.uniform(-30, 30, 3),
        scale=float(rng.uniform(0.3, 4.0)),
    )
