"""Render a virtual photograph of the model from a posed camera, by pyrender in a separate process (paper, Fig. 8)."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from facadelake.building.model import BuildingModel
from facadelake.building.surface.raycasting import Surface
from facadelake.core.arrays import Float64Array, UInt8Array
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.errors import ModelError

_TIMEOUT_S = 300
_SUN = np.array([-0.4, -0.7, 0.6]) / np.linalg.norm([-0.4, -0.7, 0.6])
_PALETTE = {
    "IfcWindow": (120, 150, 175),
    "IfcDoor": (125, 95, 70),
    "IfcSlab": (170, 170, 170),
    "IfcRoof": (150, 90, 75),
    "IfcRailing": (95, 100, 105),
    "IfcMember": (190, 178, 160),
    "IfcColumn": (200, 180, 165),
    "IfcStair": (165, 160, 155),
    "IfcStairFlight": (165, 160, 155),
    "IfcGeographicElement": (150, 165, 120),
}
_WALL = (215, 205, 190)


@dataclass(frozen=True, kw_only=True, eq=False)
class VirtualView:
    """A rendering of the model.

    ``colour`` (h, w, 3); ``buffer`` (h, w): values of the depth buffer in [0, 1], 1 where there is no surface.
    ``near_m`` and ``far_m`` are the clipping planes, which determine the depth buffer's resolution.
    """

    colour: UInt8Array
    buffer: Float64Array
    near_m: float
    far_m: float

    @property
    def depth_m(self) -> Float64Array:
        """Depth (h, w) along the camera's z, inf where there is no surface."""
        return np.where(self.buffer < 1.0, depth_from_buffer(self.buffer, self.near_m, self.far_m), np.inf)


def render_virtual_view(building: BuildingModel, posed: PosedCamera, *, scale: float = 1.0) -> VirtualView:
    """Render the model from ``posed`` without lens distortion, at ``scale`` times the photograph's size.

    Raises ModelError with the renderer's last message if it fails.
    """
    camera = posed.camera
    width, height = max(1, round(camera.width_px * scale)), max(1, round(camera.height_px * scale))
    with tempfile.TemporaryDirectory(prefix="facadelake-view-") as folder:
        near, far = write_scene(Path(folder), building, posed, width, height)
        run = subprocess.run(
            [sys.executable, "-m", "facadelake.building.surface.render_worker", folder],
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            env={**os.environ, "PYOPENGL_PLATFORM": "egl"},
            check=False,
        )
        if run.returncode != 0:
            last_line = (run.stderr.strip().splitlines() or ["no message"])[-1]
            raise ModelError(
                f"the virtual view could not be rendered ({last_line}); `facadelake doctor` reports what is missing"
            )
        with np.load(Path(folder) / "view.npz") as view:
            buffer = view["buffer"].astype(np.float64)
            colour = view["colour"]
    return VirtualView(colour=colour, buffer=buffer, near_m=near, far_m=far)


def write_scene(
    folder: Path, building: BuildingModel, posed: PosedCamera, width_px: int, height_px: int
) -> tuple[float, float]:
    """Write ``scene.npz`` for the renderer's process.

    Args:
        folder: folder of the file.
        building: the model.
        posed: the camera.
        width_px: width of the image.
        height_px: height of the image.

    Returns:
        Depths of the near and the far clipping plane, metres.
    """
    camera, surface = posed.camera, Surface(building)
    depth = (building.vertices_site_m - posed.centre_site_m) @ posed.site_from_cam.rotation[:, 2]
    # The planes are close to the scene, because the spacing of the buffer's values is proportional to depth**2 / near.
    near = max(0.05, 0.5 * float(surface.measure_distance(posed.centre_site_m[None])[0]))
    far = max(2 * near, 1.05 * float(depth.max()))
    np.savez(
        folder / "scene.npz",
        triangles=(building.vertices_site_m[building.triangles] - posed.centre_site_m).astype(np.float32),
        colours=_shade_triangles(building, surface),
        rotation=posed.site_from_cam.rotation,
        intrinsics=np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])
        * np.array([width_px / camera.width_px, height_px / camera.height_px] * 2),
        size=np.array([width_px, height_px]),
        planes=np.array([near, far]),
    )
    return near, far


