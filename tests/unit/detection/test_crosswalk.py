"""The names of dacl10k and CODEBRIM: each has its counterpart, or is known to have none."""

from __future__ import annotations

import pytest

from facadelake.core.errors import InputDataError
from facadelake.detection.crosswalk import build_crosswalk
from schemas.vocabulary import DefectClass

# From the data sets' publications: TARGET_LIST of dacl10k-toolkit, the paper of CODEBRIM.
DACL10K = {
    "Crack": "crack", "ACrack": "crack", "Wetspot": "moisture", "Efflorescence": "moisture", "Rust": None,
    "Rockpocket": None, "Hollowareas": None, "Cavity": None, "Spalling": "spalling", "Graffiti": None,
    "Weathering": None, "Restformwork": None, "ExposedRebars": "spalling",
    "Bearing": None, "EJoint": None, "Drainage": None, "PEquipment": None, "JTape": None, "WConccor": None,
}  # fmt: skip
CODEBRIM = {
    "Background": None, "Crack": "crack", "Spallation": "spalling", "Efflorescence": "moisture",
    "ExposedBars": "spalling", "CorrosionStain": None,
}  # fmt: skip
WRITTEN_OUT = {
    "Alligator Crack": "crack", "Exposed Rebars": "spalling", "exposed bars": "spalling", "corrosion stain": None,
    "Expansion Joint": None, "Protective Equipment": None, "Joint Tape": None, "Washouts/Concrete corrosion": None,
}  # fmt: skip


@pytest.mark.parametrize(("name", "counterpart"), [*DACL10K.items(), *CODEBRIM.items(), *WRITTEN_OUT.items()])
def test_every_name_is_known(name: str, counterpart: str | None) -> None:
    crosswalk = build_crosswalk()
    for written in (name, name.lower(), name.upper(), f" {name.replace(' ', '_')} "):
        assert crosswalk.find_defect_class(written) == counterpart
    if counterpart is None:
        assert " (it is one of " in crosswalk.explain_unknown(name)


def test_the_taxonomies_are_complete() -> None:
    assert (len(DACL10K), len(CODEBRIM)) == (19, 6)


def test_an_unknown_name_is_not_guessed() -> None:
    crosswalk = build_crosswalk()
    assert crosswalk.find_defect_class("cracked pipe") is None
    assert crosswalk.explain_unknown("cat") == (
        "class 'cat' is none of crack, spalling, moisture; if it means one of them, "
        "add it to 'classes' of the model card or of the building's detector"
    )
    assert crosswalk.explain_unknown("Rust").endswith("detector (it is one of dacl10k's damages)")


def test_a_building_overrides_a_card_and_a_card_the_built_in_crosswalk() -> None:
    card, building = {"Rust": DefectClass.MOISTURE, "Efflorescence": "spalling"}, {"rust": "spalling"}
    crosswalk = build_crosswalk(card, building)
    assert crosswalk.find_defect_class("RUST") is DefectClass.SPALLING
    assert crosswalk.find_defect_class("efflorescence") is DefectClass.SPALLING
    assert crosswalk.find_defect_class("Wetspot") is DefectClass.MOISTURE
    with pytest.raises(InputDataError, match="'rust' is set to 'corrosion', which is not a defect class; use one of"):
        build_crosswalk(card, {"rust": "corrosion"})
