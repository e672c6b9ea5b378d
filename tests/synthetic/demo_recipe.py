"""The demo building's recipe with photographs of another size, or some of its campaigns."""

from __future__ import annotations

from facadelake.demo.recipe import DemoRecipe


def select_campaigns(recipe: DemoRecipe, *campaign_ids: str) -> DemoRecipe:
    """The recipe with these campaigns alone, and the states of its defects in them."""
    numbers = [[c.id for c in recipe.campaigns].index(name) for name in campaign_ids]
    defects, off_target = (
        [
            defect.model_copy(
                update={
                    name: [values[n] for n in numbers] if (values := getattr(defect, name)) else []
                    for name in ("states", "sizes", "kinds")
                }
            )
            for defect in group
        ]
        for group in (recipe.defects, recipe.off_target_defects)
    )
    campaigns = [recipe.campaigns[n] for n in numbers]
    return recipe.model_copy(update={"campaigns": campaigns, "defects": defects, "off_target_defects": off_target})


def scale_photographs(recipe: DemoRecipe, *, width_px: int) -> DemoRecipe:
    """The recipe with photographs ``width_px`` wide and the same field of view, for quick tests."""
    return recipe.model_copy(update={"optics": recipe.optics.scale_pixels(width_px / recipe.optics.width_px)})
