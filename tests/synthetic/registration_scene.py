"""Walls, cameras and defects of known truth for registration; projections and surfaces are this module's own.

A wall is flat, a cylinder (in facets of 1 degree) or set back by 2 m above 4.5 m. A place on it is (u, v, off): metres
to the right as seen from outside, metres up, metres before the model's surface. Cameras are Brown's, distorted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pyarrow as pa

from facadelake.building.model import BuildingModel
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import table_from_rows

Array = np.ndarray
FOCAL, WIDTH, HEIGHT = 3000.0, 4000, 3000
K1, K2, P1, P2 = -0.10, 0.03, 4e-4, -3e-4
LEDGE_M, BACK_M, RADIUS_M = 4.5, 2.0, 8.0
FAR_M = 25.0  # nothing is found further away, where another wall may occlude it
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, kw_only=True)
class Wall:
    """One wall 20 m wide (the cylinder: 100 degrees) and 9 m high that faces ``bearing_deg``, clockwise from north."""

    kind: str = "flat"
    foot: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bearing_deg: float = 180.0

    @property
    def out(self) -> Array:
        turn = math.radians(self.bearing_deg)
        return np.array([math.sin(turn), math.cos(turn), 0.0])

    @property
    def right(self) -> Array:
        """To the right of someone outside who style at the wall."""
        return np.cross(UP, self.out)

    def outward(self, u: Array) -> Array:
        """Outward normals (n, 3) of the wall's faces at u (n,)."""
        if self.kind != "cylinder":
            return np.tile(self.out, (len(u), 1))
        angle = np.asarray(u)[:, None] / RADIUS_M
        return np.cos(angle) * self.out + np.sin(angle) * self.right

    def points(self, uvo: Array) -> Array:
        """Site points (n, 3) of places (n, 3)."""
        u, v, off = np.asarray(uvo, dtype=float).reshape(-1, 3).T
        out = self.outward(u)
        flat = np.array(self.foot) + v[:, None] * UP + off[:, None] * out
        if self.kind == "cylinder":
            return flat + RADIUS_M * (out - self.out)
        back = np.where((self.kind == "setback") & (v > LEDGE_M), BACK_M, 0.0)
        return flat + u[:, None] * self.right - back[:, None] * self.out

    def faces(self) -> list[Array]:
        """Quadrangles (4, 3) of each of the model's elements, counter-clockwise as seen from outside."""
        if self.kind == "cylinder":
            edges = np.radians(np.arange(-50, 51)) * RADIUS_M
            return [self.points([(a, 0, 0), (b, 0, 0), (b, 9, 0), (a, 9, 0)]) for a, b in pairwise(edges)]
        if self.kind == "flat":
            return [self.points([(-10, 0, 0), (10, 0, 0), (10, 9, 0), (-10, 9, 0)])]
        low = self.points([(-10, 0, 0), (10, 0, 0), (10, LEDGE_M, 0), (-10, LEDGE_M, 0)])
        high = self.points([(-10, LEDGE_M + 1e-9, 0), (10, LEDGE_M + 1e-9, 0), (10, 9, 0), (-10, 9, 0)])
        return [low, np.array([low[3], low[2], high[1], high[0]]), high]

    def element_of(self, v: float) -> str:
        """The element that a place is on."""
        return "high" if self.kind == "setback" and v > LEDGE_M else "wall"


@dataclass(frozen=True, kw_only=True)
class Defect:
    """A rectangle on a wall; ``off_m`` is distance of the real surface in front of the model there."""

    name: str
    wall: int
    u: float
    v: float
    width_m: float = 0.2
    height_m: float = 0.2
    kind: str = "crack"
    off_m: float = 0.0

    def outline(self, wall: Wall) -> Array:
        """Places (n, 3) along the border."""
        side = np.linspace(-0.5, 0.5, 17)
        low, high = np.full(17, -0.5), np.full(17, 0.5)
        u = np.r_[side, high, -side, low] * self.width_m + self.u
        v = np.r_[low, side, high, -side] * self.height_m + self.v
        return np.column_stack([u, v, np.full(len(u), self.off_m)])

    def xyz(self, walls: Sequence[Wall]) -> Array:
        """The true centre in site."""
        return walls[self.wall].points([(self.u, self.v, self.off_m)])[0]


