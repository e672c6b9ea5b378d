"""Published cameras of a truth folder as a file of poses, to measure registration without a reconstruction."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from facadelake.core.geodesy import SiteOrigin

# Sigmas stated for the published cameras: nearly 0, because the check points were triangulated with them.
EXACT_SIGMA_M, EXACT_SIGMA_DEG = 0.001, 0.005
NOISE_SIGMA_M, NOISE_SIGMA_DEG = 0.02, 0.05


def write_published_poses(truth: Path, path: Path, *, noise: np.random.Generator | None) -> Path:
    """Write the published cameras of a truth folder as poses (docs/poses-csv.md).

    Args:
        truth: folder with ``cameras.csv``.
        path: file to write.
        noise: random generator of the noise that is added to the poses, whose sigmas the file states; None for none.

    Returns:
        ``path``.
    """
    with (truth / "cameras.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    origin = _compute_origin(rows[0])
    sigma_m, sigma_deg = (EXACT_SIGMA_M, EXACT_SIGMA_DEG) if noise is None else (NOISE_SIGMA_M, NOISE_SIGMA_DEG)
    lens = [name for name in ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2") if name in rows[0]]
    with path.open("w", newline="") as stream:
        stream.write(
            f"# site_origin: {origin.lon_deg:.10f} {origin.lat_deg:.10f} {origin.height_ellipsoidal_m:.5f}\n"
            f"# rotation: cam_from_world\n# sigma_position_m: {sigma_m}\n# sigma_attitude_deg: {sigma_deg}\n"
        )
        writer = csv.writer(stream)
        matrix = [f"r{i}{j}" for i in range(3) for j in range(3)]
        writer.writerow(["image", "x_site_m", "y_site_m", "z_site_m", *matrix, *lens])
        for row in rows:
            centre = np.array([float(row[f"{axis}_site_m"]) for axis in "xyz"])
            cam_from_site = np.array([float(row[f"cam_from_site_{name}"]) for name in matrix]).reshape(3, 3)
            if noise is not None:
                centre = centre + noise.normal(0, sigma_m, 3)
                turn = Rotation.from_rotvec(noise.normal(0, np.radians(sigma_deg), 3)).as_matrix()
                cam_from_site = turn @ cam_from_site
            writer.writerow([row["image"], *centre, *cam_from_site.ravel(), *(row[name] for name in lens)])
    return path


def _compute_origin(row: dict[str, str]) -> SiteOrigin:
    """Origin of the site frame of the truth, from a camera with coordinates in that frame and in EPSG:4979."""
    xyz = np.array([[float(row[f"{axis}_site_m"]) for axis in "xyz"]])
    geo = np.array([[float(row[name]) for name in ("lon_deg", "lat_deg", "height_ellipsoidal_m")]])
    lon, lat, height = geo[0]
    for _ in range(5):
        guess = SiteOrigin(lon_deg=lon, lat_deg=lat, height_ellipsoidal_m=height)
        lon, lat, height = guess.geo_from_site(guess.site_from_geo(geo) - xyz)[0]
    return SiteOrigin(lon_deg=float(lon), lat_deg=float(lat), height_ellipsoidal_m=float(height))
