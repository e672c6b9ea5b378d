"""Defects, repaired places and control points drawn into a facade's texture.

Each drawing fills its rectangle exactly, so that the centre of the rectangle is the centre of the defect.
"""

from __future__ import annotations

import zlib

import cv2
import numpy as np
from numpy.typing import NDArray

from facadelake.core.arrays import Float32Array, Float64Array, Float64N, UInt8Array
from facadelake.demo.defect_recipe import DefectOnDay
from facadelake.demo.recipe import DemoControlPoint
from facadelake.demo.textures.canvas import TextureCanvas
from facadelake.demo.textures.facades import BRICK, sample_blob

# Factor of the resolution of masks before averaging.
SUPERSAMPLING = 4
MARGIN_M = 0.06
_REPAIR_MARGIN_M = 0.06
TARGET_M = 0.16


def seed_defect(defect_id: str) -> np.random.Generator:
    """The random numbers of a defect's shape."""
    return np.random.default_rng(zlib.crc32(defect_id.encode()))


def draw_defect(canvas: TextureCanvas, defect: DefectOnDay) -> None:
    """Draw a defect, or its repair; an absent one, and a wall that was cleaned, leave the wall unchanged."""
    if defect.state == "absent" or (defect.state == "repaired" and defect.repair == "cleaning"):
        return
    rng = seed_defect(defect.id)
    width, height = defect.width_m, defect.height_m
    if defect.state == "repaired":
        margin_m = _REPAIR_MARGIN_M if defect.repair == "render" else 0.0
        _draw_repair(canvas, defect, rng, width + 2 * margin_m, height + 2 * margin_m)
    elif defect.kind == "crack":
        _draw_crack(canvas, defect, rng, width, height)
    elif defect.kind == "spalling":
        _draw_spalling(canvas, defect, rng, width, height)
    else:
        _draw_moisture(canvas, defect, rng, width, height)


class _DefectLayer:
    """The texels around a defect, and masks over them that are drawn at higher resolution and averaged."""

    def __init__(self, canvas: TextureCanvas, defect: DefectOnDay, width: float, height: float) -> None:
        u, v = defect.u_m, defect.v_m
        a, b = width / 2 + MARGIN_M, height / 2 + MARGIN_M
        self.canvas, self.region = canvas, canvas.find_region(u - a, v - b, u + a, v + b)
        self.centre = canvas.texel_from_uv(u, v)
        self.rows, self.columns = canvas.image[self.region].shape[:2]

    def mask_points_from_offset(self, u_m: Float64Array, v_m: Float64Array) -> NDArray[np.int32]:
        """Offsets from the centre of the defect (metres) as points (n, 2) of the fine mask, with 8 fractional bits."""
        c = (self.centre[0] + u_m * self.canvas.per_u - self.region[1].start) * SUPERSAMPLING - 0.5
        r = (self.centre[1] - v_m * self.canvas.per_v - self.region[0].start) * SUPERSAMPLING - 0.5
        return np.round(np.column_stack([c, r]) * 256).astype(np.int32)

    def make_mask(self) -> UInt8Array:
        """An empty fine mask."""
        return np.zeros((self.rows * SUPERSAMPLING, self.columns * SUPERSAMPLING), dtype=np.uint8)

    def average_mask(self, fine_mask: UInt8Array) -> Float32Array:
        """A fine mask reduced to the texels, 0 to 1."""
        small = cv2.resize(fine_mask, (self.columns, self.rows), interpolation=cv2.INTER_AREA)
        return np.asarray(small / np.float32(255), dtype=np.float32)


def _stretch(points: Float64Array, width: float, height: float) -> Float64Array:
    """Points (n, 2) scaled and shifted so that their bounding box is width by height, centred at zero."""
    low, high = points.min(axis=0), points.max(axis=0)
    return np.asarray((points - (low + high) / 2) / np.maximum(high - low, 1e-9) * [width, height])


