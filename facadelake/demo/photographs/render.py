"""Rendering of photographs by pyrender, in a process of its own (one OpenGL context per process).

``python -m facadelake.demo.photographs.render FOLDER SHARD SHARDS`` reads ``job.pickle`` and the arrays of the scene in
FOLDER, renders every SHARDS-th photograph and prints its name. The light is baked into textures and colours, so
pyrender draws without shading.
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

from facadelake.core.arrays import Float32Array, Float64Array, Float64x4x4, UInt8Array
from facadelake.core.camera import Camera

# Factor of the rendered resolution before averaging; pyrender's four samples per pixel smooth only edges.
SUPERSAMPLING = 1.5
NEAR_M, FAR_M = 0.5, 420.0
# Half a mipmap level sharper than OpenGL's choice; the averaging smooths the rest.
LOD_BIAS = -0.5
JPEG_QUALITY = 92


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotoJob:
    """A photograph to render: its file, pose (4, 4), metadata, and the seed of its noise."""

    path: Path
    site_from_cam: Float64x4x4
    exif: bytes
    xmp: bytes
    seed: int


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderJob:
    """All photographs of a campaign, with one camera."""

    camera: Camera
    noise: float
    photographs: list[PhotoJob]


@dataclass(frozen=True, kw_only=True, eq=False)
class LensMap:
    """A pinhole image that covers the distorted photograph, and the position of each photograph pixel in it."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    map_x: Float32Array
    map_y: Float32Array


