"""A virtual photograph of the model from a posed camera (pinhole), by pyrender in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from facadelake.camera import PosedCamera
from facadelake.errors import ModelError
from facadelake.frames import Array
from facadelake.geobim.depth_buffer import eye_depth
from facadelake.geobim.model import BuildingModel
from facadelake.geobim.surface import Surface

_TIMEOUT_S = 300
_SUN = np.array([-0.4, -0.7, 0.6]) / np.linalg.norm([-0.4, -0.7, 0.6])
_PALETTE = {
    "IfcWindow": (120, 150, 175),
    "IfcDoor": (125, 95, 70),
    "IfcSlab": (170, 170, 170),
    "IfcRoof": (150, 90, 75),
}
_WALL = (215, 205, 190)


@dataclass(frozen=True, kw_only=True, eq=False)
class VirtualView:
    """``colour`` (h, w, 3) uint8; ``depth_m`` (h, w) along the camera's z, inf where the view misses the model.

    ``near_m`` and ``far_m`` are the clipping planes, which bound the depth buffer's resolution.
    """

    colour: NDArray[np.uint8]
    depth_m: Array
    near_m: float
    far_m: float


def virtual_view(building: BuildingModel, posed: PosedCamera, *, scale: float = 1.0) -> VirtualView:
    """The model as a camera without distortion at ``posed`` would see it, ``scale`` times the photograph's size.

    Raises ModelError where the renderer fails, with what it said.
    """
    camera = posed.camera
    width, height = max(1, round(camera.width_px * scale)), max(1, round(camera.height_px * scale))
    surface = Surface(building)
    along = (building.vertices_site_m - posed.centre_site_m) @ posed.site_from_cam.rotation[:, 2]
    # Clipping planes hug the scene: the buffer's steps grow with the square of depth over near.
    near = max(0.05, 0.5 * float(surface.distance_to(posed.centre_site_m[None])[0]))
    far = max(2 * near, 1.05 * float(along.max()))
    with tempfile.TemporaryDirectory(prefix="facadelake-view-") as folder:
        np.savez(
            Path(folder) / "scene.npz",
            triangles=(building.vertices_site_m[building.triangles] - posed.centre_site_m).astype(np.float32),
            colours=_colours(building, surface),
            rotation=posed.site_from_cam.rotation,
            intrinsics=np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])
            * np.array([width / camera.width_px, height / camera.height_px] * 2),
            size=np.array([width, height]),
            planes=np.array([near, far]),
        )
        run = subprocess.run(
            [sys.executable, "-m", "facadelake.geobim.render_worker", folder],
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            env={**os.environ, "PYOPENGL_PLATFORM": "egl"},
            check=False,
        )
        if run.returncode != 0:
            last = (run.stderr.strip().splitlines() or ["no message"])[-1]
            raise ModelError(
                f"the virtual view could not be rendered ({last}); `facadelake doctor` says what is missing"
            )
        with np.load(Path(folder) / "view.npz") as view:
            buffer = view["buffer"].astype(np.float64)
            colour = view["colour"]
    depth = np.where(buffer < 1.0, eye_depth(buffer, near, far), np.inf)
    return VirtualView(colour=colour, depth_m=depth, near_m=near, far_m=far)


def _colours(building: BuildingModel, surface: Surface) -> NDArray[np.uint8]:
    """A colour for each triangle (m, 3): by the element's class, shaded by a fixed sun."""
    classes = building.elements.column("ifc_class").to_pylist()
    base = np.array([_PALETTE.get(name, _WALL) for name in classes], dtype=np.float64)[building.element_of_triangle]
    shade = 0.62 + 0.38 * np.clip(surface.normals_site @ _SUN, 0.0, 1.0)
    tinted: NDArray[np.uint8] = (base * shade[:, None]).astype(np.uint8)
    return tinted
