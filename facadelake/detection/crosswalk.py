"""Which defect class a name of another taxonomy stands for.

Sources: dacl10k (Flotzinger et al., WACV 2024: 13 damages and 6 parts) and CODEBRIM (Mundt et al., CVPR 2019: 5 defects
and background), whole, beside plain words. A name without counterpart among our classes (rust, graffiti, drainage, ...)
is reported, not guessed. ``classes`` of a model's card and of a building's detector add names or change what one
stands for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from facadelake.core.errors import InputDataError
from schemas.vocabulary import DefectClass

# dacl10k: ACrack is alligator crack; ExposedRebars lie where concrete has come off, as CODEBRIM's ExposedBars do;
# efflorescence is what water leaves when it passes through.
_COUNTERPARTS: Mapping[DefectClass, tuple[str, ...]] = {
    DefectClass.CRACK: (
        "Crack", "cracks", "fissure", "hairline crack",
        "ACrack", "alligator crack",
    ),
    DefectClass.SPALLING: (
        "Spalling", "spall", "spalled", "delamination",
        "ExposedRebars", "exposed rebar", "ExposedBars", "exposed bar",
        "Spallation",
    ),
    DefectClass.MOISTURE: (
        "moisture", "damp", "dampness", "damp patch", "water stain", "water damage", "leakage", "seepage",
        "Wetspot", "Efflorescence", "mould", "mold",
    ),
}  # fmt: skip

# Names that are known to stand for nothing that we map: other damage, parts of a structure, no damage at all.
_UNMAPPED: Mapping[str, tuple[str, ...]] = {
    "dacl10k's damages": (
        "Rust", "Rockpocket", "Hollowareas", "Cavity", "Graffiti", "Weathering", "Restformwork",
        "WConccor", "Washouts/Concrete corrosion",
    ),
    "dacl10k's parts": (
        "Bearing", "EJoint", "Expansion Joint", "Drainage", "PEquipment", "Protective Equipment", "JTape", "Joint Tape",
    ),
    "CODEBRIM's classes": ("CorrosionStain", "Background"),
}  # fmt: skip


def _normalise_name(name: str) -> str:
    return "".join(character for character in name.casefold() if character.isalnum())


_CLASS_OF_NAME: Mapping[str, DefectClass] = {
    _normalise_name(name): defect_class for defect_class, names in _COUNTERPARTS.items() for name in names
}
_TAXONOMY_OF_UNMAPPED: Mapping[str, str] = {
    _normalise_name(name): of for of, names in _UNMAPPED.items() for name in names
}


@dataclass(frozen=True, kw_only=True)
class Crosswalk:
    """Defect classes by a detector's own class names, whatever their case and punctuation."""

    by_name: Mapping[str, DefectClass]

    def defect_class(self, source_class: str) -> DefectClass | None:
        """The class that ``source_class`` stands for; None where it has no counterpart."""
        return self.by_name.get(_normalise_name(source_class))

    def why_unknown(self, source_class: str) -> str:
        """What to tell about a name without a counterpart."""
        of = _TAXONOMY_OF_UNMAPPED.get(_normalise_name(source_class))
        return (
            f"class '{source_class}' stands for none of {', '.join(DefectClass)}; "
            "add it to 'classes' of the model's card or of the building's detector if it should"
            f"{f' (it is one of {of})' if of else ''}"
        )


def build_crosswalk(*class_names: Mapping[str, str]) -> Crosswalk:
    """The built-in crosswalk and over it each of ``class_names`` (detector's name -> defect class), the last on top.

    A model card's ``classes`` come first, a building's own words over them.
    Raises InputDataError for a defect class that does not exist.
    """
    own: dict[str, DefectClass] = {}
    for name, target in (pair for names in class_names for pair in names.items()):
        if target not in set(DefectClass):
            raise InputDataError(
                f"classes: '{name}' is set to '{target}', which is not a defect class; "
                f"use one of {', '.join(DefectClass)}"
            )
        own[_normalise_name(name)] = DefectClass(target)
    return Crosswalk(by_name={**_CLASS_OF_NAME, **own})