def compute_lens_map(camera: Camera, supersampling: float) -> LensMap:
    """The pinhole camera, and the map from its image to one of ``camera``.

    Both have ``supersampling`` times the resolution of the photograph.
    """
    rows, columns = round(camera.height_px * supersampling), round(camera.width_px * supersampling)
    # The undistortion is smooth: it is solved on every 16th pixel and interpolated.
    step = 16
    xs, ys = np.arange(0, columns + step, step), np.arange(0, rows + step, step)
    grid = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2).astype(np.float64) / supersampling
    rays = camera.rays_cam_from_img(grid)
    xy_normalised = (rays[:, :2] / rays[:, 2:]).reshape(len(ys), len(xs), 2)
    fx, fy = camera.fx_px * supersampling, camera.fy_px * supersampling
    corner = xy_normalised.min(axis=(0, 1)) * [fx, fy] - 4
    size = np.ceil(xy_normalised.max(axis=(0, 1)) * [fx, fy] + 4 - corner).astype(int)
    size += -size % 4
    positions = (np.array([fx, fy]) * xy_normalised - corner).astype(np.float32)
    at_x, at_y = np.meshgrid(
        (np.arange(columns, dtype=np.float32) + 0.5) / step, (np.arange(rows, dtype=np.float32) + 0.5) / step
    )
    maps = [
        cv2.remap(np.ascontiguousarray(positions[..., k]), at_x, at_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        for k in (0, 1)
    ]
    # OpenCV counts from the centre of the first pixel, this pinhole camera from the corner of the image.
    return LensMap(
        width_px=int(size[0]),
        height_px=int(size[1]),
        fx_px=fx,
        fy_px=fy,
        cx_px=float(-corner[0]),
        cy_px=float(-corner[1]),
        map_x=np.asarray(maps[0] - 0.5, dtype=np.float32),
        map_y=np.asarray(maps[1] - 0.5, dtype=np.float32),
    )


def develop(pinhole: UInt8Array, lens: LensMap, camera: Camera, noise: float, seed: int) -> UInt8Array:
    """The photograph of a pinhole image: lens distortion, downsampling, vignetting and sensor noise.

    Args:
        pinhole: the rendered image (rows, columns, 3).
        lens: the map from the photograph to the pinhole image.
        camera: the camera of the photograph.
        noise: strength of the sensor noise, grey levels.
        seed: of the noise.
    """
    distorted = cv2.remap(pinhole, lens.map_x, lens.map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    size = (camera.width_px, camera.height_px)
    reduced = cv2.resize(distorted, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    y, x = np.mgrid[0 : camera.height_px, 0 : camera.width_px].astype(np.float32)
    r2 = ((x - camera.cx_px) / camera.width_px) ** 2 + ((y - camera.cy_px) / camera.width_px) ** 2
    reduced *= (1 - 0.22 * r2)[..., None]
    white = np.asarray(np.random.default_rng(seed).standard_normal(reduced.shape, dtype=np.float32))
    grain = 1.6 * np.asarray(cv2.GaussianBlur(white, (0, 0), sigmaX=0.6))
    noisy = reduced + noise * (0.6 + np.sqrt(reduced / 255)) * grain
    return np.asarray(np.clip(noisy + 0.5, 0, 255).astype(np.uint8))


class _Renderer:
    """pyrender's scene and renderer, loaded with the scene of a job folder."""

    def __init__(self, folder: Path, lens: LensMap) -> None:
        os.environ["PYOPENGL_PLATFORM"] = "egl"
        import pyrender  # reads the variable above at import

        self.pyrender: Any = pyrender
        self.scene = pyrender.Scene(bg_color=[0.8, 0.85, 0.9, 1.0], ambient_light=[1.0, 1.0, 1.0])
        for path in sorted(folder.glob("part_*.npz")):
            with np.load(path) as part:
                self._add_mesh(np.load(path.with_name(path.name.replace("part", "texture")).with_suffix(".npy")), part)
        camera = pyrender.IntrinsicsCamera(lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, znear=NEAR_M, zfar=FAR_M)
        self.node = self.scene.add(camera)
        self.renderer = pyrender.OffscreenRenderer(lens.width_px, lens.height_px)
        self.has_lod_bias = False

    def _add_mesh(self, image: UInt8Array, part: Mapping[str, Float64Array]) -> None:
        """One mesh of all triangles that share a texture."""
        source = self.pyrender.Texture(source=image, source_channels="RGB")
        rgba = np.ones((len(part["triangles"]), 3, 4), dtype=np.float32)
        rgba[..., :3] = part["colours"][:, None, :]
        primitive = self.pyrender.Primitive(
            positions=part["triangles"].reshape(-1, 3).astype(np.float32),
            texcoord_0=part["uv"].reshape(-1, 2).astype(np.float32),
            color_0=rgba.reshape(-1, 4),
            material=self.pyrender.MetallicRoughnessMaterial(
                baseColorTexture=source, metallicFactor=0.0, roughnessFactor=1.0
            ),
        )
        self.scene.add(self.pyrender.Mesh([primitive]))

    def render_view(self, site_from_cam: Float64x4x4) -> UInt8Array:
        """The pinhole image from a pose; OpenGL's camera looks along -z with y up."""
        self.scene.set_pose(self.node, site_from_cam @ np.diag([1.0, -1.0, -1.0, 1.0]))
        flags = self.pyrender.RenderFlags.FLAT | self.pyrender.RenderFlags.SKIP_CULL_FACES
        colour, _ = self.renderer.render(self.scene, flags=flags)
        if not self.has_lod_bias:
            self._set_lod_bias()  # textures exist in the context after the first rendering
            colour, _ = self.renderer.render(self.scene, flags=flags)
        return np.asarray(colour, dtype=np.uint8)

    def _set_lod_bias(self) -> None:
        """Set the mipmap bias of all textures."""
        from OpenGL import GL  # after the platform was set

        for mesh in self.scene.meshes:
            texture = mesh.primitives[0].material.baseColorTexture
            texture._bind()
            GL.glTexParameterf(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_LOD_BIAS, LOD_BIAS)
            texture._unbind()
        self.has_lod_bias = True


def render_shard(folder: Path, shard: int, shards: int) -> None:
    """Render the photographs ``shard``, ``shard + shards``, ... of a job folder."""
    job: RenderJob = pickle.loads((folder / "job.pickle").read_bytes())
    lens = compute_lens_map(job.camera, SUPERSAMPLING)
    renderer = _Renderer(folder, lens)
    for photo in job.photographs[shard::shards]:
        image = develop(renderer.render_view(photo.site_from_cam), lens, job.camera, job.noise, photo.seed)
        photo.path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(image).save(
            photo.path, format="JPEG", quality=JPEG_QUALITY, subsampling=0, exif=photo.exif, xmp=photo.xmp
        )
        print(photo.path.name, flush=True)


if __name__ == "__main__":
    # Through the imported module, so that the pickled classes are the same.
    from facadelake.demo.photographs import render as module

    module.render_shard(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
