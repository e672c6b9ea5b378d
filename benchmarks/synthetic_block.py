"""A synthetic flight along the facades of a long house, as COLMAP's database of keypoints and verified matches.

In ``pycolmap.synthesize_dataset`` every photograph shows every point. In a real flight a photograph overlaps with its
neighbours only, which determines the cost of a block of a thousand photographs.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from facadelake.core.arrays import Float64Array

DEPTH_M = 12.0
STAND_OFF_M = 9.0
SPACING_M = 3.5  # along a row and between rows: 70 % overlap
WIDTH_PX, HEIGHT_PX = 4000, 3000
TRUE_PARAMS = [2905.0, 2902.0, 2012.0, 1491.0, -0.062, 0.021, 0.0004, -0.0003]
NOMINAL_FOCAL_PX = 2950.0
KEYPOINT_NOISE_PX = 0.5
DETECTED_SHARE = 0.45  # share of the points in view that become keypoints
MATCHED_SHARE = 0.7
WRONG_SHARE = 0.08


@dataclass(frozen=True, kw_only=True)
class House:
    """A box whose walls are covered by ``photographs`` in ``rows`` above one another; it grows with their number."""

    photographs: int

    @property
    def rows(self) -> int:
        """Number of rows of photographs."""
        return max(2, round(4 * np.sqrt(self.photographs / 100)))

    @property
    def per_row(self) -> int:
        """Number of photographs in a row."""
        return int(np.ceil(self.photographs / self.rows))

    @property
    def length_m(self) -> float:
        """Length of the longer walls."""
        return max(self.per_row * SPACING_M / 2 - DEPTH_M, DEPTH_M)

    @property
    def outline_m(self) -> float:
        """Perimeter of the floor plan."""
        return 2 * (self.length_m + DEPTH_M)

    @property
    def height_m(self) -> float:
        """Height of the walls."""
        return 4.0 + SPACING_M * self.rows

    def locate_on_outline(self, s_m: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Points (n, 2) on the outline at distances ``s_m`` (n,) along it, and outward normals (n, 2)."""
        length = self.length_m
        sides = [((0, 0), (1, 0), length), ((length, 0), (0, 1), DEPTH_M)]
        sides += [((length, DEPTH_M), (-1, 0), length), ((0, DEPTH_M), (0, -1), DEPTH_M)]
        foot, normal = np.zeros((len(s_m), 2)), np.zeros((len(s_m), 2))
        start = 0.0
        for corner, along, extent in sides:
            on = (s_m >= start) & (s_m < start + extent)
            foot[on] = np.array(corner) + (s_m[on] - start)[:, None] * np.array(along)
            normal[on] = (along[1], -along[0])
            start += extent
        return foot, normal

    def sample_points(self, count: int, rng: np.random.Generator) -> tuple[Float64Array, Float64Array]:
        """Sample points (count, 3) on the walls with up to 0.3 m of relief; also the outward normals (count, 3)."""
        foot, normal = self.locate_on_outline(rng.uniform(0, self.outline_m, count))
        relief = rng.choice([0.0, -0.15, 0.3], count, p=[0.7, 0.2, 0.1]) + rng.normal(0, 0.02, count)
        xyz = np.column_stack([foot + relief[:, None] * normal, rng.uniform(0, self.height_m, count)])
        return xyz, np.column_stack([normal, np.zeros(count)])


@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """True poses of the photographs: centres (n, 3) in metres and rotations (n, 3, 3), world from camera."""

    house: House
    centres_m: Float64Array
    rotations: Float64Array

    @property
    def directions(self) -> Float64Array:
        """Optical axes (n, 3)."""
        directions: Float64Array = self.rotations[:, :, 2]
        return directions


def generate_flight(photographs: int, rng: np.random.Generator) -> Flight:
    """Generate rows of photographs around the house, turning gradually at its corners, with random deviations."""
    house = House(photographs=photographs)
    centres, rotations = [], []
    for k in range(photographs):
        row, step = divmod(k, house.per_row)
        s_m = (step + 0.25 * row) / house.per_row * house.outline_m
        foot, normal = house.locate_on_outline((s_m + np.linspace(-6, 6, 13)) % house.outline_m)
        out = normal.mean(axis=0) / np.linalg.norm(normal.mean(axis=0))
        centre = np.append(foot.mean(axis=0) + STAND_OFF_M * out, 3.0 + SPACING_M * row) + rng.normal(0, 0.3, 3)
        yaw, pitch = np.arctan2(-out[1], -out[0]) + rng.normal(0, 0.03), rng.normal(-0.1, 0.03)
        forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        centres.append(centre)
        rotations.append(np.column_stack([right, np.cross(forward, right), forward]))
    return Flight(house=house, centres_m=np.array(centres), rotations=np.array(rotations))


