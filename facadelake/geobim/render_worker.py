"""The process that renders a virtual view: an OpenGL context wants a process to itself.

``python -m facadelake.geobim.render_worker FOLDER`` reads ``scene.npz`` there and writes ``view.npz``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pyrender
from OpenGL import GL


def render(folder: Path) -> None:
    """Render ``scene.npz``; keep the colours (h, w, 3) and the raw depth buffer (h, w), 1 where nothing is."""
    with np.load(folder / "scene.npz") as scene:
        triangles, colours, rotation = scene["triangles"], scene["colours"], scene["rotation"]
        fx, fy, cx, cy = scene["intrinsics"].tolist()
        width, height = scene["size"].tolist()
        near, far = scene["planes"].tolist()
    corners = triangles.reshape(-1, 3)
    paint = np.repeat(np.column_stack([colours, np.full(len(colours), 255, dtype=np.uint8)]), 3, axis=0)
    primitive = pyrender.Primitive(positions=corners, color_0=paint / np.float32(255), mode=GL.GL_TRIANGLES)
    pose = np.eye(4)
    pose[:3, :3] = rotation * [1, -1, -1]  # OpenGL's camera looks along -z with y up
    view = pyrender.Scene(bg_color=[0.85, 0.9, 0.96, 1.0], ambient_light=[1.0, 1.0, 1.0])
    mesh = view.add(pyrender.Mesh([primitive]))
    view.add(pyrender.IntrinsicsCamera(fx=fx, fy=fy, cx=cx, cy=cy, znear=near, zfar=far), pose=pose)
    renderer = pyrender.OffscreenRenderer(width, height)
    flags = pyrender.RenderFlags.FLAT | pyrender.RenderFlags.SKIP_CULL_FACES
    colour, _ = renderer.render(view, flags=flags)
    # Colours are smoothed by four samples a pixel, none at its centre, where depth is wanted: the mask's pass has one.
    renderer.render(view, flags=flags | pyrender.RenderFlags.SEG, seg_node_map={mesh: (255, 255, 255)})
    # pyrender turns the buffer to metres by itself; it is read again raw, for Eq. 7 to be ours to answer for.
    renderer._platform.make_current()
    raw = GL.glReadPixels(0, 0, width, height, GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT)
    buffer = np.frombuffer(raw, dtype=np.float32).reshape(height, width)[::-1]
    np.savez(folder / "view.npz", colour=colour, buffer=buffer)
    renderer.delete()


if __name__ == "__main__":
    render(Path(sys.argv[1]))
