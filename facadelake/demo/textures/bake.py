"""Textures of charts and colours of other triangles, with the light of a day."""

from __future__ import annotations

import cv2
import numpy as np

from facadelake.core.arrays import Float32Array, Float64Array, UInt8Array
from facadelake.demo.building.charts import Chart
from facadelake.demo.building.solids import Solid, subdivide
from facadelake.demo.recipe import BoxVolume, CampaignRecipe, Daylight
from facadelake.demo.textures.canvas import TextureCanvas
from facadelake.demo.textures.defects import draw_defect, draw_target
from facadelake.demo.textures.facades import paint_facade
from facadelake.demo.textures.lighting import RayScene, compute_direct_light, compute_sky_openness, shade
from facadelake.demo.textures.render_parts import DETAIL, RenderPart, compute_face_normals
from facadelake.demo.textures.surroundings import paint_box_side, paint_ground, paint_roof
from facadelake.demo.world import DemoWorld, seed_generator

TILE_M = 4.0
LIGHT_GRID_M = 0.012
TINT = {
    "IfcWall": (203, 186, 152),
    "IfcSlab": (188, 186, 180),
    "IfcRailing": (96, 100, 104),
    "IfcMember": (182, 158, 132),
}
SURROUNDINGS_TINT = {
    "trunk": (84, 66, 48),
    "house roof": (128, 66, 50),
    "workshop roof": (92, 90, 92),
    "branches": (92, 78, 64),
    "scaffold frame": (146, 150, 152),
    "scaffold deck": (158, 132, 92),
}


def _paint_chart(
    world: DemoWorld, campaign: CampaignRecipe, chart: Chart, boxes: dict[str, BoxVolume]
) -> TextureCanvas:
    """The texture of a chart without defects, control points and light."""
    recipe, rng = world.recipe, seed_generator(world.recipe, chart.name)
    b = recipe.building
    if chart.name == "ground":
        return paint_ground(chart, (0.0, 0.0, b.length_m, b.depth_m), campaign.season.lawn, rng)
    if chart.name == "roof":
        return paint_roof(chart, rng)
    owner = next((box for name, box in boxes.items() if chart.name.startswith(f"{name} ")), None)
    return paint_box_side(chart, owner.look, rng) if owner else paint_facade(chart, b, rng)


def bake_chart(
    world: DemoWorld, rays: RayScene, campaign: CampaignRecipe, index: int, chart: Chart, boxes: dict[str, BoxVolume]
) -> UInt8Array:
    """The texture of a chart with defects and control points, under the light of the day.

    Args:
        world: the recipe and its surfaces.
        rays: the scene of the campaign, for shadows.
        campaign: its light.
        index: number of the campaign, which selects the states of defects.
        chart: the chart to paint.
        boxes: neighbours and obstacles by name, which own the charts named after them.
    """
    recipe = world.recipe
    canvas = _paint_chart(world, campaign, chart, boxes)
    for defect in (*recipe.defects, *recipe.off_target_defects):
        if defect.surface == chart.name:
            draw_defect(canvas, defect.describe_day(index))
    for point in recipe.control_points:
        if point.surface == chart.name:
            draw_target(canvas, point)
    rows, columns = canvas.image.shape[:2]
    multiplier = compute_chart_light(world, rays, campaign.light, chart)
    canvas.image *= cv2.resize(multiplier, (columns, rows), interpolation=cv2.INTER_LINEAR)
    return canvas.encode_uint8()


def compute_chart_light(world: DemoWorld, rays: RayScene, light: Daylight, chart: Chart) -> Float32Array:
    """Light multiplier (rows, columns, 3) of a chart, first row at the top, on a coarser grid than its texture.

    Args:
        world: the recipe and its surfaces.
        rays: the scene of the campaign.
        light: sun and sky of the day.
        chart: the chart.
    """
    step = max(LIGHT_GRID_M, 5 * chart.texel_m if chart.name in ("ground", "roof") else 3 * chart.texel_m)
    rows, columns = int(np.ceil(chart.size_m[1] / step)), int(np.ceil(chart.size_m[0] / step))
    u_centres = (np.arange(columns) + 0.5) * chart.size_m[0] / columns
    v_centres = (rows - 0.5 - np.arange(rows)) * chart.size_m[1] / rows
    u, v = np.tile(u_centres, rows), np.repeat(v_centres, columns)
    offset_m = 4.0 if chart.name == "roof" else 0.1
    normals = world.rotate_to_site(chart.compute_normals(u))
    start = world.transform_to_site(chart.compute_points(u, v, offset_m))
    depth, _ = rays.cast(start, -normals)
    depth = np.where(depth < offset_m + 0.35, depth, offset_m)
    points = start - depth[:, None] * normals
    sun = compute_direct_light(rays, points, normals, light, 3, seed_generator(world.recipe, f"sun {chart.name}"))
    sky = _compute_sky_openness(rays, points.reshape(rows, columns, 3), normals.reshape(rows, columns, 3))
    return np.asarray(shade(sun.reshape(rows, columns), sky, light), dtype=np.float32)


def _compute_sky_openness(rays: RayScene, points: Float64Array, normals: Float64Array) -> Float64Array:
    """Sky openness (rows, columns), computed at every fifth point because it changes slowly."""
    coarse = (slice(None, None, 5), slice(None, None, 5))
    shape = points[coarse].shape[:2]
    values = compute_sky_openness(rays, points[coarse].reshape(-1, 3), normals[coarse].reshape(-1, 3)).reshape(shape)
    return np.asarray(cv2.resize(values, points.shape[1::-1], interpolation=cv2.INTER_LINEAR))


def make_lit_part(
    world: DemoWorld, rays: RayScene, campaign: CampaignRecipe, solid: Solid, triangles: Float64Array
) -> RenderPart:
    """Triangles outside the charts, each with one colour of its material and the light at its centre.

    Args:
        world: the recipe and its surfaces.
        rays: the scene of the campaign.
        campaign: its light, and the season, which colours the trees.
        solid: the solid that the triangles belong to.
        triangles: its triangles (n, 3, 3) outside the charts, in the model's frame.
    """
    subdivided = triangles if solid.name in ("crown", "branches") else subdivide(triangles, 0.4)
    site = world.transform_to_site(subdivided)
    normals, centres = compute_face_normals(site), site.mean(axis=1)
    rng = seed_generator(world.recipe, f"lit {solid.name}")
    tint = np.array(TINT.get(solid.kind) or SURROUNDINGS_TINT.get(solid.name, (224, 220, 210)), dtype=np.float64) / 225
    colours = np.broadcast_to(tint, (len(subdivided), 3)).copy()
    if solid.name == "crown" and campaign.season.leaves:
        normals = np.where((normals @ [0.0, 0.0, 1.0])[:, None] < 0, -normals, normals)
        colours = np.array(campaign.season.leaves) * rng.uniform(0.7, 1.35, (len(subdivided), 1)) + rng.normal(
            scale=0.02, size=(len(subdivided), 3)
        )
    multiplier = shade(
        compute_direct_light(rays, centres, normals, campaign.light, 3, rng),
        compute_sky_openness(rays, centres, normals, 16),
        campaign.light,
    )
    dominant = np.abs(normals).argmax(axis=1)
    axes = np.array([[1, 2], [0, 2], [0, 1]])[dominant]
    uv = np.take_along_axis(subdivided, np.repeat(axes[:, None, :], 3, axis=1), axis=2) / TILE_M
    return RenderPart(texture=DETAIL, triangles=site, uv=uv, colours=np.clip(colours * multiplier, 0, 1))
