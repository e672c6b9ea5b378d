"""Structure from motion of a campaign: the job of the worker process, made of table `photos`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64N, Float64Nx3
from facadelake.core.cache import DIAGNOSTICS, WORK_SIZE_FILE
from facadelake.core.code_version import compute_code_version, require_unchanged_code
from facadelake.core.errors import InputDataError
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.hashing import compute_key
from facadelake.sfm.cameras import group_by_camera
from facadelake.sfm.pairing import choose_pairs, direction_from_yaw_pitch, find_uncertain_positions
from facadelake.sfm.settings import ReconstructionSettings
from facadelake.sfm.worker_process import open_work_folder, run_worker
from schemas.vocabulary import PhotoOutcome, PhotoRole

_WORKER = "facadelake.sfm.worker.__main__"


def reconstruct(photos: pa.Table, photographs_root: Path, folder: Path, settings: ReconstructionSettings) -> None:
    """Reconstruct the accepted photographs of a campaign in a worker process.

    Photographs outside the largest block are resected against it. Those that stay unlocalised are listed with the
    reason. An interrupted run leaves its work beside ``folder``, from which the next one resumes.

    Args:
        photos: table ``photos``.
        photographs_root: folder below which the photographs' paths lie.
        folder: output: COLMAP's model (``sparse/``), the arrays that ``read_reconstruction`` reads, the worker's log.
        settings: number of features, pairs and threads, and the seed.

    Raises:
        InputDataError: fewer than 3 photographs are accepted, or none overlap.
    """
    rows = [row for row in photos.to_pylist() if row["photo_outcome"] == PhotoOutcome.ACCEPTED]
    if len(rows) < 3:
        raise InputDataError(
            f"{len(rows)} of {len(photos)} photographs are usable; at least 3 that overlap are needed: add photographs"
        )
    rows.sort(key=lambda row: (row["taken_at"] is None, row["taken_at"], row["photo_id"]))
    cameras, camera_index = group_by_camera(rows)
    xyz_m, sigma_m = read_prior_positions(rows)
    direction = direction_from_yaw_pitch(_read_column(rows, "prior_yaw_deg"), _read_column(rows, "prior_pitch_deg"))
    close_range = np.array([row["role"] == PhotoRole.CLOSERANGE for row in rows])
    half_view_deg = np.array([_compute_half_view_deg(cameras[camera]) for camera in camera_index])
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
            for row, camera, xyz, sigma in zip(rows, camera_index, xyz_m, sigma_m, strict=True)
        ],
        "pairs": choose_pairs(xyz_m, direction, close_range, settings, half_view_deg=half_view_deg),
        "uncertain_positions": np.flatnonzero(find_uncertain_positions(xyz_m, sigma_m, settings)).tolist(),
    }
    code = compute_code_version(_WORKER).sha256
    key = compute_key({"job": job, "photos": [row["sha256"] for row in rows], "code": code})
    with open_work_folder(folder.parent, key) as work:
        require_unchanged_code(_WORKER)  # the worker loads it now, and fills a folder that a later run resumes from
        local_settings = {"photographs_root": str(photographs_root), "cores": settings.cores, "work": str(work)}
        run_worker(job | local_settings, folder)
        size_bytes = sum(path.stat().st_size for path in work.rglob("*") if path.is_file())
        (folder / DIAGNOSTICS / WORK_SIZE_FILE).write_text(str(size_bytes), "utf-8")


def _compute_half_view_deg(camera: dict[str, Any]) -> float:
    """Half the diagonal angle of view; NaN where the focal length is the default."""
    if not camera["focal_known"]:
        return math.nan
    return math.degrees(math.atan(math.hypot(camera["width_px"], camera["height_px"]) / 2 / camera["focal_px"]))


def _read_column(rows: list[dict[str, Any]], name: str) -> Float64N:
    """Column ``name`` (n,) as numbers; NaN for null."""
    return np.array([math.nan if row[name] is None else row[name] for row in rows], dtype=np.float64)


def read_prior_positions(rows: list[dict[str, Any]]) -> tuple[Float64Nx3, Float64Nx3]:
    """Position priors (n, 3) and their sigmas (n, 3), metres, in a local east-north-up frame; NaN for none.

    The origin is the median of the priors. A missing height is replaced by the median of the others.
    """
    lon_lat_height = np.column_stack(
        [_read_column(rows, f"prior_{name}") for name in ("lon_deg", "lat_deg", "height_m")]
    )
    has_position = np.isfinite(lon_lat_height[:, :2]).all(axis=1)
    sigma = np.column_stack(
        [_read_column(rows, f"prior_sigma_{axis}_m") for axis in ("horizontal", "horizontal", "vertical")]
    )
    xyz = np.full((len(rows), 3), math.nan)
    if has_position.any():
        heights = lon_lat_height[has_position, 2]
        median_height_m = float(np.nanmedian(heights)) if np.isfinite(heights).any() else 0.0
        lon_lat_height[has_position, 2] = np.where(np.isfinite(heights), heights, median_height_m)
        lon_deg, lat_deg = np.median(lon_lat_height[has_position, :2], axis=0)
        origin = SiteOrigin(lon_deg=float(lon_deg), lat_deg=float(lat_deg), height_ellipsoidal_m=median_height_m)
        xyz[has_position] = origin.site_from_geo(lon_lat_height[has_position])
    return xyz, sigma
