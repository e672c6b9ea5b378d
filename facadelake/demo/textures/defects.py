"""Defects drawn into a facade's texture: cracks, spalling, moisture, mended places and survey targets.

Each drawing fills its rectangle exactly, so that the rectangle's centre is the defect's centre.
"""

from __future__ import annotations

import zlib

import cv2
import numpy as np
from numpy.typing import NDArray

from facadelake.core.arrays import Float32Array, Float64Array, UInt8Array
from facadelake.demo.recipe import DefectState, DemoControlPoint, DemoDefect
from facadelake.demo.textures.canvas import TextureCanvas
from facadelake.demo.textures.facades import BRICK, sample_blob

# Texels are drawn this many times finer and averaged.
SUPERSAMPLING = 4
MARGIN_M = 0.06
TARGET_M = 0.16


def compute_size(defect: DemoDefect, state: DefectState) -> tuple[float, float]:
    """Width and height of a defect in a state, metres."""
    f = defect.growth if state == "grown" else 1.0
    return defect.width_m * f, defect.height_m * f


def draw_defect(canvas: TextureCanvas, defect: DemoDefect, state: DefectState) -> None:
    """Draw a defect, or the patch that mended it; an absent one leaves the wall as it is."""
    if state == "absent":
        return
    rng = np.random.default_rng(zlib.crc32(defect.id.encode()))
    width, height = compute_size(defect, state)
    if state == "repaired":
        _draw_repair(canvas, defect, rng, width + 0.12, height + 0.12)
    elif defect.kind == "crack":
        _draw_crack(canvas, defect, rng, width, height)
    elif defect.kind == "spalling":
        _draw_spalling(canvas, defect, rng, width, height)
    else:
        _draw_moisture(canvas, defect, rng, width, height)


class _DefectLayer:
    """The texels round a defect, and masks over them drawn fine and averaged."""

    def __init__(self, canvas: TextureCanvas, defect: DemoDefect, width: float, height: float) -> None:
        u, v = defect.u_m, defect.v_m
        a, b = width / 2 + MARGIN_M, height / 2 + MARGIN_M
        self.canvas, self.region = canvas, canvas.find_region(u - a, v - b, u + a, v + b)
        self.centre = canvas.texel_from_uv(u, v)
        self.rows, self.columns = canvas.image[self.region].shape[:2]

    def fine(self, u_m: Float64Array, v_m: Float64Array) -> NDArray[np.int32]:
        """Offsets from the defect's centre (metres) as points (n, 2) of the fine mask, 8 bits of fraction."""
        c = (self.centre[0] + u_m * self.canvas.per_u - self.region[1].start) * SUPERSAMPLING - 0.5
        r = (self.centre[1] - v_m * self.canvas.per_v - self.region[0].start) * SUPERSAMPLING - 0.5
        return np.round(np.column_stack([c, r]) * 256).astype(np.int32)

    def blank(self) -> UInt8Array:
        return np.zeros((self.rows * SUPERSAMPLING, self.columns * SUPERSAMPLING), dtype=np.uint8)

    def mask(self, fine: UInt8Array) -> Float32Array:
        small = cv2.resize(fine, (self.columns, self.rows), interpolation=cv2.INTER_AREA)
        return np.asarray(small / np.float32(255), dtype=np.float32)


def _stretch(points: Float64Array, width: float, height: float) -> Float64Array:
    """Points (n, 2) scaled and shifted so that their bounds are width by height about zero."""
    low, high = points.min(axis=0), points.max(axis=0)
    return np.asarray((points - (low + high) / 2) / np.maximum(high - low, 1e-9) * [width, height])


def _draw_crack(
    canvas: TextureCanvas, defect: DemoDefect, rng: np.random.Generator, width: float, height: float
) -> None:
    """A wandering dark line with two branches, 5 to 11 mm wide, thinning out."""
    sheet = _DefectLayer(canvas, defect, width, height)
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
    fine = sheet.blank()
    for points, thick in lines:
        for i in range(len(points) - 1):
            fade = 1 - 0.45 * abs(i / (len(points) - 1) - 0.4)
            px = max(1, round(thick * fade * canvas.per_u * SUPERSAMPLING))
            a, b = sheet.fine(points[i : i + 2, 0], points[i : i + 2, 1]).tolist()
            cv2.line(fine, a, b, 255, px, cv2.LINE_AA, 8)
    mask = sheet.mask(fine)
    halo = cv2.GaussianBlur(mask, (0, 0), sigmaX=2.5)
    canvas.blend(sheet.region, (120, 105, 85), np.asarray(0.35 * halo, dtype=np.float32))
    canvas.blend(sheet.region, (32, 27, 24), np.asarray(0.95 * mask, dtype=np.float32))


def _draw_outline(
    sheet: _DefectLayer, rng: np.random.Generator, width: float, height: float, corners: int, rough: float
) -> Float32Array:
    outline = _stretch(np.array(sample_blob(rng, corners, rough)), width, height)
    fine = sheet.blank()
    cv2.fillPoly(fine, [sheet.fine(outline[:, 0], outline[:, 1])], 255, cv2.LINE_AA, 8)
    return sheet.mask(fine)


