"""Camera centres against the published ones, with the uncertainty that the poses state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64Array
from facadelake.core.errors import InputDataError, SchemaError
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.photo_names import PhotoNames
from facadelake.core.pose_table import read_posed_cameras
from facadelake.evaluation.campaigns.truth import Truth


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraErrors:
    """Localised cameras with a published centre: ``error_site_m`` (n, 3), found minus true, and the covariance
    (3, 3), m^2, that each pose states for its centre; None where it states none."""

    photo_ids: tuple[str, ...]
    error_site_m: Float64Array
    covariance_m2: tuple[Float64Array | None, ...]


def compare_cameras(
    poses: pa.Table, photo_ids: Sequence[str], known: Truth, origin: SiteOrigin, folder: Path
) -> CameraErrors:
    """The poses beside the ``known`` cameras of the truth ``folder``, in the site frame of ``origin``; nothing aligned.

    Raises InputDataError where truth is of other photographs.
    """
    names = PhotoNames(photo_ids)
    published = {names.match(image).photo_id: geo for image, geo in known.cameras.items()}
    if known.cameras and not any(photo_id is not None for photo_id in published):
        raise InputDataError(
            f"{folder / 'cameras.csv'}, column image: none of its {len(known.cameras)} photographs is in the campaign "
            f"({next(iter(known.cameras))} against {next(iter(photo_ids), 'none')}); give this campaign's truth"
        )
    localised = read_posed_cameras(poses)
    columns = ["photo_id", "x_site_m", "y_site_m", "z_site_m", "covariance"]
    rows = [
        row
        for row in poses.select(columns).sort_by("photo_id").to_pylist()
        if row["photo_id"] in localised and row["photo_id"] in published
    ]
    true = origin.site_from_geo(np.array([published[row["photo_id"]] for row in rows]).reshape(-1, 3))
    found = np.array([[row[name] for name in columns[1:4]] for row in rows], dtype=np.float64).reshape(-1, 3)
    return CameraErrors(
        photo_ids=tuple(row["photo_id"] for row in rows),
        error_site_m=found - true,
        covariance_m2=tuple(_extract_centre_covariance(row["photo_id"], row["covariance"]) for row in rows),
    )


def _extract_centre_covariance(photo_id: str, numbers: Sequence[float] | None) -> Float64Array | None:
    """The centre's (3, 3) of a pose's 36 numbers. Raises SchemaError for what is no covariance."""
    if numbers is None:
        return None
    whole = np.array(numbers, dtype=np.float64)
    centre = whole.reshape(6, 6)[:3, :3] if whole.size == 36 else np.full((3, 3), np.nan)
    if not np.isfinite(centre).all() or np.linalg.eigvalsh(centre)[0] <= 0:
        raise SchemaError(
            f"the covariance of {photo_id} in table poses is not one of a centre and attitude (36 numbers, positive "
            "variances); run the campaign again"
        )
    return centre