def sample_crack_lines(rng: np.random.Generator, width: float, height: float) -> list[tuple[Float64Array, Float64N]]:
    """The lines of a crack, the trunk first: points (n, 2) about its centre, and width of each piece (n - 1,); metres.

    A wandering line of 7 to 11 mm and two branches of 5 mm, thinner towards their ends, within ``width`` by ``height``.
    """
    n = 26
    along = np.linspace(-0.5, 0.5, n)
    upright = height >= width
    wander = np.cumsum(rng.normal(size=n))
    wander -= np.linspace(wander[0], wander[-1], n) * rng.uniform(0, 1)
    trunk = np.column_stack([wander, along] if upright else [along, wander])
    trunk = _stretch(trunk, width, height)
    lines = [(trunk, rng.uniform(0.007, 0.011))]
    for start in rng.choice(np.arange(6, n - 6), 2, replace=False):
        inward = -np.sign(trunk[start] + 1e-9)
        reach = np.minimum(
            0.6 * np.array([width, height]), 0.9 * np.abs(inward * np.array([width, height]) / 2 - trunk[start])
        )
        steps = np.linspace(0, 1, 8)[:, None] * reach * inward * (rng.uniform(0.4, 1, 2))
        lines.append(
            (trunk[start] + steps + rng.normal(scale=0.006, size=(8, 2)) * np.linspace(0, 1, 8)[:, None], 0.005)
        )
    return [
        (points, width_m * (1 - 0.45 * np.abs(np.arange(len(points) - 1) / (len(points) - 1) - 0.4)))
        for points, width_m in lines
    ]


def _draw_crack(
    canvas: TextureCanvas, defect: DefectOnDay, rng: np.random.Generator, width: float, height: float
) -> None:
    """Dark lines with a soft dark rim."""
    layer = _DefectLayer(canvas, defect, width, height)
    fine_mask = layer.make_mask()
    for points, widths_m in sample_crack_lines(rng, width, height):
        for i, width_m in enumerate(widths_m.tolist()):
            px = max(1, round(width_m * canvas.per_u * SUPERSAMPLING))
            a, b = layer.mask_points_from_offset(points[i : i + 2, 0], points[i : i + 2, 1]).tolist()
            cv2.line(fine_mask, a, b, 255, px, cv2.LINE_AA, 8)
    mask = layer.average_mask(fine_mask)
    halo = cv2.GaussianBlur(mask, (0, 0), sigmaX=2.5)
    canvas.blend(layer.region, (120, 105, 85), np.asarray(0.35 * halo, dtype=np.float32))
    canvas.blend(layer.region, (32, 27, 24), np.asarray(0.95 * mask, dtype=np.float32))


def _make_blob_mask(
    layer: _DefectLayer, rng: np.random.Generator, width: float, height: float, corners: int, rough: float
) -> Float32Array:
    """Mask of an irregular area that fills width by height."""
    outline = _stretch(np.array(sample_blob(rng, corners, rough)), width, height)
    fine_mask = layer.make_mask()
    cv2.fillPoly(fine_mask, [layer.mask_points_from_offset(outline[:, 0], outline[:, 1])], 255, cv2.LINE_AA, 8)
    return layer.average_mask(fine_mask)


def _draw_spalling(
    canvas: TextureCanvas, defect: DefectOnDay, rng: np.random.Generator, width: float, height: float
) -> None:
    """Detached render: brick and crumbling mortar in an irregular hole with a lit and a shaded rim."""
    layer = _DefectLayer(canvas, defect, width, height)
    mask = _make_blob_mask(layer, rng, width, height, 22, 0.45)
    r, c = np.mgrid[0 : layer.rows, 0 : layer.columns].astype(np.float32)
    brick_height, brick_length = 0.075 * canvas.per_v, 0.25 * canvas.per_u
    course = (r / brick_height).astype(int)
    shifted = c / brick_length + 0.5 * (course % 2)
    shape = (course.max() + 1, int(shifted.max()) + 1)
    tones = rng.normal(scale=14, size=(*shape, 1)) + rng.normal(scale=(6, 4, 3), size=(*shape, 3))
    inside = (np.array(BRICK) * 0.8 + tones[course, shifted.astype(int)]).astype(np.float32)
    inside[((r / brick_height) % 1 * brick_height < 3) | (shifted % 1 * brick_length < 3)] = (128, 116, 102)
    grain = rng.normal(scale=17, size=(layer.rows, layer.columns)).astype(np.float32)
    inside += cv2.GaussianBlur(grain, (0, 0), sigmaX=1.2)[..., None] * 1.6
    canvas.blend(layer.region, np.asarray(inside, dtype=np.float32), mask)
    soft = cv2.GaussianBlur(mask, (0, 0), sigmaX=1.5)
    slope = np.roll(soft, 2, axis=0) - np.roll(soft, -2, axis=0)
    canvas.add(np.asarray(np.clip(slope, -0.8, 0.8) * 75 * mask, dtype=np.float32), layer.region)


