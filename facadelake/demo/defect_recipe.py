"""The defects of the recipe, and what each is on the day of a campaign."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

DefectClass = Literal["crack", "spalling", "moisture"]
DefectState = Literal["absent", "new", "present", "grown", "shrunk", "repaired", "reopened"]
RepairMethod = Literal["render", "mortar", "cleaning"]
_GONE: tuple[DefectState, ...] = ("absent", "repaired")
_THERE: tuple[DefectState, ...] = ("present", "grown", "shrunk", "repaired")
_FOLLOWS: dict[DefectState, tuple[DefectState, ...]] = {
    "absent": ("absent", "new"),
    "new": _THERE,
    "present": _THERE,
    "grown": _THERE,
    "shrunk": _THERE,
    "reopened": _THERE,
    "repaired": ("repaired", "reopened"),
}


class RecipePart(BaseModel):
    """A part of the recipe: unknown keys are errors, values do not change after reading."""

    model_config = ConfigDict(frozen=True, extra="forbid")


@dataclass(frozen=True, kw_only=True)
class DefectOnDay:
    """A defect, or its place, on the day of a campaign: kind, state, and size in the plane of its surface, metres.

    Where there is no defect (absent or repaired), kind and size are those that it has at another time.
    """

    id: str
    kind: DefectClass
    surface: str
    u_m: float
    v_m: float
    width_m: float
    height_m: float
    state: DefectState
    repair: RepairMethod = "render"

    @property
    def exists(self) -> bool:
        """Whether the defect is there on that day."""
        return self.state not in _GONE


class DemoDefect(RecipePart):
    """A defect of the building, the neighbour or the ground: its centre, and its size at factor 1, metres.

    ``states``, ``sizes`` (factors of width and height) and ``kinds`` have one entry a campaign. Without ``sizes`` it
    has its size at all times; without ``kinds`` it is of ``kind`` at all times. A crack that spalls is one defect of
    two kinds. ``repair``: "render" is an area of new render around it; "mortar" fills the hole alone, so that nothing
    is left of the repair when the mortar falls out; "cleaning" leaves the wall as it was.
    """

    id: str
    kind: DefectClass
    surface: str
    u_m: float
    v_m: float
    width_m: float = Field(ge=0.05, le=1.5)
    height_m: float = Field(ge=0.05, le=1.5)
    states: list[DefectState]
    sizes: list[float] = []
    kinds: list[DefectClass] = []
    repair: RepairMethod = "render"

    @model_validator(mode="after")
    def _check_states(self) -> DemoDefect:
        """One entry a campaign, and states that can follow one another; sizes change where a state says so."""
        for name, values in (("sizes", self.sizes), ("kinds", self.kinds)):
            if values and len(values) != len(self.states):
                raise ValueError(f"defect {self.id} has {len(values)} {name} and {len(self.states)} states")
        for number, (before, after) in enumerate(pairwise(self.states), start=1):
            if after not in _FOLLOWS[before]:
                possible = " or ".join(_FOLLOWS[before])
                raise ValueError(f"defect {self.id}: '{after}' cannot follow '{before}', {possible} can")
            if before in _GONE or after in _GONE:
                continue
            size_before, size = (self.sizes[number - 1], self.sizes[number]) if self.sizes else (1.0, 1.0)
            right = "grown" if size > size_before else "shrunk" if size < size_before else "present"
            if after != right:
                raise ValueError(
                    f"defect {self.id}: size {size:g} after {size_before:g} is '{right}', but the state is '{after}'"
                )
        return self

    def describe_day(self, index: int) -> DefectOnDay:
        """The defect on the day of campaign number ``index``."""
        factor = self.sizes[index] if self.sizes else 1.0
        return self._describe(self.kinds[index] if self.kinds else self.kind, factor, self.states[index])

    def describe_place(self) -> DefectOnDay:
        """The defect of ``kind`` at factor 1, whenever that is."""
        return self._describe(self.kind, 1.0, "present")

    def _describe(self, kind: DefectClass, factor: float, state: DefectState) -> DefectOnDay:
        return DefectOnDay(
            id=self.id,
            kind=kind,
            surface=self.surface,
            u_m=self.u_m,
            v_m=self.v_m,
            width_m=self.width_m * factor,
            height_m=self.height_m * factor,
            state=state,
            repair=self.repair,
        )
