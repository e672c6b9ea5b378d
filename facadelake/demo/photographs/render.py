"""Photographs of a scene by pyrender, in a process of its own (one OpenGL context a process).

``python -m facadelake.demo.photographs.render FOLDER SHARD SHARDS``: reads ``job.pickle`` and the scene's arrays in
FOLDER, makes every SHARDS-th photograph and prints its name. Light is baked into textures and colours, so pyrender
draws them flat.
"""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image

from facadelake.core.arrays import Float32Array, Float64Array, UInt8Array
from facadelake.core.camera import Camera

# Rendered this much finer and averaged; pyrender's four samples a pixel smooth edges alone, not textures.
SUPERSAMPLING = 1.5
NEAR_M, FAR_M = 0.5, 420.0
# Half a mipmap level sharper than OpenGL would choose; the averaging of FINE takes the rest.
LOD_BIAS = -0.5
JPEG_QUALITY = 92


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotoJob:
    """A photograph to render: where it goes, from where it is seen, its tags, the seed of its noise."""

    path: Path
    site_from_cam: Float64Array
    exif: bytes
    xmp: bytes
    seed: int


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderJob:
    """All photographs of a campaign, by one camera."""

    camera: Camera
    noise: float
    photographs: list[PhotoJob]


@dataclass(frozen=True, kw_only=True, eq=False)
class LensMap:
    """A pinhole image wide enough, and where each fine pixel of the distorted photograph lies in it."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    map_x: Float32Array
    map_y: Float32Array


def compute_lens_map(camera: Camera, fine: float) -> LensMap:
    """The pinhole camera and the map that turn its picture into one of ``camera``, both ``fine`` times finer."""
    rows, columns = round(camera.height_px * fine), round(camera.width_px * fine)
    # The undistortion is smooth: it is solved on every 16th pixel and interpolated.
    step = 16
    xs, ys = np.arange(0, columns + step, step), np.arange(0, rows + step, step)
    grid = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2).astype(np.float64) / fine
    rays = camera.rays_cam_from_img(grid)
    flat = (rays[:, :2] / rays[:, 2:]).reshape(len(ys), len(xs), 2)
    fx, fy = camera.fx_px * fine, camera.fy_px * fine
    low = flat.min(axis=(0, 1)) * [fx, fy] - 4
    size = np.ceil(flat.max(axis=(0, 1)) * [fx, fy] + 4 - low).astype(int)
    size += -size % 4
    where = (np.array([fx, fy]) * flat - low).astype(np.float32)
    at_x, at_y = np.meshgrid(
        (np.arange(columns, dtype=np.float32) + 0.5) / step, (np.arange(rows, dtype=np.float32) + 0.5) / step
    )
    full = [
        cv2.remap(np.ascontiguousarray(where[..., k]), at_x, at_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        for k in (0, 1)
    ]
    # OpenCV counts from a pixel's centre, the pinhole here from the image's corner.
    return LensMap(
        width_px=int(size[0]),
        height_px=int(size[1]),
        fx_px=fx,
        fy_px=fy,
        cx_px=float(-low[0]),
        cy_px=float(-low[1]),
        map_x=np.asarray(full[0] - 0.5, dtype=np.float32),
        map_y=np.asarray(full[1] - 0.5, dtype=np.float32),
    )


def develop(pinhole: UInt8Array, lens: LensMap, camera: Camera, noise: float, seed: int) -> UInt8Array:
    """The photograph: lens distortion, averaging, a little vignetting, sensor noise."""
    bent = cv2.remap(pinhole, lens.map_x, lens.map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    small = cv2.resize(bent, (camera.width_px, camera.height_px), interpolation=cv2.INTER_AREA).astype(np.float32)
    y, x = np.mgrid[0 : camera.height_px, 0 : camera.width_px].astype(np.float32)
    r2 = ((x - camera.cx_px) / camera.width_px) ** 2 + ((y - camera.cy_px) / camera.width_px) ** 2
    small *= (1 - 0.22 * r2)[..., None]
    white = np.asarray(np.random.default_rng(seed).standard_normal(small.shape, dtype=np.float32))
    grain = 1.6 * np.asarray(cv2.GaussianBlur(white, (0, 0), sigmaX=0.6))
    noisy = small + noise * (0.6 + np.sqrt(small / 255)) * grain
    return np.asarray(np.clip(noisy + 0.5, 0, 255).astype(np.uint8))


class _Renderer:
    """pyrender's scene and renderer."""

    def __init__(self, folder: Path, lens: LensMap) -> None:
        os.environ["PYOPENGL_PLATFORM"] = "egl"
        import pyrender  # needs the variable above at import

        self.gl: Any = pyrender
        self.scene = pyrender.Scene(bg_color=[0.8, 0.85, 0.9, 1.0], ambient_light=[1.0, 1.0, 1.0])
        for path in sorted(folder.glob("part_*.npz")):
            with np.load(path) as part:
                self._add(np.load(path.with_name(path.name.replace("part", "texture")).with_suffix(".npy")), part)
        camera = pyrender.IntrinsicsCamera(lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, znear=NEAR_M, zfar=FAR_M)
        self.node = self.scene.add(camera)
        self.renderer = pyrender.OffscreenRenderer(lens.width_px, lens.height_px)
        self.sharp = False

    def _add(self, image: UInt8Array, part: Mapping[str, Float64Array]) -> None:
        """One mesh: all triangles that share a texture."""
        source = self.gl.Texture(source=image, source_channels="RGB")
        rgba = np.ones((len(part["triangles"]), 3, 4), dtype=np.float32)
        rgba[..., :3] = part["colours"][:, None, :]
        primitive = self.gl.Primitive(
            positions=part["triangles"].reshape(-1, 3).astype(np.float32),
            texcoord_0=part["uv"].reshape(-1, 2).astype(np.float32),
            color_0=rgba.reshape(-1, 4),
            material=self.gl.MetallicRoughnessMaterial(
                baseColorTexture=source, metallicFactor=0.0, roughnessFactor=1.0
            ),
        )
        self.scene.add(self.gl.Mesh([primitive]))

    def render_view(self, site_from_cam: Float64Array) -> UInt8Array:
        """The pinhole image; OpenGL's camera looks along -z with y up."""
        self.scene.set_pose(self.node, site_from_cam @ np.diag([1.0, -1.0, -1.0, 1.0]))
        flags = self.gl.RenderFlags.FLAT | self.gl.RenderFlags.SKIP_CULL_FACES
        colour, _ = self.renderer.render(self.scene, flags=flags)
        if not self.sharp:
            self._sharpen()  # textures are in the context from the first rendering on
            colour, _ = self.renderer.render(self.scene, flags=flags)
        return np.asarray(colour, dtype=np.uint8)

    def _sharpen(self) -> None:
        from OpenGL import GL  # after the platform is chosen

        for mesh in self.scene.meshes:
            texture = mesh.primitives[0].material.baseColorTexture
            texture._bind()
            GL.glTexParameterf(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_LOD_BIAS, LOD_BIAS)
            texture._unbind()
        self.sharp = True


def render_shard(folder: Path, shard: int, shards: int) -> None:
    """Make the photographs ``shard``, ``shard + shards``, ... of a job folder that are not there yet."""
    job: RenderJob = pickle.loads((folder / "job.pickle").read_bytes())
    lens = compute_lens_map(job.camera, SUPERSAMPLING)
    stage = _Renderer(folder, lens)
    for photo in job.photographs[shard::shards]:
        image = develop(stage.render_view(photo.site_from_cam), lens, job.camera, job.noise, photo.seed)
        photo.path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(image).save(
            photo.path, format="JPEG", quality=JPEG_QUALITY, subsampling=0, exif=photo.exif, xmp=photo.xmp
        )
        print(photo.path.name, flush=True)


if __name__ == "__main__":
    # Through the imported module, so that the pickled classes are the same.
    from facadelake.demo.photographs import render as module

    module.render_shard(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