def write_block(
    path: Path,
    flight: Flight,
    pairs: list[tuple[int, int]],
    *,
    observations: int,
    rng: np.random.Generator,
    zoom: Float64Array | None = None,
) -> dict[str, Float64Array]:
    """Write keypoints, matches and verified pairs of a flight to a COLMAP database.

    Args:
        path: the database.
        flight: the flight with its true poses.
        pairs: pairs of photographs to match, by number.
        observations: mean number of keypoints per photograph.
        rng: random generator.
        zoom: factor (n,) on the focal length of each photograph, of which the database says nothing; None: 1.

    Returns:
        True centre (3,) of each photograph in metres, by its name.
    """
    factors = np.ones(len(flight.centres_m)) if zoom is None else zoom
    seen_area = (WIDTH_PX / NOMINAL_FOCAL_PX * STAND_OFF_M) * (HEIGHT_PX / NOMINAL_FOCAL_PX * STAND_OFF_M)
    density = observations / DETECTED_SHARE / seen_area
    xyz, normal = flight.house.sample_points(int(density * flight.house.outline_m * flight.house.height_m), rng)
    start = pycolmap.Camera(
        model="OPENCV",
        width=WIDTH_PX,
        height=HEIGHT_PX,
        params=[NOMINAL_FOCAL_PX, NOMINAL_FOCAL_PX, WIDTH_PX / 2, HEIGHT_PX / 2, 0, 0, 0, 0],
        camera_id=1,
    )
    start.has_prior_focal_length = True
    with pycolmap.Database.open(path) as database:
        database.write_camera(start, use_camera_id=True)
        rig = pycolmap.Rig(rig_id=1)
        rig.add_ref_sensor(start.sensor_id)
        database.write_rig(rig, use_rig_id=True)
        detected: list[NDArray[np.int64]] = []
        keypoints: list[Float64Array] = []
        for k, (centre, rotation) in enumerate(zip(flight.centres_m, flight.rotations, strict=True)):
            xyz_cam = (xyz - centre) @ rotation
            in_view = (xyz_cam[:, 2] > 1) & (xyz_cam[:, 2] < 40) & (np.sum((centre - xyz) * normal, axis=1) > 1.0)
            in_view &= np.abs(xyz_cam[:, 0]) < xyz_cam[:, 2]
            rows = np.flatnonzero(in_view)
            true_params = [TRUE_PARAMS[0] * factors[k], TRUE_PARAMS[1] * factors[k], *TRUE_PARAMS[2:]]
            true_camera = pycolmap.Camera(model="OPENCV", width=WIDTH_PX, height=HEIGHT_PX, params=true_params)
            xy = np.asarray(true_camera.img_from_cam(xyz_cam[rows])) + rng.normal(0, KEYPOINT_NOISE_PX, (len(rows), 2))
            inside = (xy > 0).all(axis=1) & (xy[:, 0] < WIDTH_PX) & (xy[:, 1] < HEIGHT_PX)
            inside &= rng.random(len(rows)) < DETECTED_SHARE
            detected.append(rows[inside])
            keypoints.append(xy[inside].astype(np.float32))
            image = pycolmap.Image(name=f"{k:05d}.jpg", camera_id=1)
            image.image_id = database.write_image(image)
            frame = pycolmap.Frame()
            frame.rig_id = 1
            frame.add_data_id(image.data_id)
            database.write_frame(frame)
            database.write_keypoints(image.image_id, keypoints[-1])
        options = pycolmap.TwoViewGeometryOptions()
        options.ransac.random_seed = 1
        for i, j in pairs:
            _, at_i, at_j = np.intersect1d(detected[i], detected[j], assume_unique=True, return_indices=True)
            kept = rng.random(len(at_i)) < MATCHED_SHARE
            matches = np.column_stack([at_i[kept], at_j[kept]]).astype(np.uint32)
            wrong = rng.random(len(matches)) < WRONG_SHARE
            matches[wrong, 1] = rng.permutation(matches[wrong, 1])
            if len(matches) < 15:
                continue
            geometry = pycolmap.estimate_calibrated_two_view_geometry(
                start, keypoints[i].astype(float), start, keypoints[j].astype(float), matches, options
            )
            database.write_matches(i + 1, j + 1, matches)
            database.write_two_view_geometry(i + 1, j + 1, geometry)
    return {f"{k:05d}.jpg": centre for k, centre in enumerate(flight.centres_m)}


def write_colmap_block(path: Path, photographs: int, *, partners: int) -> dict[str, Float64Array]:
    """Write a block of ``pycolmap.synthesize_dataset`` with keypoint noise: all photographs show the same 200 points.

    Each photograph is matched with about ``partners`` others. Returns the true centres (3,) by name of the photograph.
    """
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs = options.num_cameras_per_rig = 1
    options.num_frames_per_rig, options.num_points3D = photographs, 200
    options.match_config = pycolmap.SyntheticDatasetMatchConfig.SPARSE
    options.match_sparsity = 1 - min(partners / (photographs - 1), 1.0)
    options.inlier_match_ratio = 0.9
    options.camera_has_prior_focal_length = True
    options.camera_model_id = pycolmap.CameraModelId.OPENCV
    options.camera_params = TRUE_PARAMS
    options.camera_width, options.camera_height = WIDTH_PX, HEIGHT_PX
    pycolmap.set_random_seed(1)
    with pycolmap.Database.open(path) as database:
        model = pycolmap.synthesize_dataset(options, database)
        truth = {image.name: image.projection_center() for image in model.images.values()}
        noise = pycolmap.SyntheticNoiseOptions()
        noise.point2D_stddev = KEYPOINT_NOISE_PX
        pycolmap.synthesize_noise(noise, model, database)
        return truth
