"""A wall with a painting on it, photographed by two oblique cameras that are known exactly."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa

from facadelake.building.model import BuildingModel
from facadelake.building.surface.raycasting import Surface
from facadelake.core.arrays import Float64Array
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import get_stage_schema, table_from_rows
from facadelake.reporting.inspection import Inspection

WALL_WIDTH_M, WALL_HEIGHT_M, WALL_THICK_M = 8.0, 4.0, 0.3
PAINT_PX_PER_M = 100
NASTY_NAME = "<script>alert('x')</script> & \"Hof\""


@dataclass(frozen=True, kw_only=True)
class PaintedWall:
    """The wall faces south, its front is y = 0, x from 0 to 8 m, z from 0 to 4 m; ``paint`` is seen from the south."""

    building: BuildingModel
    surface: Surface
    posed: dict[str, PosedCamera]
    paint: Float64Array
    root: Path


def point_camera(centre: Float64Array, target: Float64Array, camera: Camera) -> PosedCamera:
    """A camera at ``centre`` that looks at ``target``, its x axis level."""
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.column_stack([right, np.cross(forward, right), forward])
    return PosedCamera(camera=camera, site_from_cam=Similarity(rotation=rotation, translation=centre))


def make_box(low: Float64Array, high: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Vertices (8, 3) and outward triangles (12, 3) of an upright box."""
    corners = np.array([[x, y, z] for z in (low[2], high[2]) for y in (low[1], high[1]) for x in (low[0], high[0])])
    quads = [[0, 1, 5, 4], [1, 3, 7, 5], [3, 2, 6, 7], [2, 0, 4, 6], [4, 5, 7, 6], [0, 2, 3, 1]]
    return corners, np.array([[q[i] for i in t] for q in quads for t in ((0, 1, 2), (0, 2, 3))])


def make_painting() -> Float64Array:
    """A smooth colourful picture (h, w, 3) with an F in it, which a mirror would betray."""
    height, width = int(WALL_HEIGHT_M * PAINT_PX_PER_M), int(WALL_WIDTH_M * PAINT_PX_PER_M)
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    waves = [np.sin(x / 31.0 + k) * np.cos(y / 23.0 - k) for k in range(3)]
    paint = np.stack([128 + 70 * w for w in waves], axis=-1)
    for left, top, wide, high in ((120, 60, 40, 260), (160, 60, 140, 40), (160, 160, 90, 40)):
        paint[top : top + high, left : left + wide] = (250, 250, 250)
    return np.asarray(cv2.GaussianBlur(paint, (0, 0), 1.5), dtype=np.float64)


def render_photograph(posed: PosedCamera, paint: Float64Array) -> Float64Array:
    """The wall as the camera sees it (h, w, RGB): each pixel's ray met with the plane y = 0, by hand."""
    camera = posed.camera
    grid = np.stack(np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5), axis=-1)
    origins, directions = posed.rays_site_from_img(grid.reshape(-1, 2))
    points = origins - directions * (origins[:, 1] / directions[:, 1])[:, None]
    shape = (camera.height_px, camera.width_px)
    at_x = (points[:, 0] * PAINT_PX_PER_M - 0.5).reshape(shape).astype(np.float32)
    at_y = ((WALL_HEIGHT_M - points[:, 2]) * PAINT_PX_PER_M - 0.5).reshape(shape).astype(np.float32)
    return np.asarray(cv2.remap(paint, at_x, at_y, cv2.INTER_CUBIC, borderValue=(40, 60, 90)))


