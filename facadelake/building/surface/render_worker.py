"""Render a virtual view in a process of its own, as an OpenGL context requires.

``python -m facadelake.building.surface.render_worker FOLDER`` reads ``scene.npz`` there and writes ``view.npz``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pyrender
from OpenGL import GL

from facadelake.core.arrays import Float32Array, UInt8Array


def render(folder: Path) -> None:
    """Render ``scene.npz`` to colours (h, w, 3) and the raw depth buffer (h, w), 1 where there is no surface."""
    view = RenderView(folder)
    np.savez(folder / "view.npz", colour=view.render_colour(), buffer=view.render_depth_buffer())
    view.close()


class RenderView:
    """The scene of ``scene.npz`` in ``folder`` with an off-screen renderer."""

    def __init__(self, folder: Path) -> None:
        with np.load(folder / "scene.npz") as scene:
            triangles, colours, rotation = scene["triangles"], scene["colours"], scene["rotation"]
            fx, fy, cx, cy = scene["intrinsics"].tolist()
            self._width, self._height = scene["size"].tolist()
            near, far = scene["planes"].tolist()
        corners = triangles.reshape(-1, 3)
        rgba = np.repeat(np.column_stack([colours, np.full(len(colours), 255, dtype=np.uint8)]), 3, axis=0)
        primitive = pyrender.Primitive(positions=corners, color_0=rgba / np.float32(255), mode=GL.GL_TRIANGLES)
        pose = np.eye(4)
        pose[:3, :3] = rotation * [1, -1, -1]  # OpenGL's camera looks along -z with y up
        self._scene = pyrender.Scene(bg_color=[0.85, 0.9, 0.96, 1.0], ambient_light=[1.0, 1.0, 1.0])
        self._mesh = self._scene.add(pyrender.Mesh([primitive]))
        self._scene.add(pyrender.IntrinsicsCamera(fx=fx, fy=fy, cx=cx, cy=cy, znear=near, zfar=far), pose=pose)
        self._renderer = pyrender.OffscreenRenderer(self._width, self._height)
        self._flags = pyrender.RenderFlags.FLAT | pyrender.RenderFlags.SKIP_CULL_FACES

    def render_colour(self) -> UInt8Array:
        """Render the colour image (h, w, 3)."""
        return np.asarray(self._renderer.render(self._scene, flags=self._flags)[0])

    def render_depth_buffer(self) -> Float32Array:
        """Render the depth buffer (h, w), sampled at pixel centres.

        The segmentation pass is used because the colour pass has four samples per pixel, none at the centre.
        """
        flags = self._flags | pyrender.RenderFlags.SEG
        self._renderer.render(self._scene, flags=flags, seg_node_map={self._mesh: (255, 255, 255)})
        # pyrender converts the buffer to metres; the raw buffer is read so that Eq. 7 is applied in one place.
        self._renderer._platform.make_current()
        raw = GL.glReadPixels(0, 0, self._width, self._height, GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT)
        return np.frombuffer(raw, dtype=np.float32).reshape(self._height, self._width)[::-1]

    def close(self) -> None:
        """Release the OpenGL context."""
        self._renderer.delete()


if __name__ == "__main__":
    render(Path(sys.argv[1]))
