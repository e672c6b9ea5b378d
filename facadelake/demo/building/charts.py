"""Charts: textured surfaces with coordinates u (to the right, from outside) and v (upwards)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64N, Float64Nx2, Float64Nx3, Float64x3
from facadelake.demo.recipe import BoxVolume, DemoBuilding


@dataclass(frozen=True, kw_only=True, eq=False)
class Chart:
    """A plane, or with ``radius_m`` > 0 a cylinder about a vertical axis, of ``size_m`` (along u, along v).

    ``origin_m`` (model frame) is u = v = 0; for a cylinder it is the foot of the axis, and u is arc length from
    ``start_rad``.
    """

    name: str
    origin_m: Float64x3
    u_axis: Float64x3
    v_axis: Float64x3
    size_m: tuple[float, float]
    texel_m: float
    radius_m: float = 0.0
    start_rad: float = 0.0

    @property
    def shape_px(self) -> tuple[int, int]:
        """Rows and columns of the texture; columns are a multiple of 4 for OpenGL's row alignment."""
        return round(self.size_m[1] / self.texel_m / 4) * 4, round(self.size_m[0] / self.texel_m / 4) * 4

    def compute_texels_per_m(self) -> tuple[float, float]:
        """Texels per metre along u and v."""
        rows, columns = self.shape_px
        return columns / self.size_m[0], rows / self.size_m[1]

    def compute_normals(self, u_m: Float64N) -> Float64Nx3:
        """Outward unit normals (n, 3) at u (n,), in the model's frame."""
        if self.radius_m == 0:
            return np.broadcast_to(np.cross(self.u_axis, self.v_axis), (len(u_m), 3)).copy()
        angle = self.start_rad + np.asarray(u_m) / self.radius_m
        return np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])

    def compute_points(self, u_m: Float64N, v_m: Float64N, out_m: float = 0.0) -> Float64Nx3:
        """Points (n, 3) in the model's frame at u and v, ``out_m`` in front of the surface."""
        u, v, normals = np.asarray(u_m), np.asarray(v_m), self.compute_normals(np.asarray(u_m))
        if self.radius_m == 0:
            return self.origin_m + np.outer(u, self.u_axis) + np.outer(v, self.v_axis) + out_m * normals
        return self.origin_m + np.outer(v, self.v_axis) + (self.radius_m + out_m) * normals

    def compute_tangent(self, u_m: float) -> Float64x3:
        """Unit direction (3,) of increasing u, at u."""
        if self.radius_m == 0:
            return self.u_axis
        return np.cross(self.v_axis, self.compute_normals(np.array([u_m]))[0])

    def locate(self, xyz_m: Float64Nx3) -> tuple[Float64Nx2, Float64N]:
        """Position of points (n, 3), in the model's frame, on the chart.

        Returns (u, v) (n, 2) and the signed distance (n,) in front of the surface.
        """
        offset = np.asarray(xyz_m) - self.origin_m
        v = offset @ self.v_axis
        if self.radius_m == 0:
            return np.column_stack([offset @ self.u_axis, v]), offset @ np.cross(self.u_axis, self.v_axis)
        angle = np.arctan2(offset[:, 1], offset[:, 0]) - self.start_rad
        return np.column_stack([self.radius_m * angle, v]), np.hypot(offset[:, 0], offset[:, 1]) - self.radius_m


def _make_upright_chart(
    name: str, origin: tuple[float, float, float], normal: tuple[float, float], u: float, v: float, texel: float
) -> Chart:
    """A vertical plane with outward normal ``normal`` in plan, of size u by v."""
    return Chart(
        name=name,
        origin_m=np.array(origin),
        u_axis=np.array([-normal[1], normal[0], 0.0]),
        v_axis=np.array([0.0, 0.0, 1.0]),
        size_m=(u, v),
        texel_m=texel,
    )


def make_building_charts(b: DemoBuilding, texel_m: float) -> list[Chart]:
    """Charts of the facades: south, round corner, east, north, west, and south, east and west of the top storey."""
    low, top, s, r = b.shoulder_m + b.parapet_m, b.top_m, b.setback_m, b.corner_radius_m
    length, depth = b.length_m, b.depth_m
    rise = top - b.shoulder_m
    corner = Chart(
        name="corner",
        origin_m=np.array([length - r, r, 0.0]),
        u_axis=np.array([1.0, 0.0, 0.0]),
        v_axis=np.array([0.0, 0.0, 1.0]),
        size_m=(r * np.pi / 2, low),
        texel_m=texel_m,
        radius_m=r,
        start_rad=-np.pi / 2,
    )
    return [
        _make_upright_chart("south", (0, 0, 0), (0, -1), length - r, low, texel_m),
        corner,
        _make_upright_chart("east", (length, r, 0), (1, 0), depth - r, low, texel_m),
        _make_upright_chart("north", (length, depth, 0), (0, 1), length, top, texel_m),
        _make_upright_chart("west", (0, depth, 0), (-1, 0), depth, low, texel_m),
        _make_upright_chart("top south", (s, s, b.shoulder_m), (0, -1), length - 2 * s, rise, texel_m),
        _make_upright_chart("top east", (length - s, s, b.shoulder_m), (1, 0), depth - s, rise, texel_m),
        _make_upright_chart("top west", (s, depth, b.shoulder_m), (-1, 0), depth - s, rise, texel_m),
    ]


def make_box_charts(box: BoxVolume, texel_m: float) -> list[Chart]:
    """The four sides of a box outside the model, named ``<box> south`` and so on."""
    (x, y, z), (dx, dy, dz) = box.origin_m, box.size_m
    return [
        _make_upright_chart(f"{box.name} south", (x, y, z), (0, -1), dx, dz, texel_m),
        _make_upright_chart(f"{box.name} east", (x + dx, y, z), (1, 0), dy, dz, texel_m),
        _make_upright_chart(f"{box.name} north", (x + dx, y + dy, z), (0, 1), dx, dz, texel_m),
        _make_upright_chart(f"{box.name} west", (x, y + dy, z), (-1, 0), dy, dz, texel_m),
    ]


def make_flat_chart(name: str, low_m: tuple[float, float, float], size_m: tuple[float, float], texel_m: float) -> Chart:
    """A horizontal surface seen from above: u along x, v along y.

    Args:
        name: name of the chart.
        low_m: corner with the smallest x and y, model frame.
        size_m: size along x and y.
        texel_m: size of a texel.
    """
    return Chart(
        name=name,
        origin_m=np.array(low_m),
        u_axis=np.array([1.0, 0.0, 0.0]),
        v_axis=np.array([0.0, 1.0, 0.0]),
        size_m=size_m,
        texel_m=texel_m,
    )