def make_painted_wall(root: Path) -> PaintedWall:
    """The wall, its cameras, and its photographs written into ``root``."""
    vertices, triangles = make_box(np.zeros(3), np.array([WALL_WIDTH_M, WALL_THICK_M, WALL_HEIGHT_M]))
    elements = table_from_rows(
        "elements",
        [
            {
                "element_guid": "wall",
                "ifc_class": "IfcWall",
                "element_name": NASTY_NAME,
                "storey": "Ground <floor>",
                "is_external": True,
                "facade": "S",
                "surface_area_m2": 70.0,
                "triangles": 12,
            }
        ],
    )
    building = BuildingModel(
        origin=SiteOrigin(lon_deg=8.4, lat_deg=48.9, height_ellipsoidal_m=180.0),
        map_crs="EPSG:25832",
        vertical_datum="ellipsoidal",
        georeference_level="registry",
        remarks="",
        vertices_site_m=vertices,
        triangles=triangles,
        element_of_triangle=np.zeros(len(triangles), dtype=np.int64),
        elements=elements,
    )
    camera = Camera(
        width_px=1000,
        height_px=700,
        fx_px=900,
        fy_px=905,
        cx_px=507,
        cy_px=344,
        k1=-0.08,
        k2=0.02,
        p1=0.001,
        p2=-0.0007,
    )
    posed = {
        "a.png": point_camera(np.array([2.0, -5.5, 1.4]), np.array([3.0, 0.0, 2.0]), camera),
        "b.png": point_camera(np.array([7.0, -6.0, 2.8]), np.array([5.5, 0.0, 2.0]), camera),
    }
    paint = make_painting()
    for name, pose in posed.items():
        shot = np.clip(render_photograph(pose, paint) + 0.5, 0, 255).astype(np.uint8)
        cv2.imwrite(str(root / name), shot[..., ::-1])
    return PaintedWall(building=building, surface=Surface(building), posed=posed, paint=paint, root=root)


def make_defect_row(defect_id: str, x_m: float, z_m: float, **others: object) -> dict[str, object]:
    """A row of defects on the wall's front."""
    return {
        "defect_id": defect_id, "defect_class": "crack", "severity": "none", "severity_rule": "size-1",
        "severity_low": "none", "severity_high": "none", "graded_by": None, "x_site_m": x_m, "y_site_m": 0.0,
        "z_site_m": z_m, "lon_deg": 8.4, "lat_deg": 48.9, "height_ellipsoidal_m": 180.0 + z_m,
        "east_map_m": 0.0, "north_map_m": 0.0, "height_map_m": 180.0 + z_m, "normal_x": 0.0, "normal_y": -1.0,
        "normal_z": 0.0, "width_m": 0.4, "height_m": 0.2, "area_m2": 0.08, "spread_m": 0.0, "photo_count": 1,
        "score": 1.0, "best_photo_id": "a.png", "element_guid": "wall", "ifc_class": "IfcWall",
        "element_name": NASTY_NAME, "storey": "Ground <floor>", "facade": "S",
        "facade_azimuth_deg": 180.0, "geometry": b"", **others,
    }  # fmt: skip


def make_point_row(name: str, kind: str, xyz_m: tuple[float, ...], residual_m: tuple[float, ...]) -> dict[str, object]:
    """A row of georeference_points; ``residual_m`` is given minus adjusted."""
    return {
        "point_name": name, "point_kind": kind, **dict(zip(("x_site_m", "y_site_m", "z_site_m"), xyz_m, strict=True)),
        "lon_deg": 8.4, "lat_deg": 48.9, "height_ellipsoidal_m": 180.0 + xyz_m[2],
        **dict(zip(("residual_east_m", "residual_north_m", "residual_up_m"), residual_m, strict=True)),
        "point_used": kind == "control", "geometry": b"",
    }  # fmt: skip


