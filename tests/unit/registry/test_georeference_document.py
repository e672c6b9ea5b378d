"""The portfolio accepts the examples of docs/georeference-levels.md."""

import re
from pathlib import Path

import pytest
import yaml
from pydantic import ValidationError

from facadelake.building.model_georeference.control_pairs import ControlPair, fit_placement
from facadelake.registry.building import Building

DOCUMENT = Path(__file__).parents[3] / "docs" / "georeference-levels.md"
HALL = {
    "id": "hall", "name": "Hall", "model": "hall.ifc", "photographs": "photos/{campaign}",
    "detector": {"kind": "coco", "file": "boxes.json"},
}  # fmt: skip


def test_every_example_is_a_registry_entry():
    examples = [yaml.safe_load(text) for text in re.findall(r"```yaml\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)]
    assert len(examples) == 4
    buildings = [Building.model_validate(HALL | example) for example in examples]
    pairs = [ControlPair(ifc_m=pair.ifc_m, map_m=pair.map_m) for pair in buildings[1].crs.control]
    placement, evidence = fit_placement(pairs, "EPSG:25832", "ellipsoidal")
    assert "placed by 3 pairs" in evidence
    assert abs(placement.rotation_deg - 30.0) < 0.05  # deg
    assert buildings[3].model_building == "Main house"


def test_control_and_placement_exclude_one_another():
    crs = {
        "placement": {"east_m": 1.0, "north_m": 1.0, "height_m": 1.0},
        "control": [{"ifc_m": [0, 0, 0], "map_m": [1, 1, 1]}],
    }
    with pytest.raises(ValidationError, match="both 'placement' and 'control' place the model"):
        Building.model_validate(HALL | {"crs": crs})


def test_a_level_that_is_no_coarse_one_cannot_be_accepted():
    with pytest.raises(ValidationError, match="accept_level"):
        Building.model_validate(HALL | {"crs": {"accept_level": 50}})
