"""A campaign's scene: what stands there (triangles in site), what is drawn on it, and how the day's light falls."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from facadelake.demo.canvas import Canvas
from facadelake.demo.charts import Chart, box_charts, building_charts, flat_chart
from facadelake.demo.defects import draw_defect, draw_target
from facadelake.demo.facade_textures import paint_facade
from facadelake.demo.light import RayScene, shade, sky_open, sunlit
from facadelake.demo.mesh import Solid, box_solid, ground_solid, roof_solid, subdivided, tree_solids
from facadelake.demo.recipe import Box, Campaign, DefectState, DemoRecipe, Light
from facadelake.demo.surroundings import has_roof, paint_box, paint_concrete, paint_ground, paint_roof, paint_sky
from facadelake.frames import Array

DETAIL = "detail"
TILE_M, TILE_PX = 4.0, 1024
GROUND_HALF_M, FAR_M = 42.0, 170.0
LIGHT_GRID_M = 0.012
# A triangle belongs to a facade's drawing if it lies this near to its surface: panes behind, bands and sills in front.
BEHIND_M, BEFORE_M = -0.30, 0.09
TINT = {
    "IfcWall": (203, 186, 152),
    "IfcSlab": (188, 186, 180),
    "IfcRailing": (96, 100, 104),
    "IfcMember": (182, 158, 132),
}
FOREIGN_TINT = {"trunk": (84, 66, 48), "house roof": (128, 66, 50), "workshop roof": (92, 90, 92)}


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderPart:
    """Triangles (n, 3, 3) in site metres, texture coordinates (n, 3, 2), colours (n, 3) of 0 to 1."""

    texture: str
    triangles: Array
    uv: Array
    colours: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Everything a renderer needs, and the same triangles for questions of what is seen."""

    parts: list[RenderPart]
    textures: dict[str, NDArray[np.uint8]]
    rays: RayScene
    solids: list[Solid]


@dataclass(frozen=True, kw_only=True, eq=False)
class World:
    """What does not change from campaign to campaign: the model's solids, the charts, the frames."""

    recipe: DemoRecipe
    site_from_ifc: Array
    ifc: list[Solid]
    charts: dict[str, Chart] = field(repr=False)

    def to_site(self, xyz_ifc: Array) -> Array:
        """Model points (..., 3) in site metres."""
        return np.asarray(xyz_ifc @ self.site_from_ifc[:3, :3].T + self.site_from_ifc[:3, 3])

    def turn(self, directions_ifc: Array) -> Array:
        """Model directions (n, 3) as unit vectors in site."""
        out = directions_ifc @ self.site_from_ifc[:3, :3].T
        return np.asarray(out / np.linalg.norm(out, axis=-1, keepdims=True))


def make_world(recipe: DemoRecipe, site_from_ifc: Array, ifc: list[Solid]) -> World:
    """The world of a recipe around the solids of its written model."""
    b = recipe.building
    charts = building_charts(b, recipe.texel_m)
    for box in (*recipe.neighbours, *(o for c in recipe.campaigns for o in c.obstacles)):
        charts += box_charts(box, 3 * recipe.texel_m)
    mid = (b.length_m / 2, b.depth_m / 2)
    low = (mid[0] - GROUND_HALF_M, mid[1] - GROUND_HALF_M, -0.02)
    charts.append(flat_chart("ground", low, (2 * GROUND_HALF_M, 2 * GROUND_HALF_M), 6 * recipe.texel_m))
    charts.append(flat_chart("roof", (-0.5, -0.5, b.shoulder_m), (b.length_m + 1, b.depth_m + 1), 3 * recipe.texel_m))
    return World(recipe=recipe, site_from_ifc=site_from_ifc, ifc=ifc, charts={c.name: c for c in charts})


def _rng(recipe: DemoRecipe, name: str) -> np.random.Generator:
    return np.random.default_rng([recipe.seed, zlib.crc32(name.encode())])


def foreign_solids(world: World, campaign: Campaign) -> list[Solid]:
    """What stands around and is not in the model, on the day of a campaign."""
    recipe = world.recipe
    boxes = [*recipe.neighbours, *campaign.obstacles]
    solids = [box_solid(box) for box in boxes] + [roof_solid(box) for box in boxes if has_roof(box)]
    for i, tree in enumerate(recipe.trees):
        solids += tree_solids(tree, _rng(recipe, f"tree {i}"))
    b = recipe.building
    return [*solids, ground_solid(GROUND_HALF_M, (b.length_m / 2, b.depth_m / 2), -0.02)]