def _draw_moisture(
    canvas: TextureCanvas, defect: DefectOnDay, rng: np.random.Generator, width: float, height: float
) -> None:
    """A soft dark stain, greenish and mottled, with a salt rim."""
    layer = _DefectLayer(canvas, defect, width, height)
    mask = _make_blob_mask(layer, rng, width, height, 16, 0.3)
    edge = max(1.5, 0.10 * min(width, height) * canvas.per_u)
    inner = cv2.erode(mask, np.ones((3, 3)), iterations=int(edge / 2))
    soft = np.asarray(cv2.GaussianBlur(inner, (0, 0), sigmaX=edge / 2), dtype=np.float32)
    rim = np.clip(soft * (1 - soft) * 4, 0, 1) * mask
    mottled = 0.72 + 0.16 * np.tanh(sample_noise(rng, layer.rows, layer.columns, 0.06 * canvas.per_u))
    canvas.blend(layer.region, (78, 76, 56), np.asarray(soft * mottled, dtype=np.float32))
    canvas.blend(layer.region, (225, 220, 205), np.asarray(0.16 * rim, dtype=np.float32))


def sample_noise(rng: np.random.Generator, rows: int, columns: int, step_px: float) -> Float32Array:
    """Smooth noise of unit strength (rows, columns), independent of the canvas' own random numbers.

    Args:
        rng: draws the noise.
        rows: rows of the result.
        columns: columns of the result.
        step_px: grain, texels.
    """
    coarse = rng.standard_normal((int(rows / step_px) + 3, int(columns / step_px) + 3), dtype=np.float32)
    return np.asarray(cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_CUBIC), dtype=np.float32)


def _draw_repair(
    canvas: TextureCanvas, defect: DefectOnDay, rng: np.random.Generator, width: float, height: float
) -> None:
    """Fresh render: an even, paler area with trowel edges."""
    layer = _DefectLayer(canvas, defect, width, height)
    mask = _make_blob_mask(layer, rng, width, height, 12, 0.12)
    tone = 4 * sample_noise(rng, layer.rows, layer.columns, 0.03 * canvas.per_u)
    fresh = np.array((224, 214, 190), dtype=np.float32) + tone[..., None]
    canvas.blend(layer.region, np.asarray(fresh, dtype=np.float32), np.asarray(0.93 * mask, dtype=np.float32))


def make_target(point: DemoControlPoint) -> DefectOnDay:
    """The square of a control point's target, as a defect that is drawn and projected like others."""
    return DefectOnDay(
        id=point.id,
        kind="crack",
        surface=point.surface,
        u_m=point.u_m,
        v_m=point.v_m,
        width_m=TARGET_M,
        height_m=TARGET_M,
        state="present",
    )


def draw_target(canvas: TextureCanvas, point: DemoControlPoint) -> None:
    """Draw a control point's target: a white disc with two black quadrants that meet in the point."""
    half = TARGET_M / 2
    layer = _DefectLayer(canvas, make_target(point), TARGET_M, TARGET_M)
    angle = np.linspace(0, 2 * np.pi, 49)
    disc, black = layer.make_mask(), layer.make_mask()
    cv2.fillPoly(disc, [layer.mask_points_from_offset(half * np.cos(angle), half * np.sin(angle))], 255, cv2.LINE_AA, 8)
    for start in (0, np.pi):
        arc = start + np.linspace(0, np.pi / 2, 13)
        pie = np.vstack([[0, 0], 0.88 * half * np.column_stack([np.cos(arc), np.sin(arc)])])
        cv2.fillPoly(black, [layer.mask_points_from_offset(pie[:, 0], pie[:, 1])], 255, cv2.LINE_AA, 8)
    canvas.blend(layer.region, (240, 240, 236), layer.average_mask(disc))
    canvas.blend(layer.region, (18, 18, 18), layer.average_mask(black))
