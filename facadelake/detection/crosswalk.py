"""Crosswalk: which defect class a class name of another taxonomy means.

Sources: all classes of dacl10k (Flotzinger et al., WACV 2024: 13 damages and 6 parts) and of CODEBRIM (Mundt et al.,
CVPR 2019: 5 defects and background), and common English terms. A name without a counterpart among the defect classes
(rust, graffiti, drainage, ...) is reported, never guessed. ``classes`` of a model card and of a building's detector add
names or override the built-in ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from facadelake.core.errors import InputDataError
from schemas.vocabulary import DefectClass

# dacl10k: ACrack is alligator crack; ExposedRebars, like CODEBRIM's ExposedBars, appear where concrete has spalled;
# efflorescence is the salt that seeping water leaves.
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

# Known names without a counterpart: other damage, parts of a structure, no damage.
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
    _normalise_name(name): taxonomy for taxonomy, names in _UNMAPPED.items() for name in names
}


@dataclass(frozen=True, kw_only=True)
class Crosswalk:
    """Defect classes by a detector's class names; case and punctuation are ignored. Keys are normalised names."""

    by_name: Mapping[str, DefectClass]

    def find_defect_class(self, source_class: str) -> DefectClass | None:
        """The defect class that ``source_class`` means; None where it has no counterpart."""
        return self.by_name.get(_normalise_name(source_class))

    def explain_unknown(self, source_class: str) -> str:
        """The reason reported for a name without a counterpart."""
        taxonomy = _TAXONOMY_OF_UNMAPPED.get(_normalise_name(source_class))
        return (
            f"class '{source_class}' is none of {', '.join(DefectClass)}; if it means one of them, "
            "add it to 'classes' of the model card or of the building's detector"
            f"{f' (it is one of {taxonomy})' if taxonomy else ''}"
        )


def build_crosswalk(*class_names: Mapping[str, str]) -> Crosswalk:
    """The built-in crosswalk, overridden by each of ``class_names`` (detector's name -> defect class) in turn.

    A model card's ``classes`` come first, those of a building's detector override them.
    Raises InputDataError for a defect class that does not exist.
    """
    declared: dict[str, DefectClass] = {}
    for name, target in (pair for names in class_names for pair in names.items()):
        if target not in set(DefectClass):
            raise InputDataError(
                f"classes: '{name}' is set to '{target}', which is not a defect class; "
                f"use one of {', '.join(DefectClass)}"
            )
        declared[_normalise_name(name)] = DefectClass(target)
    return Crosswalk(by_name={**_CLASS_OF_NAME, **declared})
