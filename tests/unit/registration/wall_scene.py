"""A wall of two elements in front of a camera, and detections on it."""

from collections.abc import Callable

import numpy as np
import pyarrow as pa
import pytest
import shapely

from facadelake.building.model import BuildingModel
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import table_from_rows

CAMERA = Camera(width_px=2000, height_px=1500, fx_px=1500, fy_px=1500, cx_px=1000, cy_px=750)


def look_at(eye, at) -> PosedCamera:
    """A camera at ``eye`` that looks at ``at``, upright."""
    z = np.asarray(at, dtype=float) - eye
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.0, 0, 1])
    x /= np.linalg.norm(x)
    rotation = np.array([x, np.cross(z, x), z]).T
    return PosedCamera(
        camera=CAMERA, site_from_cam=Similarity(rotation=rotation, translation=np.asarray(eye, dtype=float))
    )


def make_rectangle(corner, across, upward):
    """A rectangle as two triangles; its normal is across x upward."""
    corner, across, upward = (np.asarray(v, dtype=float) for v in (corner, across, upward))
    return np.array([corner, corner + across, corner + across + upward, corner + upward])


@pytest.fixture
def wall() -> BuildingModel:
    """A wall facing south in the plane y = 0, x from -10 to 10: element "low" up to z = 3, "high" up to z = 6."""
    low, high = make_rectangle([-10, 0, 0], [20, 0, 0], [0, 0, 3]), make_rectangle([-10, 0, 3], [20, 0, 0], [0, 0, 3])
    rows = [
        {
            "element_guid": guid, "ifc_class": "IfcWall", "element_name": f"{guid} wall", "storey": storey,
            "material": "brick", "is_external": True, "facade": "S", "surface_area_m2": 60.0, "triangles": 2,
            "geometry": shapely.to_wkb(shapely.box(8.4, 48.9, 8.4001, 48.9001)),
        }
        for guid, storey in (("low", "Ground floor"), ("high", "First floor"))
    ]  # fmt: skip
    return BuildingModel(
        origin=SiteOrigin(lon_deg=8.4078, lat_deg=48.9405, height_ellipsoidal_m=180.0),
        map_crs="EPSG:25832",
        vertical_datum="ellipsoidal",
        georeference_level="50",
        remarks="",
        vertices_site_m=np.vstack([low, high]),
        triangles=np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]),
        element_of_triangle=np.array([0, 0, 1, 1]),
        elements=table_from_rows("elements", rows),
    )


@pytest.fixture
def detections_of() -> Callable[..., pa.Table]:
    """Makes table ``detections`` of (detection_id, photo_id, class, box) with optional changes to every row."""

    def make(*wanted: tuple[str, str, str, tuple[float, float, float, float]], **changes: object) -> pa.Table:
        return table_from_rows(
            "detections",
            [
                {
                    "detection_id": name, "photo_id": photo, "detection_outcome": "accepted", "defect_class": kind,
                    "source_class": kind, "score": 0.5, "box_x_px": box[0], "box_y_px": box[1], "box_width_px": box[2],
                    "box_height_px": box[3], "detector": "coco:test", "detector_sha256": "0", **changes,
                }
                for name, photo, kind, box in wanted
            ],
        )  # fmt: skip

    return make
