"""A wall that faces south, four cameras before it, and their poses in files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from facadelake.building.surface.raycasting import Surface
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import table_from_rows
from facadelake.georeferencing.site_frame import SiteFrame

Array = NDArray[np.float64]
ORIGIN = SiteOrigin(lon_deg=8.4083, lat_deg=48.9409, height_ellipsoidal_m=171.5)
PLACE = SiteFrame(origin=ORIGIN, map_crs="EPSG:25832", vertical_datum="ellipsoidal", georeference_level="50")
WIDTH, HEIGHT = 4000, 3000
NAMES = [f"south/IMG_{i}.JPG" for i in range(4)]
CENTRES = np.array([[-6.0, -15.0, 3.0], [-2.0, -14.0, 4.0], [2.0, -15.5, 3.5], [6.0, -15.0, 5.0]])
# Columns: camera x is east, camera y is down, camera z is north.
LOOKS_NORTH = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
LENS = "2800,2810,2010.5,1490.5"


def build_wall() -> Surface:
    """20 m wide, 8 m high, its foot on the ground."""
    corners = np.array([[-10.0, 0, 0], [10.0, 0, 0], [10.0, 0, 8.0], [-10.0, 0, 8.0]])
    return Surface.from_mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))


def build_photos(names: list[str] | None = None, **columns: Any) -> pa.Table:
    """Table ``photos``; ``columns`` replace those of every row."""
    return table_from_rows(
        "photos",
        [
            {
                "photo_id": name, "sha256": name, "bytes": 1, "photo_outcome": "accepted", "image_width_px": WIDTH,
                "image_height_px": HEIGHT, "prior_source": "none", "prior_height_datum": "unknown", **columns,
            }
            for name in (names or NAMES)
        ],
    )  # fmt: skip


def format_geo(xyz_site_m: Array) -> str:
    lon, lat, height = ORIGIN.geo_from_site(xyz_site_m[None])[0]
    return f"{lon:.11f},{lat:.11f},{height:.6f}"


def format_quaternion() -> str:
    """Of LOOKS_NORTH as world_from_cam: a turn by -90 degrees about east."""
    return f"{np.sqrt(0.5):.12f},{-np.sqrt(0.5):.12f},0,0"


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def write_geo_csv(folder: Path, head: str = "# rotation: world_from_cam\n", turn: str | None = None) -> Path:
    """The four cameras by longitude, latitude, height and quaternion."""
    lines = [
        f"{name},{format_geo(xyz)},{turn or format_quaternion()},{LENS}"
        for name, xyz in zip(NAMES, CENTRES, strict=True)
    ]
    columns = "image,lon_deg,lat_deg,height_ellipsoidal_m,qw,qx,qy,qz,fx_px,fy_px,cx_px,cy_px"
    return write(folder / "poses.csv", "\n".join([head + columns, *lines]))
