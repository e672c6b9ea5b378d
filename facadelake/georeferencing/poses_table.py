"""Table `poses`: where each accepted photograph stood and looked."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import shapely

from facadelake.core.camera import PosedCamera
from facadelake.core.frames import Float64Array
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.pose_table import pose_columns
from facadelake.core.tables import table_of_rows
from facadelake.georeferencing.georeference import Georeferenced
from facadelake.georeferencing.gps.prior_poses import prior_pose
from facadelake.sfm.reconstruction import Reconstruction
from schemas.vocabulary import PhotoOutcome, PoseSource


def build_poses_table(
    georeferenced: Georeferenced, reconstruction: Reconstruction, photos: pa.Table, *, origin: SiteOrigin
) -> pa.Table:
    """One row for each accepted photograph of ``photos``, with a pose or with the reason why it has none.

    Quaternions are site_from_cam with ``qw`` >= 0; the geometry is a WKB point in EPSG:4979.
    """
    found = {photo.photo_id: photo for photo in reconstruction.photos}
    reason_of = {photo.photo_id: photo.reason for photo in reconstruction.unlocalised}
    rows: list[dict[str, Any]] = []
    for row in photos.to_pylist():
        if row["photo_outcome"] != PhotoOutcome.ACCEPTED:
            continue
        photo_id = row["photo_id"]
        said: dict[str, Any] = {
            "photo_id": photo_id,
            "image_width_px": row["image_width_px"],
            "image_height_px": row["image_height_px"],
        }
        if photo_id in found:
            photo = found[photo_id]
            said |= {
                "pose_source": photo.source,
                "reprojection_error_px": photo.reprojection_error_px,
                "tie_points": photo.tie_points,
            }
            placed = placed_columns(georeferenced.cameras[photo_id], georeferenced.covariance[photo_id], origin)
            rows.append(said | placed)
            continue
        said |= {"reason": reason_of.get(photo_id, "not part of the reconstruction"), "tie_points": 0}
        prior = prior_pose(row, georeferenced, origin)
        if prior is None:
            rows.append(said | {"pose_source": PoseSource.UNLOCALISED})
        else:
            rows.append(
                said | {"pose_source": PoseSource.PRIOR} | placed_columns(prior.posed, prior.covariance, origin)
            )
    return table_of_rows("poses", rows)


def placed_columns(posed: PosedCamera, covariance: Float64Array, origin: SiteOrigin) -> dict[str, Any]:
    """Centre in site and EPSG:4979, attitude, intrinsics, and the ``covariance`` (6, 6) with its sigmas, as columns."""
    lon, lat, height = origin.geo_from_site(posed.centre_site_m[None])[0].tolist()
    return {
        **pose_columns(posed),
        "lon_deg": lon,
        "lat_deg": lat,
        "height_ellipsoidal_m": height,
        **_covariance_columns(covariance),
        "geometry": shapely.to_wkb(shapely.Point(lon, lat, height), output_dimension=3, flavor="iso"),
    }


def _covariance_columns(covariance: Float64Array) -> dict[str, Any]:
    """The covariance (6, 6) of centre and attitude, and sigmas for people."""
    east, north, up = np.sqrt(np.diag(covariance)[:3]).tolist()
    attitude = float(np.degrees(np.sqrt(np.linalg.eigvalsh(covariance[3:, 3:])[-1])))
    return {
        "covariance": covariance.ravel().tolist(),
        "sigma_east_m": east,
        "sigma_north_m": north,
        "sigma_up_m": up,
        "sigma_attitude_deg": attitude,
    }
