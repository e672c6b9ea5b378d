"""Structure from motion of a campaign: the job for the worker, made of table `photos`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64Array
from facadelake.core.code_version import compute_code_version
from facadelake.core.errors import InputDataError
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.hashing import compute_key
from facadelake.photos import FULL_FRAME_DIAGONAL_MM
from facadelake.sfm.pairing import choose_pairs, direction_from_yaw_pitch, find_uncertain_positions
from facadelake.sfm.settings import ReconstructionSettings
from facadelake.sfm.work_folder import open_work_folder
from facadelake.sfm.worker_process import run_worker
from schemas.vocabulary import PhotoOutcome, PhotoRole

# COLMAP's guess where a photograph says nothing of its focal length: 1.2 times the longer side.
_DEFAULT_FOCAL_FACTOR = 1.2


def reconstruct(photos: pa.Table, photographs_root: Path, folder: Path, settings: ReconstructionSettings) -> None:
    """Reconstruct the accepted photographs of table ``photos`` (paths below ``photographs_root``) into ``folder``.

    ``folder`` then holds COLMAP's model (``sparse/``), the arrays that ``read_reconstruction`` reads and the worker's
    log. Photographs that mapping leaves out of the largest block are resected against it; those that stay outside are
    listed with the reason. A run that is killed leaves its work beside ``folder``, and the next one goes on from there.
    Raises InputDataError for fewer than 3 photographs or none that overlap.
    """
    rows = [row for row in photos.to_pylist() if row["photo_outcome"] == PhotoOutcome.ACCEPTED]
    if len(rows) < 3:
        raise InputDataError(
            f"{len(rows)} of {len(photos)} photographs are usable; add some: 3 that overlap are needed"
        )
    rows.sort(key=lambda row: (row["taken_at"] is None, row["taken_at"], row["photo_id"]))
    cameras, camera_of = group_by_camera(rows)
    xyz_m, sigma_m = read_prior_positions(rows)
    direction = direction_from_yaw_pitch(_read_column(rows, "prior_yaw_deg"), _read_column(rows, "prior_pitch_deg"))
    close_range = np.array([row["role"] == PhotoRole.CLOSERANGE for row in rows])
    half_view_deg = np.array([_compute_half_view_deg(cameras[camera]) for camera in camera_of])
    job: dict[str, Any] = {
        "settings": settings.cache_key,
        "cameras": cameras,
        "photos": [
            {
                "photo_id": row["photo_id"],
                "camera": camera,
                "prior_m": xyz.tolist() if np.isfinite(xyz).all() else None,
                "prior_sigma_m": sigma.tolist(),
            }
            for row, camera, xyz, sigma in zip(rows, camera_of, xyz_m, sigma_m, strict=True)
        ],
        "pairs": choose_pairs(xyz_m, direction, close_range, settings, half_view_deg=half_view_deg),
        "sought": np.flatnonzero(find_uncertain_positions(xyz_m, sigma_m, settings)).tolist(),
    }
    code = compute_code_version("facadelake.sfm.worker.__main__").sha256
    key = compute_key({"job": job, "photos": [row["sha256"] for row in rows], "code": code})
    with open_work_folder(folder.parent, key) as work:
        here = {"photographs_root": str(photographs_root), "cores": settings.cores, "work": str(work)}
        run_worker(job | here, folder)


def _compute_half_view_deg(camera: dict[str, Any]) -> float:
    """Half the diagonal angle of view; NaN where the focal length is a guess."""
    if not camera["focal_known"]:
        return math.nan
    return math.degrees(math.atan(math.hypot(camera["width_px"], camera["height_px"]) / 2 / camera["focal_px"]))


def _read_column(rows: list[dict[str, Any]], name: str) -> Float64Array:
    return np.array([math.nan if row[name] is None else row[name] for row in rows], dtype=np.float64)


def read_prior_positions(rows: list[dict[str, Any]]) -> tuple[Float64Array, Float64Array]:
    """Position priors (n, 3) in a local east-north-up frame at their mean, metres, and their sigmas (n, 3); NaN where
    a photograph has none. A missing height counts as the mean of the others.
    """
    lon_lat_height = np.column_stack(
        [_read_column(rows, f"prior_{name}") for name in ("lon_deg", "lat_deg", "height_m")]
    )
    placed = np.isfinite(lon_lat_height[:, :2]).all(axis=1)
    sigma = np.column_stack(
        [_read_column(rows, f"prior_sigma_{axis}_m") for axis in ("horizontal", "horizontal", "vertical")]
    )
    xyz = np.full((len(rows), 3), math.nan)
    if placed.any():
        heights = lon_lat_height[placed, 2]
        middle = float(np.nanmedian(heights)) if np.isfinite(heights).any() else 0.0
        lon_lat_height[placed, 2] = np.where(np.isfinite(heights), heights, middle)
        lon_deg, lat_deg = np.median(lon_lat_height[placed, :2], axis=0)
        origin = SiteOrigin(lon_deg=float(lon_deg), lat_deg=float(lat_deg), height_ellipsoidal_m=middle)
        xyz[placed] = origin.site_from_geo(lon_lat_height[placed])
    return xyz, sigma


def group_by_camera(rows: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], list[int]]:
    """One camera for each body, lens, size and focal length (zoom), and which one took each photograph."""
    number_of: dict[tuple[Any, ...], int] = {}
    cameras: list[dict[str, Any]] = []
    camera_of: list[int] = []
    for row in rows:
        width, height = row["image_width_px"], row["image_height_px"]
        focal_px, known = _choose_focal_px(row)
        body = tuple(row.get(name) for name in ("camera_make", "camera_model", "camera_serial", "lens_model"))
        # Focal lengths are stated with two or three figures: nearer ones are one setting of the zoom.
        key = (*body, width, height, row["focal_length_mm"], f"{focal_px:.2e}" if known else "")
        if key not in number_of:
            number_of[key] = len(cameras)
            cameras.append({"width_px": width, "height_px": height, "focal_px": focal_px, "focal_known": known})
        camera_of.append(number_of[key])
    return cameras, camera_of


def _choose_focal_px(row: dict[str, Any]) -> tuple[float, bool]:
    """The focal length to start from, and whether the photograph states it."""
    width, height = row["image_width_px"], row["image_height_px"]
    if row.get("prior_focal_px"):
        return row["prior_focal_px"], True
    if row["focal_length_35mm_mm"]:
        return row["focal_length_35mm_mm"] * math.hypot(width, height) / FULL_FRAME_DIAGONAL_MM, True
    return _DEFAULT_FOCAL_FACTOR * max(width, height), False
