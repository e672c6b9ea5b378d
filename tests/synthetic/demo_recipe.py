"""The demo building's recipe with photographs of another size."""

from __future__ import annotations

from facadelake.demo.recipe import DemoRecipe


def scale_photographs(recipe: DemoRecipe, *, width_px: int) -> DemoRecipe:
    """The recipe with photographs ``width_px`` wide and the same field of view, for quick tests."""
    f = width_px / recipe.optics.width_px
    sizes = {k: getattr(recipe.optics, k) * f for k in ("fx_px", "fy_px", "cx_px", "cy_px")}
    optics = recipe.optics.model_copy(
        update={
            **sizes,
            "width_px": width_px,
            "height_px": round(recipe.optics.height_px * f),
            "pitch_um": recipe.optics.pitch_um / f,
        }
    )
    return recipe.model_copy(update={"optics": optics})
