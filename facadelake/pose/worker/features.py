"""Database, features and verified matches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pycolmap

from facadelake.pose.worker.report import Report

T = TypeVar("T")

# How many pairs one call compares: few enough for a moving bar, enough to reuse a photograph's search index.
_PAIRS_AT_ONCE = 40


def _blocks(items: Sequence[T], size: int) -> Iterator[Sequence[T]]:
    for start in range(0, len(items), size):
        yield items[start : start + size]


def fill_database(job: dict[str, Any], database_path: Path) -> dict[int, int]:
    """Write cameras, photographs and position priors; returns the job's photograph index -> COLMAP image id.

    A photograph's prior is in a local east-north-up frame, metres, with its covariance.
    """
    image_id_of: dict[int, int] = {}
    with pycolmap.Database.open(database_path) as database:
        for number, given in enumerate(job["cameras"], start=1):
            width, height, focal = given["width_px"], given["height_px"], given["focal_px"]
            camera = pycolmap.Camera(
                model="OPENCV",
                width=width,
                height=height,
                params=[focal, focal, width / 2, height / 2, 0, 0, 0, 0],
                camera_id=number,
            )
            camera.has_prior_focal_length = given["focal_known"]
            database.write_camera(camera, use_camera_id=True)
            rig = pycolmap.Rig(rig_id=number)
            rig.add_ref_sensor(camera.sensor_id)
            database.write_rig(rig, use_rig_id=True)
        for index, photo in enumerate(job["photos"]):
            camera_id = photo["camera"] + 1
            image = pycolmap.Image(name=photo["photo_id"], camera_id=camera_id)
            image.image_id = database.write_image(image)
            frame = pycolmap.Frame()
            frame.rig_id = camera_id
            frame.add_data_id(image.data_id)
            database.write_frame(frame)
            image_id_of[index] = image.image_id
            if photo["prior_m"] is not None:
                prior = pycolmap.PosePrior()
                prior.corr_data_id = image.data_id
                prior.position = np.array(photo["prior_m"])
                prior.position_covariance = np.diag(np.array(photo["prior_sigma_m"]) ** 2)
                prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
                database.write_pose_prior(prior)
    return image_id_of


def extract(job: dict[str, Any], database_path: Path, report: Report) -> None:
    """SIFT features of all photographs."""
    settings = job["settings"]
    options = pycolmap.FeatureExtractionOptions()
    options.max_image_size = settings["max_image_px"]
    options.num_threads = job["cores"]
    options.sift.max_num_features = settings["max_features"]
    options.sift.peak_threshold = 0.01 / 3  # half of COLMAP's: plain render needs its faint features
    options.sift.first_octave = 0  # COLMAP doubles the photograph first: twice the time, no gain on sharp photographs
    names = [photo["photo_id"] for photo in job["photos"]]
    with report.step("Finding features", len(names)):
        for block in _blocks(names, 2 * job["cores"]):
            pycolmap.extract_features(
                database_path, job["photographs_root"], image_names=list(block), extraction_options=options
            )
            report.advance(len(block))


def match(job: dict[str, Any], database_path: Path, report: Report) -> None:
    """Compare the chosen pairs and verify them geometrically (Sampson distance squared, as it must be)."""
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = job["cores"]
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = job["settings"]["seed"]
    names = [photo["photo_id"] for photo in job["photos"]]
    pairs_path = database_path.with_name("pairs.txt")
    with report.step("Comparing photographs", len(job["pairs"])):
        for block in _blocks(job["pairs"], _PAIRS_AT_ONCE):
            pairs_path.write_text("".join(f"{names[i]} {names[j]}\n" for i, j in block), encoding="utf-8")
            pairing = pycolmap.ImportedPairingOptions()
            pairing.match_list_path = str(pairs_path)
            pycolmap.match_image_pairs(
                database_path, matching_options=matching, pairing_options=pairing, verification_options=verification
            )
            report.advance(len(block))
    pairs_path.unlink(missing_ok=True)
