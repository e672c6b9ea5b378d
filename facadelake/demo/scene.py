"""The scene of a campaign: triangles in site, their textures with defects, and the light of the day."""

from __future__ import annotations

from dataclasses import dataclass

from facadelake.core.arrays import UInt8Array
from facadelake.core.parallel import map_blocks
from facadelake.demo.building.solids import (
    Solid,
    make_bare_tree_solids,
    make_box_solid,
    make_ground_solid,
    make_roof_solid,
    make_scaffold_solids,
    make_tree_solids,
)
from facadelake.demo.recipe import CampaignRecipe
from facadelake.demo.textures.bake import bake_chart, make_lit_part
from facadelake.demo.textures.lighting import RayScene
from facadelake.demo.textures.render_parts import DETAIL, RenderPart, make_far_ground, make_sky_dome, split_by_chart
from facadelake.demo.textures.surroundings import has_roof, paint_concrete, paint_sky
from facadelake.demo.world import GROUND_HALF_M, DemoWorld, seed_generator

DETAIL_TEXTURE_PX = 1024


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderScene:
    """What the renderer draws, and the same triangles for ray casting."""

    parts: list[RenderPart]
    textures: dict[str, UInt8Array]
    rays: RayScene


def make_surrounding_solids(world: DemoWorld, campaign: CampaignRecipe) -> list[Solid]:
    """The solids of a campaign that are not in the model."""
    recipe = world.recipe
    boxes = [*recipe.neighbours, *campaign.obstacles]
    solids = [make_box_solid(box) for box in boxes] + [make_roof_solid(box) for box in boxes if has_roof(box)]
    solids += [solid for box in boxes if box.look == "scaffold" for solid in make_scaffold_solids(box)]
    make_tree = make_tree_solids if campaign.season.leaves else make_bare_tree_solids
    for i, tree in enumerate(recipe.trees):
        solids += make_tree(tree, seed_generator(recipe, f"tree {i}"))
    b = recipe.building
    return [*solids, make_ground_solid(GROUND_HALF_M, (b.length_m / 2, b.depth_m / 2), -0.02)]


def build_scene(world: DemoWorld, campaign: CampaignRecipe, index: int) -> RenderScene:
    """The scene of campaign number ``index``, with its defects drawn and its light baked in."""
    solids = [*world.ifc, *make_surrounding_solids(world, campaign)]
    rays = RayScene([world.transform_to_site(s.triangles) for s in solids])
    boxes = {box.name: box for box in (*world.recipe.neighbours, *campaign.obstacles)}
    parts, uncharted = split_by_chart(world, solids, boxes)
    names = sorted({p.texture for p in parts})
    baked = map_blocks(lambda name: bake_chart(world, rays, campaign, index, world.charts[name], boxes), names)
    textures = dict(zip(names, baked, strict=True))
    parts += [
        make_lit_part(world, rays, campaign, solid, triangles) for solid, triangles in uncharted if len(triangles)
    ]
    textures[DETAIL] = paint_concrete(DETAIL_TEXTURE_PX, seed_generator(world.recipe, DETAIL))
    textures["sky"] = paint_sky(seed_generator(world.recipe, f"sky {campaign.id}"), campaign.light.overcast)
    parts += [make_sky_dome(), make_far_ground(campaign)]
    return RenderScene(parts=parts, textures=textures, rays=rays)
