"""Table `poses`: where each accepted photograph stood and looked."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import shapely
from scipy.spatial.transform import Rotation

from facadelake.geodesy import SiteOrigin
from facadelake.pose.georeference import Georeferenced
from facadelake.pose.reconstruction import Reconstruction
from facadelake.tables import table_of_rows
from schemas.vocabulary import PhotoOutcome, PoseSource


def poses_table(
    georeferenced: Georeferenced, reconstruction: Reconstruction, photos: pa.Table, *, origin: SiteOrigin
) -> pa.Table:
    """One row for each accepted photograph of ``photos``, with a pose or with the reason why it has none.

    Quaternions are site_from_cam with ``qw`` >= 0; the geometry is a WKB point in EPSG:4979.
    """
    cameras = georeferenced.cameras
    geo_of: dict[str, list[float]] = {}
    if cameras:
        geo = origin.geo_from_site(np.array([camera.centre_site_m for camera in cameras.values()]))
        geo_of = dict(zip(cameras, geo.tolist(), strict=True))
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
        if photo_id not in cameras:
            reason = reason_of.get(photo_id, "not part of the reconstruction")
            rows.append(said | {"pose_source": PoseSource.UNLOCALISED, "reason": reason, "tie_points": 0})
            continue
        posed, photo = cameras[photo_id], found[photo_id]
        qx, qy, qz, qw = Rotation.from_matrix(posed.site_from_cam.rotation).as_quat(canonical=True)
        x, y, z = posed.centre_site_m
        lon, lat, height = geo_of[photo_id]
        camera = posed.camera
        rows.append(
            said
            | {
                "pose_source": PoseSource.SFM,
                "x_site_m": x,
                "y_site_m": y,
                "z_site_m": z,
                "lon_deg": lon,
                "lat_deg": lat,
                "height_ellipsoidal_m": height,
                "qw": qw,
                "qx": qx,
                "qy": qy,
                "qz": qz,
                "fx_px": camera.fx_px,
                "fy_px": camera.fy_px,
                "cx_px": camera.cx_px,
                "cy_px": camera.cy_px,
                "k1": camera.k1,
                "k2": camera.k2,
                "p1": camera.p1,
                "p2": camera.p2,
                "reprojection_error_px": photo.reprojection_error_px,
                "tie_points": photo.tie_points,
                "geometry": shapely.to_wkb(shapely.Point(lon, lat, height), output_dimension=3, flavor="iso"),
            }
        )
    return table_of_rows("poses", rows)
