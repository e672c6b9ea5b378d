"""Structure from motion of a campaign: the job for the worker, made of table `photos`."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.errors import InputDataError
from facadelake.frames import Array
from facadelake.geodesy import SiteOrigin
from facadelake.photo.exif import FULL_FRAME_DIAGONAL_MM
from facadelake.pose.pairing import choose_pairs, viewing_directions
from facadelake.pose.runner import run_worker
from facadelake.pose.settings import ReconstructionSettings
from schemas.vocabulary import PhotoOutcome, PhotoRole

# COLMAP's guess where a photograph says nothing of its focal length: 1.2 times the longer side.
_GUESSED_FOCAL_FACTOR = 1.2


def reconstruct(photos: pa.Table, photographs_root: Path, folder: Path, settings: ReconstructionSettings) -> None:
    """Reconstruct the accepted photographs of table ``photos`` (paths below ``photographs_root``) into ``folder``.

    ``folder`` then holds COLMAP's model (``sparse/``), the arrays that ``read_reconstruction`` reads and the worker's
    log. Photographs that cannot be joined to the largest block are listed with the reason.
    Raises InputDataError for fewer than 3 photographs or none that overlap.
    """
    rows = [row for row in photos.to_pylist() if row["photo_outcome"] == PhotoOutcome.ACCEPTED]
    if len(rows) < 3:
        raise InputDataError(
            f"{len(rows)} of {len(photos)} photographs are usable; add some: 3 that overlap are needed"
        )
    rows.sort(key=lambda row: (row["taken_at"] is None, row["taken_at"], row["photo_id"]))
    cameras, camera_of = _cameras(rows)
    xyz_m, sigma_m = prior_positions(rows)
    direction = viewing_directions(_column(rows, "prior_yaw_deg"), _column(rows, "prior_pitch_deg"))
    close_range = np.array([row["role"] == PhotoRole.CLOSERANGE for row in rows])
    job = {
        "photographs_root": str(photographs_root),
        "settings": asdict(settings),
        "cores": settings.cores,
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
        "pairs": choose_pairs(xyz_m, direction, close_range, settings),
    }
    run_worker(job, folder)


def _column(rows: list[dict[str, Any]], name: str) -> Array:
    return np.array([math.nan if row[name] is None else row[name] for row in rows], dtype=np.float64)


def prior_positions(rows: list[dict[str, Any]]) -> tuple[Array, Array]:
    """Position priors (n, 3) in a local east-north-up frame at their mean, metres, and their sigmas (n, 3); NaN where
    a photograph has none. A missing height counts as the mean of the others.
    """
    lon_lat_height = np.column_stack([_column(rows, f"prior_{name}") for name in ("lon_deg", "lat_deg", "height_m")])
    placed = np.isfinite(lon_lat_height[:, :2]).all(axis=1)
    sigma = np.column_stack(
        [_column(rows, f"prior_sigma_{axis}_m") for axis in ("horizontal", "horizontal", "vertical")]
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


def _cameras(rows: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], list[int]]:
    """One camera for each make, model, size and focal length, and which one took each photograph."""
    number_of: dict[tuple[Any, ...], int] = {}
    cameras: list[dict[str, Any]] = []
    camera_of: list[int] = []
    for row in rows:
        width, height = row["image_width_px"], row["image_height_px"]
        focal_35mm = row["focal_length_35mm_mm"]
        key = (
            row["camera_make"],
            row["camera_model"],
            width,
            height,
            row["focal_length_mm"],
            round(focal_35mm or 0, 1),
        )
        if key not in number_of:
            number_of[key] = len(cameras)
            known = focal_35mm is not None and focal_35mm > 0
            focal_px = (
                focal_35mm * math.hypot(width, height) / FULL_FRAME_DIAGONAL_MM
                if known
                else _GUESSED_FOCAL_FACTOR * max(width, height)
            )
            cameras.append({"width_px": width, "height_px": height, "focal_px": focal_px, "focal_known": known})
        camera_of.append(number_of[key])
    return cameras, camera_of
