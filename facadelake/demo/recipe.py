"""The recipe of the demo: building, defects, surroundings, flights and light (data/demo/recipe.yaml)."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from facadelake.core.errors import InputDataError

DefectClass = Literal["crack", "spalling", "moisture"]
DefectState = Literal["absent", "present", "new", "grown", "repaired"]
Vector3 = tuple[float, float, float]


class RecipePart(BaseModel):
    """A part of the recipe: unknown keys are errors, values do not change after reading."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class DemoPlace(RecipePart):
    """Origin of the model in EPSG:4979.

    The x axis of the model is rotated by ``rotation_deg`` anticlockwise from grid east of ``crs``.
    """

    lon_deg: float
    lat_deg: float
    height_ellipsoidal_m: float
    rotation_deg: float
    crs: str


class DemoStorey(RecipePart):
    """A storey: height of its floor above the model's origin and its own height, metres."""

    name: str
    floor_m: float
    height_m: float


class OpeningRow(RecipePart):
    """A row of equal windows or doors in one facade and storey: centres along u, sill above the floor; metres."""

    facade: str
    storey: int
    kind: Literal["window", "door", "balcony door"] = "window"
    centres_u_m: list[float]
    sill_m: float
    width_m: float
    height_m: float


class Balcony(RecipePart):
    """A balcony: slab and railing in front of a facade, centred at u on the floor of a storey; metres."""

    facade: str
    storey: int
    centre_u_m: float
    width_m: float
    depth_m: float


class DemoBuilding(RecipePart):
    """The body: a rectangle of length by depth with a round corner (south-east) and a recessed top storey; metres."""

    length_m: float
    depth_m: float
    corner_radius_m: float
    setback_m: float
    wall_m: float
    reveal_m: float
    parapet_m: float
    storeys: list[DemoStorey]
    openings: list[OpeningRow]
    balconies: list[Balcony]

    @property
    def top_m(self) -> float:
        """Height of the ceiling of the top storey, metres."""
        return self.storeys[-1].floor_m + self.storeys[-1].height_m

    @property
    def shoulder_m(self) -> float:
        """Height of the floor of the top storey, where the walls are recessed, metres."""
        return self.storeys[-1].floor_m


class DemoDefect(RecipePart):
    """A defect of the building, the neighbour or the ground: centre and size in the plane of its surface, metres."""

    id: str
    kind: DefectClass
    surface: str
    u_m: float
    v_m: float
    width_m: float = Field(ge=0.05, le=1.5)
    height_m: float = Field(ge=0.05, le=1.5)
    states: list[DefectState]
    growth: float = 1.35


class DemoControlPoint(RecipePart):
    """A control point painted on a surface, surveyed to a few millimetres."""

    id: str
    surface: str
    u_m: float
    v_m: float


class BoxVolume(RecipePart):
    """An upright box outside the model (a neighbour, a container), metres in the model's frame."""

    name: str
    origin_m: Vector3
    size_m: Vector3
    look: Literal["brick", "plaster", "container"]


class Tree(RecipePart):
    """A tree: foot, height and crown radius, metres in the model's frame."""

    foot_m: Vector3
    height_m: float
    crown_m: float


class Optics(RecipePart):
    """The true camera (pixels, Brown's distortion) and what its EXIF states (nominal focal length and pixel pitch)."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    k1: float
    k2: float
    p1: float
    p2: float
    focal_mm: float
    pitch_um: float


class CloseRangeRow(RecipePart):
    """A row of close-range photographs along a surface from u to u, at a height and distance, metres."""

    surface: str
    u_from_m: float
    u_to_m: float
    v_m: float
    distance_m: float
    count: int
    turn_deg: float = 0.0


class DemoFlight(RecipePart):
    """The orbit, the close-range rows, and the errors of the aircraft's position and attitude."""

    orbit_count: int
    orbit_distance_m: float
    orbit_heights_m: list[float]
    close: list[CloseRangeRow]
    jitter_m: float
    jitter_deg: float
    gps_bias_m: Vector3
    gps_noise_m: Vector3
    attitude_bias_deg: Vector3
    attitude_noise_deg: float


class Daylight(RecipePart):
    """Sun and sky of a day; azimuth clockwise from north."""

    sun_azimuth_deg: float
    sun_elevation_deg: float
    sun: Vector3
    sky: Vector3
    exposure: float
    noise: float


class CampaignRecipe(RecipePart):
    """One campaign: its flight, light and temporary obstacles."""

    id: str
    starts: str
    seed: int
    flight: DemoFlight
    light: Daylight
    obstacles: list[BoxVolume] = []


class DemoRecipe(RecipePart):
    """The whole recipe."""

    seed: int
    texel_m: float
    place: DemoPlace
    building: DemoBuilding
    neighbours: list[BoxVolume]
    trees: list[Tree]
    optics: Optics
    control_points: list[DemoControlPoint]
    defects: list[DemoDefect]
    off_target_defects: list[DemoDefect]
    campaigns: list[CampaignRecipe]

    @model_validator(mode="after")
    def _check_consistency(self) -> DemoRecipe:
        """Defect ids are unique, and every defect has one state for each campaign."""
        ids = [d.id for d in (*self.defects, *self.off_target_defects)]
        if len(set(ids)) != len(ids):
            raise ValueError(f"defect ids are not unique: {sorted({i for i in ids if ids.count(i) > 1})}")
        for defect in (*self.defects, *self.off_target_defects):
            if len(defect.states) != len(self.campaigns):
                raise ValueError(
                    f"defect {defect.id} has {len(defect.states)} states, there are {len(self.campaigns)} campaigns"
                )
        return self


def load_recipe(path: Path) -> DemoRecipe:
    """The recipe of a YAML file; raises InputDataError that lists every wrong key."""
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError) as error:
        raise InputDataError(f"demo recipe {path} cannot be read: {error}; restore it from the checkout") from error
    try:
        return DemoRecipe.model_validate(content)
    except ValidationError as error:
        errors = [
            f"{'.'.join(map(str, e['loc'])) or 'recipe'}: {e['msg']} (is {e['input']!r:.60})" for e in error.errors()
        ]
        raise InputDataError(f"demo recipe {path} has {len(errors)} errors: " + "; ".join(errors)) from error
