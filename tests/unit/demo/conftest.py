"""A small demo, made once: seven photographs a campaign, the second day as the first but with every defect there."""

from __future__ import annotations

from pathlib import Path

import pytest

from facadelake.demo import generate
from facadelake.demo.generate import DemoFiles, generate_demo
from facadelake.demo.recipe import DemoRecipe, load_recipe
from tests.synthetic.demo_recipe import scale_photographs, select_campaigns

RECIPE = Path(__file__).parents[3] / "data" / "demo" / "recipe.yaml"


@pytest.fixture(scope="session")
def recipe() -> DemoRecipe:
    return load_recipe(RECIPE)


@pytest.fixture(scope="session")
def small_recipe(recipe: DemoRecipe) -> DemoRecipe:
    """Two days that differ in the defects alone: same flight, same light, no noise, no obstacle."""
    first = select_campaigns(recipe, "2026-04").campaigns[0]
    flight = first.flight.model_copy(update={"orbit_count": 5, "close": first.flight.close[1:2]})
    light = first.light.model_copy(update={"noise": 0.0})
    before, after = (
        first.model_copy(update={"id": name, "flight": flight, "light": light}) for name in ("before", "after")
    )
    defects = [d.model_copy(update={"states": ["absent", "present"], "sizes": [], "kinds": []}) for d in recipe.defects]
    return scale_photographs(recipe, width_px=900).model_copy(
        update={
            "campaigns": [before, after],
            "defects": defects,
            "texel_m": 0.01,
            "trees": [],
            "neighbours": [],
            "off_target_defects": [],
        }
    )


@pytest.fixture(scope="session")
def small_demo(small_recipe: DemoRecipe, tmp_path_factory: pytest.TempPathFactory) -> DemoFiles:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(generate, "RENDER_PROCESSES", 1)  # for seven photographs a second one only loads the scene again
        return generate_demo(small_recipe, tmp_path_factory.mktemp("demo") / "out")