def make_inspection(painted: PaintedWall, defects: list[dict[str, object]], observed: list[str]) -> Inspection:
    """An inspection of the wall; each defect of ``observed`` has a box in a.png."""
    places = {row["defect_id"]: np.array([[row["x_site_m"], 0.0, row["z_site_m"]]]) for row in defects}
    corners = {name: painted.posed["a.png"].project_site(places[name])[0] - (20, 10) for name in observed}
    photos = [
        {"photo_id": name, "sha256": "0", "bytes": 1, "photo_outcome": outcome, "reason": reason,
         "prior_source": "none", "prior_height_datum": "unknown"}
        for name, outcome, reason in (
            ("a.png", "accepted", None), ("b.png", "accepted", None), (f"{NASTY_NAME}.jpg", "unreadable", NASTY_NAME),
        )
    ]  # fmt: skip
    detections = [
        {"detection_id": name, "photo_id": "a.png", "detection_outcome": "accepted", "defect_class": "crack",
         "source_class": "crack", "score": 1.0, "box_x_px": xy[0], "box_y_px": xy[1], "box_width_px": 40.0,
         "box_height_px": 20.0, "detector": "coco:x", "detector_sha256": "0"}
        for name, xy in corners.items()
    ]  # fmt: skip
    observations = [
        {"detection_id": name, "photo_id": "a.png", "observation_outcome": "registered", "defect_class": "crack",
         "defect_id": name, "target_share": 1.0, "x_site_m": places[name][0, 0], "y_site_m": 0.0,
         "z_site_m": places[name][0, 2]}
        for name in corners
    ]  # fmt: skip
    georeference = {
        "control": "gcp", "method": f"control points {NASTY_NAME} $x$", "map_crs": "EPSG:25832",
        "vertical_datum": "ellipsoidal", "georeference_level": "50", "points_used": 3, "points_total": 4,
        "check_points": 1, "check_residual_mean_m": 0.02, "check_residual_max_m": 0.02, "sigma_east_m": 0.01,
        "sigma_north_m": 0.011, "sigma_up_m": 0.02, "tie_sigma_px": 0.4, "tie_variance_factor": 2.0, "scale": 1.0,
        "residual_mean_m": 0.011, "residual_rmse_m": 0.0123, "residual_max_m": 0.02,
        "remarks": NASTY_NAME,
    }  # fmt: skip
    points = [
        make_point_row("C1", "control", (1.0, 0.0, 1.0), (0.002, -0.001, 0.004)),
        make_point_row(NASTY_NAME, "check", (7.0, 0.0, 3.0), (0.012, -0.005, 0.015)),
        *(
            make_point_row(name, "gps", tuple(pose.centre_site_m + np.array([1.0, 0.5, 2.0])), (1.0, 0.5, 2.0))
            for name, pose in painted.posed.items()
        ),
    ]
    poses = [
        {"photo_id": name, "pose_source": "sfm", "image_width_px": 1000, "image_height_px": 700, "tie_points": 9,
         **dict(zip(("x_site_m", "y_site_m", "z_site_m"), pose.centre_site_m.tolist(), strict=True)),
         "sigma_east_m": 0.01, "sigma_north_m": 0.02, "sigma_up_m": 0.03, "sigma_attitude_deg": 0.01,
         "covariance": np.diag([1e-4, 4e-4, 9e-4, 1e-8, 1e-8, 1e-8]).ravel().tolist()}
        for name, pose in painted.posed.items()
    ]  # fmt: skip
    checks = [
        {"table_name": "photos", "expectation": "not_null", "column_name": "sha256", "passed": True, "unexpected": 0,
         "detail": "{}"},
        {"table_name": "defects", "expectation": "between", "column_name": "width_m", "passed": False, "unexpected": 2,
         "detail": NASTY_NAME},
    ]  # fmt: skip
    statements = [
        {"statement": "gps_height", "placement_check_outcome": "disagrees", "deviation": 0.4, "deviation_sigma": 0.05,
         "deviation_limit": 0.175, "deviation_unit": "m", "detail": f"GPS deviates by +0.40 m; {NASTY_NAME}"},
        {"statement": "tie_points", "placement_check_outcome": "agrees", "deviation": 0.0, "deviation_limit": 0.5,
         "deviation_unit": "m", "detail": "810 of 1000 tie points lie on the model"},
    ]  # fmt: skip
    empty: pa.Table = get_stage_schema("integrity_views").empty_table()
    return Inspection(
        building_name=NASTY_NAME,
        campaign_id="2026-04",
        photographs_root=painted.root,
        building=painted.building,
        posed=painted.posed,
        photos=table_from_rows("photos", photos),
        poses=table_from_rows("poses", poses),
        georeference=table_from_rows("georeference", [georeference]),
        georeference_points=table_from_rows("georeference_points", points),
        placement_checks=table_from_rows("placement_checks", statements),
        detections=table_from_rows("detections", detections),
        observations=table_from_rows("observations", observations),
        defects=table_from_rows("defects", defects),
        merges=table_from_rows("merges", []),
        integrity_views=empty,
        coverage=get_stage_schema("coverage").empty_table(),
        checks=table_from_rows("checks", checks),
    )
