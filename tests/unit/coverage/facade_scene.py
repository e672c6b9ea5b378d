"""A wall facing south, cameras square on it, and photographs with edges: what is visible follows by hand."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import shapely

from facadelake.building.model import BuildingModel
from facadelake.core.arrays import Float64Array
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import table_from_rows
from schemas.vocabulary import SurfaceKind

WIDTH_M, HEIGHT_M, THICK_M = 8.0, 4.0, 0.3
FOCAL_PX = 1000.0
CAMERA = Camera(width_px=1000, height_px=600, fx_px=FOCAL_PX, fy_px=FOCAL_PX, cx_px=500, cy_px=300)
NORTHWARD = np.column_stack([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
Box = tuple[Sequence[float], Sequence[float]]


def look_north(x_m: float, distance_m: float, z_m: float) -> PosedCamera:
    """A level camera in front of the wall that looks north; it shows 0.5 and 0.3 times its distance to each side."""
    return PosedCamera(
        camera=CAMERA,
        site_from_cam=Similarity(rotation=NORTHWARD, translation=np.array([x_m, -distance_m, z_m])),
    )


def make_box(box: Box) -> tuple[Float64Array, Float64Array]:
    """Vertices (8, 3) and outward triangles (12, 3) of an upright box from its lowest to its highest corner."""
    low, high = box
    corners = np.array([[x, y, z] for z in (low[2], high[2]) for y in (low[1], high[1]) for x in (low[0], high[0])])
    quads = [[0, 1, 5, 4], [1, 3, 7, 5], [3, 2, 6, 7], [2, 0, 4, 6], [4, 5, 7, 6], [0, 2, 3, 1]]
    return corners, np.array([[q[i] for i in t] for q in quads for t in ((0, 1, 2), (0, 2, 3))])


WALL: Box = ((0.0, 0.0, 0.0), (WIDTH_M, THICK_M, HEIGHT_M))


def make_building(
    boxes: dict[str, Box], kind: SurfaceKind = SurfaceKind.IFC, classes: dict[str, str] | None = None
) -> BuildingModel:
    """A building of boxes that face south, by GlobalId."""
    meshes = [make_box(box) for box in boxes.values()]
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    rows = [
        {
            "element_guid": guid, "ifc_class": (classes or {}).get(guid, "IfcWall"), "storey": "Ground floor",
            "material": "brick", "is_external": True, "facade": "S", "facade_azimuth_deg": 180.0,
            "surface_area_m2": 1.0, "triangles": 12, "geometry": shapely.to_wkb(shapely.box(8, 48, 8.1, 48.1)),
        }
        for guid in boxes
    ]  # fmt: skip
    return make_model(
        np.vstack([vertices for vertices, _ in meshes]),
        np.vstack([triangles + start for (_, triangles), start in zip(meshes, starts, strict=False)]),
        np.repeat(np.arange(len(boxes)), 12),
        table_from_rows("elements", rows),
        kind,
    )


def make_model(
    vertices: Float64Array, triangles: Float64Array, element: Float64Array, elements: pa.Table, kind: SurfaceKind
) -> BuildingModel:
    """A building model in Karlsruhe."""
    return BuildingModel(
        origin=SiteOrigin(lon_deg=8.4078, lat_deg=48.9405, height_ellipsoidal_m=180.0),
        map_crs="EPSG:25832", vertical_datum="ellipsoidal", georeference_level="50", remarks="",
        vertices_site_m=vertices, triangles=triangles, element_of_triangle=element, elements=elements,
        surface_kind=kind,
    )  # fmt: skip


def write_photograph(path: Path, blur_px: float = 0.0, blurred_from_x: int = 0) -> None:
    """A photograph of slanted bars, whose edges the lens spreads by ``blur_px`` from a column on."""
    y, x = np.mgrid[0 : CAMERA.height_px, 0 : CAMERA.width_px].astype(np.float32)
    bars = np.where(((x + 0.3 * y) % 200) < 100, 0.05, 0.5).astype(np.float32)
    light = cv2.GaussianBlur(bars, (0, 0), 0.6)
    if blur_px:
        light[:, blurred_from_x:] = cv2.GaussianBlur(bars, (0, 0), blur_px)[:, blurred_from_x:]
    grey = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)  # sRGB, IEC 61966-2-1
    cv2.imwrite(str(path), np.clip(255 * grey + 0.5, 0, 255).astype(np.uint8))
