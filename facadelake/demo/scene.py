"""A campaign's scene: what stands there (triangles in site), what is drawn on it, and how the day's light falls."""

from __future__ import annotations

from dataclasses import dataclass

from facadelake.core.arrays import UInt8Array
from facadelake.demo.building.solids import Solid, box_solid, ground_solid, roof_solid, tree_solids
from facadelake.demo.recipe import Campaign
from facadelake.demo.textures.bake import bake_chart, lit_part
from facadelake.demo.textures.light import RayScene
from facadelake.demo.textures.parts import DETAIL, RenderPart, dome_part, far_ground_part, split_by_chart
from facadelake.demo.textures.surroundings import has_roof, paint_concrete, paint_sky
from facadelake.demo.world import GROUND_HALF_M, World, seeded

TILE_PX = 1024


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Everything a renderer needs, and the same triangles for questions of what is seen."""

    parts: list[RenderPart]
    textures: dict[str, UInt8Array]
    rays: RayScene
    solids: list[Solid]


def foreign_solids(world: World, campaign: Campaign) -> list[Solid]:
    """What stands around and is not in the model, on the day of a campaign."""
    recipe = world.recipe
    boxes = [*recipe.neighbours, *campaign.obstacles]
    solids = [box_solid(box) for box in boxes] + [roof_solid(box) for box in boxes if has_roof(box)]
    for i, tree in enumerate(recipe.trees):
        solids += tree_solids(tree, seeded(recipe, f"tree {i}"))
    b = recipe.building
    return [*solids, ground_solid(GROUND_HALF_M, (b.length_m / 2, b.depth_m / 2), -0.02)]


def build_scene(world: World, campaign: Campaign, index: int) -> Scene:
    """The scene of campaign number ``index``: its defects drawn, its light baked."""
    solids = [*world.ifc, *foreign_solids(world, campaign)]
    rays = RayScene([world.to_site(s.triangles) for s in solids])
    boxes = {box.name: box for box in (*world.recipe.neighbours, *campaign.obstacles)}
    parts, loose = split_by_chart(world, solids, boxes)
    textures = {
        name: bake_chart(world, rays, campaign, index, world.charts[name], boxes)
        for name in sorted({p.texture for p in parts})
    }
    parts += [lit_part(world, rays, campaign.light, solid, triangles) for solid, triangles in loose if len(triangles)]
    textures[DETAIL] = paint_concrete(TILE_PX, seeded(world.recipe, DETAIL))
    textures["sky"] = paint_sky(seeded(world.recipe, f"sky {campaign.id}"))
    parts += [dome_part(), far_ground_part(campaign.light)]
    return Scene(parts=parts, textures=textures, rays=rays, solids=solids)