def build_scene(world: World, campaign: Campaign, index: int) -> Scene:
    """The scene of campaign number ``index``: its defects drawn, its light baked."""
    solids = [*world.ifc, *foreign_solids(world, campaign)]
    rays = RayScene([world.to_site(s.triangles) for s in solids])
    boxes = {box.name: box for box in (*world.recipe.neighbours, *campaign.obstacles)}
    parts, loose = _split(world, solids, boxes)
    textures = {
        name: _bake(world, rays, campaign, index, world.charts[name], boxes)
        for name in sorted({p.texture for p in parts})
    }
    parts += [_lit(world, rays, campaign.light, solid, triangles) for solid, triangles in loose if len(triangles)]
    textures[DETAIL] = paint_concrete(TILE_PX, _rng(world.recipe, DETAIL))
    textures["sky"] = paint_sky(_rng(world.recipe, f"sky {campaign.id}"))
    parts += [_dome(), _far_ground(campaign.light)]
    return Scene(parts=parts, textures=textures, rays=rays, solids=solids)


def _split(
    world: World, solids: Sequence[Solid], boxes: dict[str, Box]
) -> tuple[list[RenderPart], list[tuple[Solid, Array]]]:
    """Triangles that lie on a chart, as parts of that chart; and the rest, solid by solid."""
    facades = [c.name for c in building_charts(world.recipe.building, 1.0)]
    collected: dict[str, list[Array]] = {}
    loose: list[tuple[Solid, Array]] = []
    for solid in solids:
        if solid.guid:
            names = ([] if solid.kind in ("IfcRailing",) else facades) + ["roof"]
        else:
            names = (
                ["ground"]
                if solid.name == "ground"
                else [f"{solid.name} {s}" for s in ("south", "east", "north", "west") if solid.name in boxes]
            )
        rest = solid.triangles
        for name in names:
            mine = _on_chart(world.charts[name], rest)
            if mine.any():
                collected.setdefault(name, []).append(rest[mine])
                rest = rest[~mine]
        loose.append((solid, rest))
    parts = []
    for name, groups in collected.items():
        triangles = np.concatenate(groups)
        chart = world.charts[name]
        uv = chart.locate(triangles.reshape(-1, 3))[0] / chart.size_m
        parts.append(
            RenderPart(
                texture=name,
                triangles=world.to_site(triangles),
                uv=np.clip(uv, 0.0, 1.0).reshape(-1, 3, 2),
                colours=np.ones((len(triangles), 3)),
            )
        )
    return parts, loose


def _normals(triangles: Array) -> Array:
    n = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return np.asarray(n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-15))


def _on_chart(chart: Chart, triangles: Array) -> NDArray[np.bool_]:
    """Which triangles (n,) are drawn by a chart: near its surface, facing as it faces, inside its bounds."""
    if len(triangles) == 0:
        return np.zeros(0, dtype=bool)
    uv, distance = chart.locate(triangles.reshape(-1, 3))
    uv, distance = uv.reshape(-1, 3, 2), distance.reshape(-1, 3)
    centre = uv.mean(axis=1)
    facing = np.einsum("ij,ij->i", _normals(triangles), chart.normals(centre[:, 0])) > 0.95
    slack = 0.12
    inside = ((uv > -slack) & (uv < np.array(chart.size_m) + slack)).all(axis=(1, 2))
    near = (distance > BEHIND_M) & (distance < (4.0 if chart.name == "roof" else BEFORE_M))
    return np.asarray(facing & inside & near.all(axis=1))


def _paint(world: World, campaign: Campaign, chart: Chart, boxes: dict[str, Box]) -> Canvas:
    recipe, rng = world.recipe, _rng(world.recipe, chart.name)
    b = recipe.building
    if chart.name == "ground":
        return paint_ground(chart, (0.0, 0.0, b.length_m, b.depth_m), rng)
    if chart.name == "roof":
        return paint_roof(chart, rng)
    owner = next((box for name, box in boxes.items() if chart.name.startswith(f"{name} ")), None)
    return paint_box(chart, owner.look, rng) if owner else paint_facade(chart, b, rng)


def state_of(defect_states: Sequence[DefectState], index: int) -> DefectState:
    """A defect's state on the day of campaign number ``index``."""
    return defect_states[index]


def _bake(
    world: World, rays: RayScene, campaign: Campaign, index: int, chart: Chart, boxes: dict[str, Box]
) -> NDArray[np.uint8]:
    """A chart's texture with defects and targets drawn and the light of the day on it."""
    recipe = world.recipe
    canvas = _paint(world, campaign, chart, boxes)
    for defect in (*recipe.defects, *recipe.off_target_defects):
        if defect.surface == chart.name:
            draw_defect(canvas, defect, state_of(defect.states, index))
    for point in recipe.control_points:
        if point.surface == chart.name:
            draw_target(canvas, point)
    rows, columns = canvas.image.shape[:2]
    multiplier = chart_light(world, rays, campaign.light, chart)
    canvas.image *= cv2.resize(multiplier, (columns, rows), interpolation=cv2.INTER_LINEAR)
    return canvas.result()


