"""Which defect class a name of another taxonomy stands for.

Sources: dacl10k (Flotzinger et al., WACV 2024; 19 labels) and CODEBRIM (Mundt et al., CVPR 2019), beside plain words.
A name that is not listed has no counterpart among our classes (rust, graffiti, drainage, ...): it is reported, not
guessed. A building's registry entry may add names or change what one stands for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from facadelake.errors import InputDataError
from schemas.vocabulary import DefectClass

_COUNTERPARTS: Mapping[DefectClass, tuple[str, ...]] = {
    DefectClass.CRACK: ("crack", "cracks", "fissure", "alligator crack", "ACrack"),
    DefectClass.SPALLING: ("spalling", "spall", "spallation", "delamination", "exposed bars", "ExposedRebars"),
    DefectClass.MOISTURE: (
        "moisture", "damp", "dampness", "wet spot", "Wetspot", "water stain", "leakage",
        "efflorescence", "mould", "mold",
    ),
}  # fmt: skip


def _normal_form(name: str) -> str:
    return "".join(character for character in name.casefold() if character.isalnum())


_KNOWN: Mapping[str, DefectClass] = {
    _normal_form(name): defect_class for defect_class, names in _COUNTERPARTS.items() for name in names
}


@dataclass(frozen=True, kw_only=True)
class Crosswalk:
    """Defect classes by a detector's own class names, whatever their case and punctuation."""

    by_name: Mapping[str, DefectClass]

    def defect_class(self, source_class: str) -> DefectClass | None:
        """The class that ``source_class`` stands for; None where it has no counterpart."""
        return self.by_name.get(_normal_form(source_class))

    def why_unknown(self, source_class: str) -> str:
        """What to tell about a name without a counterpart."""
        return (
            f"class '{source_class}' stands for none of {', '.join(DefectClass)}; "
            "add it to the building's class_names if it should"
        )


def crosswalk_with(*class_names: Mapping[str, str]) -> Crosswalk:
    """The built-in crosswalk and over it each of ``class_names`` (detector's name -> defect class), the last on top.

    A model card's ``classes`` come first, a building's own words over them.
    Raises InputDataError for a defect class that does not exist.
    """
    own: dict[str, DefectClass] = {}
    for name, target in (pair for names in class_names for pair in names.items()):
        if target not in set(DefectClass):
            raise InputDataError(
                f"class_names: '{name}' is set to '{target}', which is not a defect class; "
                f"use one of {', '.join(DefectClass)}"
            )
        own[_normal_form(name)] = DefectClass(target)
    return Crosswalk(by_name={**_KNOWN, **own})
