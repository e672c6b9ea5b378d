"""A small building with one campaign of its orbit alone, made once for all tests of the flow."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

from facadelake.demo.generate import generate_demo
from facadelake.demo.recipe import load_recipe
from tests.synthetic.demo_recipe import scale_photographs, select_campaigns

RECIPE = Path(__file__).parents[2] / "data" / "demo" / "recipe.yaml"
CAMPAIGN = "2026-04"


@dataclass(frozen=True, kw_only=True)
class SmallPortfolio:
    """A registry of one building, ``small``, and where its files are."""

    registry: Path
    images: Path
    truth: Path
    lake: Path


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> SmallPortfolio:
    """The demo building at half its resolution, photographed from the orbit alone."""
    recipe = scale_photographs(select_campaigns(load_recipe(RECIPE), CAMPAIGN), width_px=800)
    first = recipe.campaigns[0]
    flight = first.flight.model_copy(update={"close": []})
    campaign = first.model_copy(update={"id": CAMPAIGN, "flight": flight})
    recipe = recipe.model_copy(update={"campaigns": [campaign], "texel_m": 0.012})
    root = tmp_path_factory.mktemp("small")
    files = generate_demo(recipe, root / "building")
    folder = files.campaigns[0].folder
    registry = root / "portfolio.yaml"
    below = "building/campaigns/{campaign}"
    building = {
        "id": "small",
        "name": "A small building",
        "model": "building/demo.ifc",
        "photographs": f"{below}/images",
        "control_points": f"{below}/gcp_list.txt",
        "detector": {
            "kind": "coco",
            "file": f"{below}/detections.coco.json",
            "alternatives": {"noisy": f"{below}/detections_noisy.coco.json"},
        },
    }
    registry.write_text(yaml.safe_dump({"buildings": [building]}))
    return SmallPortfolio(
        registry=registry, images=folder / "images", truth=folder / "truth", lake=tmp_path_factory.mktemp("lake")
    )