def chart_light(world: World, rays: RayScene, light: Light, chart: Chart) -> NDArray[np.float32]:
    """Light multiplier (rows, columns, 3) over a chart, first row at the top, on a coarser grid than its texture."""
    step = max(LIGHT_GRID_M, 5 * chart.texel_m if chart.name in ("ground", "roof") else 3 * chart.texel_m)
    rows, columns = int(np.ceil(chart.size_m[1] / step)), int(np.ceil(chart.size_m[0] / step))
    along = (np.arange(columns) + 0.5) * chart.size_m[0] / columns
    up = (rows - 0.5 - np.arange(rows)) * chart.size_m[1] / rows
    u, v = np.tile(along, rows), np.repeat(up, columns)
    before = 4.0 if chart.name == "roof" else 0.1
    normals = world.turn(chart.normals(u))
    start = world.to_site(chart.points(u, v, before))
    depth, _, _ = rays.hits(start, -normals)
    depth = np.where(depth < before + 0.35, depth, before)
    points = start - depth[:, None] * normals
    sun = sunlit(rays, points, normals, light, 3, _rng(world.recipe, f"sun {chart.name}"))
    sky = _sky_coarse(rays, points.reshape(rows, columns, 3), normals.reshape(rows, columns, 3))
    return np.asarray(shade(sun.reshape(rows, columns), sky, light), dtype=np.float32)


def _sky_coarse(rays: RayScene, points: Array, normals: Array) -> Array:
    """Sky openness (rows, columns), asked at every fifth point, for it changes slowly."""
    some = (slice(None, None, 5), slice(None, None, 5))
    shape = points[some].shape[:2]
    values = sky_open(rays, points[some].reshape(-1, 3), normals[some].reshape(-1, 3)).reshape(shape)
    return np.asarray(cv2.resize(values, points.shape[1::-1], interpolation=cv2.INTER_LINEAR))


def _lit(world: World, rays: RayScene, light: Light, solid: Solid, triangles: Array) -> RenderPart:
    """Triangles off the charts: one colour each, of their material and the light at their centre."""
    small = triangles if solid.name == "crown" else subdivided(triangles, 0.4)
    site = world.to_site(small)
    normals, centres = _normals(site), site.mean(axis=1)
    rng = _rng(world.recipe, f"lit {solid.name}")
    tint = np.array(TINT.get(solid.kind) or FOREIGN_TINT.get(solid.name, (224, 220, 210)), dtype=np.float64) / 225
    colours = np.broadcast_to(tint, (len(small), 3)).copy()
    if solid.name == "crown":
        normals = np.where((normals @ [0.0, 0.0, 1.0])[:, None] < 0, -normals, normals)
        colours = np.array([0.30, 0.42, 0.16]) * rng.uniform(0.7, 1.35, (len(small), 1)) + rng.normal(
            scale=0.02, size=(len(small), 3)
        )
    multiplier = shade(sunlit(rays, centres, normals, light, 3, rng), sky_open(rays, centres, normals, 16), light)
    dominant = np.abs(normals).argmax(axis=1)
    axes = np.array([[1, 2], [0, 2], [0, 1]])[dominant]
    uv = np.take_along_axis(small, np.repeat(axes[:, None, :], 3, axis=1), axis=2) / TILE_M
    return RenderPart(texture=DETAIL, triangles=site, uv=uv, colours=np.clip(colours * multiplier, 0, 1))


def _dome() -> RenderPart:
    """The sky, far away, with its texture's rows from the zenith to a little below the horizon."""
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

    def cut(grid: Array) -> Array:
        p = [grid[q].reshape(-1, grid.shape[-1]) for q in quads]
        return np.concatenate([np.stack([p[0], p[1], p[2]], axis=1), np.stack([p[0], p[2], p[3]], axis=1)])

    triangles = cut(points)
    return RenderPart(texture="sky", triangles=triangles, uv=cut(uv), colours=np.ones((len(triangles), 3)))


def _far_ground(light: Light) -> RenderPart:
    """Plain green out to the dome, a little lower than the near ground."""
    half = 0.99 * FAR_M
    triangles = ground_solid(half, (0.0, 0.0), -0.15).triangles
    sun = np.array([np.sin(np.radians(light.sun_elevation_deg))])
    colour = np.array([92, 108, 66]) / 225 * shade(sun, np.ones(1), light)[0]
    return RenderPart(
        texture=DETAIL,
        triangles=triangles,
        uv=triangles[:, :, :2] / 40.0,
        colours=np.repeat(np.clip(colour, 0, 1)[None], len(triangles), axis=0),
    )
