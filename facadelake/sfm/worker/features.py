"""The database of features and verified matches; what an interrupted run finished is not repeated."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import psutil
import pycolmap

from facadelake.sfm.worker.mapping import compute_tolerance_factor
from facadelake.sfm.worker.report import ProgressReport

T = TypeVar("T")
Pairs = Sequence[tuple[int, int]]

# Pairs per call: few enough for steady progress and little to repeat, enough to reuse search indices.
_PAIRS_PER_BATCH = 100
# With fewer photographs of one camera, four distortion terms and two focal lengths are not determined.
_MIN_PHOTOS_FOR_OPENCV_MODEL = 4
# Memory of each thread while features are extracted. Measured on photographs of 48 Mpx at 2000 px: 220 MB, for the
# decoded photograph (3 bytes a pixel) and the scale space of the reduced one; 400 MB are allowed here.
_BYTES_PER_DECODED_PIXEL = 5
_BYTES_PER_SCALE_SPACE_PIXEL = 40
_SHARE_OF_FREE_MEMORY = 0.5


def _split_into_batches(items: Sequence[T], size: int) -> Iterator[Sequence[T]]:
    """Consecutive batches of ``size`` items."""
    for start in range(0, len(items), size):
        yield items[start : start + size]


def open_database(job: dict[str, Any], path: Path) -> dict[int, int]:
    """The database of the job's photographs, new or of an interrupted run; returns index in the job -> image id.

    The folder of ``path`` belongs to the job: where it has no intact database, all its content is removed. A new
    database is filled under another name and renamed, so that it is never found incomplete; one damaged by a crash of
    the machine is replaced. COLMAP writes each photograph and each pair in one transaction of SQLite.
    """
    if not _is_sound(path):
        for path_to_remove in path.parent.iterdir():  # also blocks made from a lost database
            shutil.rmtree(path_to_remove) if path_to_remove.is_dir() else path_to_remove.unlink()
        partial = path.with_name(f"{path.name}.partial")
        with pycolmap.Database.open(partial) as database:
            _write_photos(job, database)
        partial.rename(path)
    with pycolmap.Database.open(path) as database:
        id_of_name = {image.name: image.image_id for image in database.read_all_images()}
    return {index: id_of_name[photo["photo_id"]] for index, photo in enumerate(job["photos"])}


def _is_sound(path: Path) -> bool:
    """Whether the file exists and passes the quick check of SQLite."""
    if not path.exists():
        return False
    connection = sqlite3.connect(path)
    try:
        return bool(connection.execute("PRAGMA quick_check(1)").fetchone()[0] == "ok")
    except sqlite3.DatabaseError:
        return False
    finally:
        connection.close()


def _write_photos(job: dict[str, Any], database: pycolmap.Database) -> None:
    """Cameras, photographs and position priors (in a local east-north-up frame, metres, with covariance)."""
    photo_count = np.bincount([photo["camera"] for photo in job["photos"]], minlength=len(job["cameras"]))
    for number, parameters in enumerate(job["cameras"], start=1):
        width, height, focal = parameters["width_px"], parameters["height_px"], parameters["focal_px"]
        full = photo_count[number - 1] >= _MIN_PHOTOS_FOR_OPENCV_MODEL
        camera = pycolmap.Camera(
            model="OPENCV" if full else "SIMPLE_RADIAL",
            width=width,
            height=height,
            params=[focal, focal, width / 2, height / 2, 0, 0, 0, 0] if full else [focal, width / 2, height / 2, 0],
            camera_id=number,
        )
        camera.has_prior_focal_length = parameters["focal_known"]
        database.write_camera(camera, use_camera_id=True)
        rig = pycolmap.Rig(rig_id=number)
        rig.add_ref_sensor(camera.sensor_id)
        database.write_rig(rig, use_rig_id=True)
    for photo in job["photos"]:
        camera_id = photo["camera"] + 1
        image = pycolmap.Image(name=photo["photo_id"], camera_id=camera_id)
        image.image_id = database.write_image(image)
        frame = pycolmap.Frame()
        frame.rig_id = camera_id
        frame.add_data_id(image.data_id)
        database.write_frame(frame)
        if photo["prior_m"] is not None:
            prior = pycolmap.PosePrior()
            prior.corr_data_id = image.data_id
            prior.position = np.array(photo["prior_m"])
            prior.position_covariance = np.diag(np.array(photo["prior_sigma_m"]) ** 2)
            prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
            database.write_pose_prior(prior)


def estimate_memory_per_thread(job: dict[str, Any]) -> int:
    """Bytes that extracting features takes in each thread, for the largest photographs of the job."""
    largest: int = max(camera["width_px"] * camera["height_px"] for camera in job["cameras"])
    reduced: int = min(largest, job["settings"]["max_image_px"] ** 2)
    return largest * _BYTES_PER_DECODED_PIXEL + reduced * _BYTES_PER_SCALE_SPACE_PIXEL


def limit_threads(job: dict[str, Any], available_bytes: int) -> int:
    """Number of threads: the cores, or as many as half the free memory allows."""
    return int(np.clip(_SHARE_OF_FREE_MEMORY * available_bytes // estimate_memory_per_thread(job), 1, job["cores"]))


def extract_features(
    job: dict[str, Any], database_path: Path, image_id_of: dict[int, int], report: ProgressReport
) -> None:
    """Extract SIFT features of the photographs that have none yet.

    Args:
        job: the job, with settings and photographs.
        database_path: COLMAP's database of the job.
        image_id_of: index in the job -> image id.
        report: receives the progress.
    """
    settings = job["settings"]
    options = pycolmap.FeatureExtractionOptions()
    options.max_image_size = settings["max_image_px"]
    options.num_threads = limit_threads(job, psutil.virtual_memory().available)
    options.sift.max_num_features = settings["max_features"]
    options.sift.peak_threshold = 0.01 / 3  # half of COLMAP's: plain render has faint features only
    # COLMAP's -1 enlarges the photograph twofold first: twice the time, no gain on sharp photographs.
    options.sift.first_octave = 0
    with pycolmap.Database.open(database_path) as database:
        missing = [
            photo["photo_id"]
            for index, photo in enumerate(job["photos"])
            if not database.exists_descriptors(image_id_of[index])
        ]
    with report.step("Extracting features", len(job["photos"])):
        report.advance(len(job["photos"]) - len(missing))
        for batch in _split_into_batches(missing, 4 * options.num_threads):
            pycolmap.extract_features(
                database_path, job["photographs_root"], image_names=list(batch), extraction_options=options
            )
            report.advance(len(batch))


def match_pairs(
    job: dict[str, Any], pairs: Pairs, database_path: Path, image_id_of: dict[int, int], report: ProgressReport
) -> None:
    """Match the pairs not matched yet, and verify them geometrically.

    Args:
        job: the job, with settings and photographs.
        pairs: indices (i, j) of photographs in the job.
        database_path: COLMAP's database of the job, with features.
        image_id_of: index in the job -> image id.
        report: receives the progress.
    """
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = job["cores"]
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = job["settings"]["seed"]
    verification.ransac.max_error *= compute_tolerance_factor(job)
    names = [photo["photo_id"] for photo in job["photos"]]
    pairs_path = database_path.with_name("pairs.txt")
    with pycolmap.Database.open(database_path) as database:
        missing = [(i, j) for i, j in pairs if not database.exists_two_view_geometry(image_id_of[i], image_id_of[j])]
    if not pairs:
        return
    with report.step("Matching features", len(pairs)):
        report.advance(len(pairs) - len(missing))
        for batch in _split_into_batches(missing, _PAIRS_PER_BATCH):
            pairs_path.write_text("".join(f"{names[i]} {names[j]}\n" for i, j in batch), encoding="utf-8")
            pairing = pycolmap.ImportedPairingOptions()
            pairing.match_list_path = str(pairs_path)
            pycolmap.match_image_pairs(
                database_path, matching_options=matching, pairing_options=pairing, verification_options=verification
            )
            report.advance(len(batch))
    pairs_path.unlink(missing_ok=True)