def _draw_spalling(
    canvas: TextureCanvas, defect: DemoDefect, rng: np.random.Generator, width: float, height: float
) -> None:
    """Render fallen off: brick and crumbling mortar in an irregular hole with a lit and a shaded rim."""
    sheet = _DefectLayer(canvas, defect, width, height)
    mask = _draw_outline(sheet, rng, width, height, 22, 0.45)
    r, c = np.mgrid[0 : sheet.rows, 0 : sheet.columns].astype(np.float32)
    high, long = 0.075 * canvas.per_v, 0.25 * canvas.per_u
    course = (r / high).astype(int)
    shifted = c / long + 0.5 * (course % 2)
    shape = (course.max() + 1, int(shifted.max()) + 1)
    tones = rng.normal(scale=14, size=(*shape, 1)) + rng.normal(scale=(6, 4, 3), size=(*shape, 3))
    inside = (np.array(BRICK) * 0.8 + tones[course, shifted.astype(int)]).astype(np.float32)
    inside[((r / high) % 1 * high < 3) | (shifted % 1 * long < 3)] = (128, 116, 102)
    grain = rng.normal(scale=17, size=(sheet.rows, sheet.columns)).astype(np.float32)
    inside += cv2.GaussianBlur(grain, (0, 0), sigmaX=1.2)[..., None] * 1.6
    canvas.blend(sheet.region, np.asarray(inside, dtype=np.float32), mask)
    soft = cv2.GaussianBlur(mask, (0, 0), sigmaX=1.5)
    slope = np.roll(soft, 2, axis=0) - np.roll(soft, -2, axis=0)
    canvas.add(np.asarray(np.clip(slope, -0.8, 0.8) * 75 * mask, dtype=np.float32), sheet.region)


def _draw_moisture(
    canvas: TextureCanvas, defect: DemoDefect, rng: np.random.Generator, width: float, height: float
) -> None:
    """A soft dark stain, greenish, mottled, with a salt rim."""
    sheet = _DefectLayer(canvas, defect, width, height)
    mask = _draw_outline(sheet, rng, width, height, 16, 0.3)
    edge = max(1.5, 0.10 * min(width, height) * canvas.per_u)
    inner = cv2.erode(mask, np.ones((3, 3)), iterations=int(edge / 2))
    soft = np.asarray(cv2.GaussianBlur(inner, (0, 0), sigmaX=edge / 2), dtype=np.float32)
    rim = np.clip(soft * (1 - soft) * 4, 0, 1) * mask
    mottled = 0.72 + 0.16 * np.tanh(sample_noise(rng, sheet.rows, sheet.columns, 0.06 * canvas.per_u))
    canvas.blend(sheet.region, (78, 76, 56), np.asarray(soft * mottled, dtype=np.float32))
    canvas.blend(sheet.region, (225, 220, 205), np.asarray(0.16 * rim, dtype=np.float32))


def sample_noise(rng: np.random.Generator, rows: int, columns: int, step_px: float) -> Float32Array:
    """Smooth unit noise of a size, independent of the canvas' own random numbers."""
    coarse = rng.standard_normal((int(rows / step_px) + 3, int(columns / step_px) + 3), dtype=np.float32)
    return np.asarray(cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_CUBIC), dtype=np.float32)


def _draw_repair(
    canvas: TextureCanvas, defect: DemoDefect, rng: np.random.Generator, width: float, height: float
) -> None:
    """Fresh render: an even, paler field with trowel edges."""
    sheet = _DefectLayer(canvas, defect, width, height)
    mask = _draw_outline(sheet, rng, width, height, 12, 0.12)
    tone = 4 * sample_noise(rng, sheet.rows, sheet.columns, 0.03 * canvas.per_u)
    fresh = np.array((224, 214, 190), dtype=np.float32) + tone[..., None]
    canvas.blend(sheet.region, np.asarray(fresh, dtype=np.float32), np.asarray(0.93 * mask, dtype=np.float32))


def draw_target(canvas: TextureCanvas, point: DemoControlPoint) -> None:
    """A survey target: a white disc with two black quadrants, the point where they meet."""
    half = TARGET_M / 2
    u, v = point.u_m, point.v_m
    sheet = _DefectLayer(
        canvas,
        DemoDefect(
            id=point.id,
            kind="crack",
            surface=point.surface,
            u_m=u,
            v_m=v,
            width_m=TARGET_M,
            height_m=TARGET_M,
            states=[],
        ),
        TARGET_M,
        TARGET_M,
    )
    angle = np.linspace(0, 2 * np.pi, 49)
    disc, black = sheet.blank(), sheet.blank()
    cv2.fillPoly(disc, [sheet.fine(half * np.cos(angle), half * np.sin(angle))], 255, cv2.LINE_AA, 8)
    for start in (0, np.pi):
        arc = start + np.linspace(0, np.pi / 2, 13)
        pie = np.vstack([[0, 0], 0.88 * half * np.column_stack([np.cos(arc), np.sin(arc)])])
        cv2.fillPoly(black, [sheet.fine(pie[:, 0], pie[:, 1])], 255, cv2.LINE_AA, 8)
    canvas.blend(sheet.region, (240, 240, 236), sheet.mask(disc))
    canvas.blend(sheet.region, (18, 18, 18), sheet.mask(black))
