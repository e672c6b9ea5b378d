"""Errors of camera centres against the published ones, with the covariances of the poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64Nx3, Float64x3x3
from facadelake.core.errors import InputDataError, SchemaError
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.photo_names import PhotoNames
from facadelake.core.pose_table import read_posed_cameras
from facadelake.evaluation.campaigns.truth import Truth


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraErrors:
    """Errors of the n localised cameras with a published centre.

    ``error_site_m`` (n, 3): estimated minus published, m in site. ``covariance_m2``: (3, 3) of each centre as its pose
    states it; None where it states none.
    """

    photo_ids: tuple[str, ...]
    error_site_m: Float64Nx3
    covariance_m2: tuple[Float64x3x3 | None, ...]


def compare_cameras(
    poses: pa.Table, photo_ids: Sequence[str], truth: Truth, origin: SiteOrigin, folder: Path
) -> CameraErrors:
    """Compare camera centres with the published ones; nothing is aligned.

    Args:
        poses: Table ``poses`` of the run.
        photo_ids: The campaign's photographs.
        truth: The truth folder's content.
        origin: The run's site origin.
        folder: The truth folder, for messages.

    Raises:
        InputDataError: Truth has cameras, but none of the campaign's photographs.
        SchemaError: A covariance of ``poses`` is not a covariance.
    """
    names = PhotoNames(photo_ids).match_all(truth.cameras)
    published = {names[image].photo_id: geo for image, geo in truth.cameras.items()}
    if truth.cameras and not any(photo_id is not None for photo_id in published):
        raise InputDataError(
            f"{folder / 'cameras.csv'}, column image: none of its {len(truth.cameras)} photographs is in the campaign "
            f"({next(iter(truth.cameras))} there, {next(iter(photo_ids), 'none')} in the campaign); give this "
            "campaign's truth"
        )
    localised = read_posed_cameras(poses)
    columns = ["photo_id", "x_site_m", "y_site_m", "z_site_m", "covariance"]
    rows = [
        row
        for row in poses.select(columns).sort_by("photo_id").to_pylist()
        if row["photo_id"] in localised and row["photo_id"] in published
    ]
    published_site_m = origin.site_from_geo(np.array([published[row["photo_id"]] for row in rows]).reshape(-1, 3))
    estimated_site_m = np.array([[row[name] for name in columns[1:4]] for row in rows], dtype=np.float64).reshape(-1, 3)
    return CameraErrors(
        photo_ids=tuple(row["photo_id"] for row in rows),
        error_site_m=estimated_site_m - published_site_m,
        covariance_m2=tuple(_extract_centre_covariance(row["photo_id"], row["covariance"]) for row in rows),
    )


def _extract_centre_covariance(photo_id: str, numbers: Sequence[float] | None) -> Float64x3x3 | None:
    """The (3, 3) block of the centre from a pose's 36 numbers (centre, attitude). Raises SchemaError where they are not
    a covariance."""
    if numbers is None:
        return None
    covariance = np.array(numbers, dtype=np.float64)
    centre = covariance.reshape(6, 6)[:3, :3] if covariance.size == 36 else np.full((3, 3), np.nan)
    if not np.isfinite(centre).all() or np.linalg.eigvalsh(centre)[0] <= 0:
        raise SchemaError(
            f"the covariance of {photo_id} in table poses is not that of a centre and an attitude (36 numbers, "
            "positive definite for the centre); run the campaign again"
        )
    return centre