@dataclass(frozen=True, kw_only=True)
class Shot:
    """A photograph's true pose: ``axes`` (3, 3) has the camera's x, y and z in site as columns."""

    name: str
    centre: Array
    axes: Array

    def pixels(self, xyz: Array) -> Array:
        """Pixels of site points (n, 3), by Brown's model; NaN behind the camera."""
        x, y, z = ((xyz - self.centre) @ self.axes).T
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = np.where(z > 0.1, x / z, np.nan), np.where(z > 0.1, y / z, np.nan)
        r2 = x**2 + y**2
        swell = 1 + r2 * (K1 + r2 * K2)
        px = x * swell + 2 * P1 * x * y + P2 * (r2 + 2 * x**2)
        py = y * swell + P1 * (r2 + 2 * y**2) + 2 * P2 * x * y
        return np.column_stack([FOCAL * px + WIDTH / 2 + 12.0, FOCAL * py + HEIGHT / 2 - 9.0])

    def stated(self, moved: Array | None = None, turned: Array | None = None) -> PosedCamera:
        """The pose given to the product: moved by (3,) m in site, turned by (3,) rad about the camera's axes."""
        x, y, z = np.zeros(3) if turned is None else turned
        angle = float(np.linalg.norm([x, y, z])) or 1.0
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        turn = np.eye(3) + np.sin(angle) / angle * cross + (1 - np.cos(angle)) / angle**2 * cross @ cross
        camera = Camera(
            width_px=WIDTH, height_px=HEIGHT, fx_px=FOCAL, fy_px=FOCAL, cx_px=WIDTH / 2 + 12.0,
            cy_px=HEIGHT / 2 - 9.0, k1=K1, k2=K2, p1=P1, p2=P2,
        )  # fmt: skip
        centre = self.centre + (np.zeros(3) if moved is None else moved)
        return PosedCamera(camera=camera, site_from_cam=Similarity(rotation=self.axes @ turn, translation=centre))


def aim_shot(name: str, eye: Array, at: Array) -> Shot:
    """An upright photograph from ``eye`` of ``at``."""
    z = (at - eye) / np.linalg.norm(at - eye)
    x = np.cross(z, UP)
    x /= np.linalg.norm(x)
    return Shot(name=name, centre=np.asarray(eye, dtype=float), axes=np.column_stack([x, np.cross(z, x), z]))


def fan(
    wall: Wall, name: str, oblique_deg: Sequence[float], *, u: float = 0.0, v: float = 4.0, far_m: float = 9.0
) -> list[Shot]:
    """Photographs of (u, v) from ``far_m``, at ``oblique_deg`` to the right of the normal there."""
    at = wall.points([(u, v, 0.0)])[0]
    out = wall.outward(np.array([u]))[0]
    shots = []
    for k, angle in enumerate(np.radians(oblique_deg)):
        away = np.cos(angle) * out + np.sin(angle) * np.cross(UP, out)
        shots.append(aim_shot(f"{name}-{k}.jpg", at + far_m * away + (0.4 * (k % 3) - 0.4) * UP, at))
    return shots


@dataclass(frozen=True, kw_only=True)
class DrawnDetections:
    """Table ``detections`` and, by detection_id, the true defect."""

    table: pa.Table
    truth: Mapping[str, Defect]