def render_virtual_photograph(building: BuildingModel, posed: PosedCamera, *, scale: float = 1.0) -> VirtualView:
    """Render the model in the photograph's pixels, including its lens distortion.

    A camera without distortion that covers the photograph is rendered and its image resampled: colours bilinearly,
    depths by nearest neighbour. Raises ModelError as ``render_virtual_view`` does.
    """
    camera = posed.camera
    width, height = max(1, round(camera.width_px * scale)), max(1, round(camera.height_px * scale))
    undistorted = undistort_camera(camera)
    view = render_virtual_view(
        building, PosedCamera(camera=undistorted, site_from_cam=posed.site_from_cam), scale=scale
    )
    columns = (np.arange(width) + 0.5) * camera.width_px / width
    rows = (np.arange(height) + 0.5) * camera.height_px / height
    maps = np.empty((2, height, width), dtype=np.float32)
    rendered_scale = np.array(view.buffer.shape[::-1]) / np.array([undistorted.width_px, undistorted.height_px])
    for i, row in enumerate(rows):
        xy = undistorted.project(camera.rays_cam_from_img(np.column_stack([columns, np.full(width, row)])))
        maps[:, i] = (xy * rendered_scale - 0.5).T  # in OpenCV pixel centres are integers
    return replace(
        view,
        colour=np.asarray(
            cv2.remap(view.colour, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8
        ),
        buffer=np.asarray(
            cv2.remap(view.buffer, maps[0], maps[1], cv2.INTER_NEAREST, borderValue=1.0), dtype=np.float64
        ),
    )


def undistort_camera(camera: Camera) -> Camera:
    """A camera without distortion and with the same focal length that covers the field of view of ``camera``."""
    along = np.linspace(0.0, 1.0, 65)
    ends = np.zeros_like(along)
    border = np.vstack(
        [np.column_stack(side) for side in ((along, ends), (along, ends + 1), (ends, along), (ends + 1, along))]
    )
    rays = camera.rays_cam_from_img(border * [camera.width_px, camera.height_px])
    focal = np.array([camera.fx_px, camera.fy_px])
    pixels = rays[:, :2] / rays[:, 2:] * focal
    low, high = np.floor(pixels.min(axis=0)) - 1, np.ceil(pixels.max(axis=0)) + 1
    return Camera(
        width_px=int(high[0] - low[0]),
        height_px=int(high[1] - low[1]),
        fx_px=camera.fx_px,
        fy_px=camera.fy_px,
        cx_px=float(-low[0]),
        cy_px=float(-low[1]),
    )


def _shade_triangles(building: BuildingModel, surface: Surface) -> UInt8Array:
    """Colour of each triangle (m, 3): by the element's class, shaded by a fixed sun."""
    classes = building.elements.column("ifc_class").to_pylist()
    base = np.array([_PALETTE.get(name, _WALL) for name in classes], dtype=np.float64)[building.element_of_triangle]
    shade = 0.62 + 0.38 * np.clip(surface.normals_site @ _SUN, 0.0, 1.0)
    shaded: UInt8Array = (base * shade[:, None]).astype(np.uint8)
    return shaded


def depth_from_buffer(z_s: Float64Array, near_m: float, far_m: float) -> Float64Array:
    """Depth along the camera's z, metres, from values ``z_s`` of the depth buffer in [0, 1] (any shape).

    ``f n / (f - z_s (f - n))``, which is n at z_s = 0 and f at z_s = 1, follows from the paper's Eqs. 5 and 6. Its
    Eq. 7, ``n / (z_s (f - n) + f)``, has no unit and gives n / f at the near plane.
    """
    depth: Float64Array = far_m * near_m / (far_m - z_s * (far_m - near_m))
    return depth
