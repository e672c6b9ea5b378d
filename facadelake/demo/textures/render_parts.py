"""Triangles grouped by the chart that textures them, with texture coordinates; and the distant background."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array, Float64Nx3
from facadelake.demo.building.charts import Chart, make_building_charts
from facadelake.demo.building.solids import Solid, make_ground_solid
from facadelake.demo.recipe import BoxVolume, CampaignRecipe
from facadelake.demo.textures.lighting import shade
from facadelake.demo.world import DemoWorld

# The texture of everything outside the charts.
DETAIL = "detail"
FAR_M = 170.0
# A triangle belongs to the chart of a facade within these distances: panes behind, bands and sills in front.
MIN_OFFSET_M, MAX_OFFSET_M = -0.30, 0.09


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderPart:
    """Triangles (n, 3, 3) in site, texture coordinates (n, 3, 2), and colours (n, 3), 0 to 1."""

    texture: str
    triangles: Float64Array
    uv: Float64Array
    colours: Float64Array


def split_by_chart(
    world: DemoWorld, solids: Sequence[Solid], boxes: dict[str, BoxVolume]
) -> tuple[list[RenderPart], list[tuple[Solid, Float64Array]]]:
    """The triangles on each chart as parts, and the remaining triangles of each solid."""
    facades = [c.name for c in make_building_charts(world.recipe.building, 1.0)]
    collected: dict[str, list[Float64Array]] = {}
    uncharted: list[tuple[Solid, Float64Array]] = []
    for solid in solids:
        if solid.guid:
            names = ([] if solid.kind in ("IfcRailing",) else facades) + ["roof"]
        else:
            names = (
                ["ground"]
                if solid.name == "ground"
                else [f"{solid.name} {s}" for s in ("south", "east", "north", "west") if solid.name in boxes]
            )
        remaining = solid.triangles
        for name in names:
            on_chart = find_on_chart(world.charts[name], remaining)
            if on_chart.any():
                collected.setdefault(name, []).append(remaining[on_chart])
                remaining = remaining[~on_chart]
        uncharted.append((solid, remaining))
    parts = []
    for name, groups in collected.items():
        triangles = np.concatenate(groups)
        chart = world.charts[name]
        uv = chart.locate(triangles.reshape(-1, 3))[0] / chart.size_m
        parts.append(
            RenderPart(
                texture=name,
                triangles=world.transform_to_site(triangles),
                uv=np.clip(uv, 0.0, 1.0).reshape(-1, 3, 2),
                colours=np.ones((len(triangles), 3)),
            )
        )
    return parts, uncharted


def compute_face_normals(triangles: Float64Array) -> Float64Nx3:
    """Unit normals (n, 3) of triangles (n, 3, 3)."""
    n = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return np.asarray(n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-15))


def find_on_chart(chart: Chart, triangles: Float64Array) -> BoolArray:
    """Triangles (n,) that a chart textures: near its surface, with its orientation, inside its bounds."""
    if len(triangles) == 0:
        return np.zeros(0, dtype=bool)
    uv, distance = chart.locate(triangles.reshape(-1, 3))
    uv, distance = uv.reshape(-1, 3, 2), distance.reshape(-1, 3)
    centre = uv.mean(axis=1)
    facing = np.einsum("ij,ij->i", compute_face_normals(triangles), chart.compute_normals(centre[:, 0])) > 0.95
    margin_m = 0.12
    inside = ((uv > -margin_m) & (uv < np.array(chart.size_m) + margin_m)).all(axis=(1, 2))
    near = (distance > MIN_OFFSET_M) & (distance < (4.0 if chart.name == "roof" else MAX_OFFSET_M))
    return np.asarray(facing & inside & near.all(axis=1))


def make_sky_dome() -> RenderPart:
    """The distant sky; the rows of its texture go from the zenith to slightly below the horizon."""
    columns, rows = 96, 40
    azimuth = np.linspace(0, 2 * np.pi, columns + 1)
    sine = np.linspace(-0.15, 1.0, rows + 1)
    a, s = np.meshgrid(azimuth, sine)
    radius = np.sqrt(np.clip(1 - s**2, 0, 1))
    points = FAR_M * np.stack([radius * np.sin(a), radius * np.cos(a), s], axis=-1)
    uv = np.stack([a / (2 * np.pi), (s + 0.15) / 1.15], axis=-1)
    quads = [
        (slice(None, -1), slice(None, -1)),
        (slice(None, -1), slice(1, None)),
        (slice(1, None), slice(1, None)),
        (slice(1, None), slice(None, -1)),
    ]

    def cut(grid: Float64Array) -> Float64Array:
        p = [grid[q].reshape(-1, grid.shape[-1]) for q in quads]
        return np.concatenate([np.stack([p[0], p[1], p[2]], axis=1), np.stack([p[0], p[2], p[3]], axis=1)])

    triangles = cut(points)
    return RenderPart(texture="sky", triangles=triangles, uv=cut(uv), colours=np.ones((len(triangles), 3)))


def make_far_ground(campaign: CampaignRecipe) -> RenderPart:
    """Plain ground, a little paler than the lawn, up to the dome, slightly lower than the near ground."""
    half = 0.99 * FAR_M
    triangles = make_ground_solid(half, (0.0, 0.0), -0.15).triangles
    sun = np.array([np.sin(np.radians(campaign.light.sun_elevation_deg))])
    colour = (np.array(campaign.season.lawn) + 4) / 225 * shade(sun, np.ones(1), campaign.light)[0]
    return RenderPart(
        texture=DETAIL,
        triangles=triangles,
        uv=triangles[:, :, :2] / 40.0,
        colours=np.repeat(np.clip(colour, 0, 1)[None], len(triangles), axis=0),
    )