@dataclass(frozen=True, kw_only=True)
class DetectionStyle:
    """How detections are drawn: ``jitter`` (one sigma of a box's centre, as a share of its size, beside half a pixel),
    as masks instead of boxes, by which incidence at most, and with which class by defect and photograph."""

    jitter: float = 0.0
    pixel_px: float = 0.0
    masks: bool = False
    incidence_max_deg: float = 75.0
    renamed: Mapping[tuple[str, str], str] = field(default_factory=dict)


def draw_detections(
    walls: Sequence[Wall],
    shots: Sequence[Shot],
    defects: Sequence[Defect],
    style: DetectionStyle,
    rng: np.random.Generator,
) -> DrawnDetections:
    """A detection of each defect in each photograph that sees it whole, in front, and not too flat."""
    rows, truth = [], {}
    for shot in shots:
        for defect in defects:
            wall = walls[defect.wall]
            border = wall.points(defect.outline(wall))
            to_camera = shot.centre - border
            cosine = np.einsum("ij,ij->i", to_camera, wall.outward(defect.outline(wall)[:, 0]))
            far_m = np.linalg.norm(to_camera, axis=1)
            cosine /= far_m
            xy = shot.pixels(border)
            inside = (xy >= 2) & (xy <= [WIDTH - 2, HEIGHT - 2])
            if not inside.all() or far_m.max() > FAR_M or cosine.min() < np.cos(np.radians(style.incidence_max_deg)):
                continue
            low, size = xy.min(axis=0), np.ptp(xy, axis=0)
            moved = rng.normal(size=2) * np.hypot(style.pixel_px, style.jitter * size)
            name = f"{shot.name}#{defect.name}"
            truth[name] = defect
            ring = ", ".join(f"{x:.4f} {y:.4f}" for x, y in [*(xy + moved), xy[0] + moved])
            kind = style.renamed.get((defect.name, shot.name), defect.kind)
            x, y = low + moved
            rows.append(
                {"detection_id": name, "photo_id": shot.name, "detection_outcome": "accepted", "defect_class": kind,
                 "source_class": kind, "score": 0.9, "box_x_px": x, "box_y_px": y, "box_width_px": size[0],
                 "box_height_px": size[1], "mask": f"POLYGON (({ring}))" if style.masks else None,
                 "detector": "coco:scene", "detector_sha256": "0"}
            )  # fmt: skip
    return DrawnDetections(table=table_from_rows("detections", rows), truth=truth)


def build_walls(walls: Sequence[Wall]) -> BuildingModel:
    """The walls' faces as the product's building; elements are named ``<wall's number>-<part>``."""
    vertices, triangles, owner, rows = [], [], [], []
    for number, wall in enumerate(walls):
        parts = ["wall", "ledge", "high"] if wall.kind == "setback" else ["wall"]
        first = len(rows)
        rows += [
            {"element_guid": f"{number}-{part}", "ifc_class": "IfcSlab" if part == "ledge" else "IfcWall",
             "element_name": part, "storey": "upper" if part == "high" else "lower", "is_external": True,
             "facade": "S", "surface_area_m2": 90.0, "triangles": 2}
            for part in parts
        ]  # fmt: skip
        for place, face in enumerate(wall.faces()):
            start = 4 * len(vertices)
            vertices.append(face)
            triangles += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
            owner += [first + (place if wall.kind == "setback" else 0)] * 2
    return BuildingModel(
        origin=SiteOrigin(lon_deg=11.57, lat_deg=48.14, height_ellipsoidal_m=560.0), map_crs="EPSG:25832",
        vertical_datum="ellipsoidal", georeference_level="50", remarks="", vertices_site_m=np.vstack(vertices),
        triangles=np.array(triangles), element_of_triangle=np.array(owner), elements=table_from_rows("elements", rows),
    )  # fmt: skip


def shift_defects(defects: Sequence[Defect], sigma_m: float, rng: np.random.Generator) -> list[Defect]:
    """The defects at random distances (``sigma_m``) from the model."""
    return [replace(defect, off_m=float(sigma_m * rng.normal())) for defect in defects]
