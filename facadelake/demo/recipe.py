"""The demo's recipe: the building, its defects, its surroundings, its flights (data/demo/recipe.yaml)."""

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
    """A piece of the recipe: unknown keys are mistakes, nothing changes after reading."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class DemoPlace(RecipePart):
    """Where the model's origin lies: EPSG:4979, and the model's x axis turned anticlockwise from grid east."""

    lon_deg: float
    lat_deg: float
    height_ellipsoidal_m: float
    rotation_deg: float
    crs: str


class DemoStorey(RecipePart):
    """A storey: its floor's height over the model's origin and its height, metres."""

    name: str
    floor_m: float
    height_m: float


class OpeningRow(RecipePart):
    """A row of equal windows or doors of one facade and storey: centres along u, sill over the floor; metres."""

    facade: str
    storey: int
    kind: Literal["window", "door", "balcony door"] = "window"
    centres_u_m: list[float]
    sill_m: float
    width_m: float
    height_m: float


class Balcony(RecipePart):
    """A balcony: slab and railing in front of a facade, centred at u on a storey's floor; metres."""

    facade: str
    storey: int
    centre_u_m: float
    width_m: float
    depth_m: float


class DemoBuilding(RecipePart):
    """The body: a rectangle of length by depth with one round corner (south-east) and a top storey set back; metres."""

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
        """Height of the top storey's ceiling, metres."""
        return self.storeys[-1].floor_m + self.storeys[-1].height_m

    @property
    def shoulder_m(self) -> float:
        """Height of the floor of the top storey, where the walls step back, metres."""
        return self.storeys[-1].floor_m


class DemoDefect(RecipePart):
    """A defect of the building (or of the neighbour or the ground): centre and size in its surface's plane, metres."""

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
    """A target painted on a surface, surveyed to some millimetres."""

    id: str
    surface: str
    u_m: float
    v_m: float


class BoxVolume(RecipePart):
    """An upright box that is not in the model, metres in the model's frame (a neighbour, a container)."""

    name: str
    origin_m: Vector3
    size_m: Vector3
    look: Literal["brick", "plaster", "container"]


class Tree(RecipePart):
    """A tree: foot, height and radius of its crown, metres in the model's frame."""

    foot_m: Vector3
    height_m: float
    crown_m: float


class Optics(RecipePart):
    """The camera as it is (pixels, Brown's terms) and as its EXIF tells it (nominal focal length and pixel pitch)."""

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
    """A row of close-range photographs: along a surface from u to u at a height and distance, metres."""

    surface: str
    u_from_m: float
    u_to_m: float
    v_m: float
    distance_m: float
    count: int
    turn_deg: float = 0.0


class DemoFlight(RecipePart):
    """The orbit and the close-range rows, and the errors of the aircraft's own positioning."""

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
    """One day of photographs."""

    id: str
    starts: str
    seed: int
    flight: DemoFlight
    light: Daylight
    obstacles: list[BoxVolume] = []


class DemoRecipe(RecipePart):
    """All of it."""

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
    def _consistent(self) -> DemoRecipe:
        ids = [d.id for d in (*self.defects, *self.off_target_defects)]
        if len(set(ids)) != len(ids):
            raise ValueError(f"defect ids repeat: {sorted({i for i in ids if ids.count(i) > 1})}")
        for defect in (*self.defects, *self.off_target_defects):
            if len(defect.states) != len(self.campaigns):
                raise ValueError(
                    f"defect {defect.id} has {len(defect.states)} states, there are {len(self.campaigns)} campaigns"
                )
        return self

    def scale_photographs(self, *, width_px: int) -> DemoRecipe:
        """The same recipe with photographs of another width (for quick tests)."""
        f = width_px / self.optics.width_px
        sizes = {k: getattr(self.optics, k) * f for k in ("fx_px", "fy_px", "cx_px", "cy_px")}
        optics = self.optics.model_copy(
            update={
                **sizes,
                "width_px": width_px,
                "height_px": round(self.optics.height_px * f),
                "pitch_um": self.optics.pitch_um / f,
            }
        )
        return self.model_copy(update={"optics": optics})


def load_recipe(path: Path) -> DemoRecipe:
    """The recipe of a YAML file; raises InputDataError that names every key that is wrong."""
    try:
        raw = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError) as error:
        raise InputDataError(f"demo recipe {path} cannot be read: {error}; restore it from the checkout") from error
    try:
        return DemoRecipe.model_validate(raw)
    except ValidationError as error:
        lines = [
            f"{'.'.join(map(str, e['loc'])) or 'recipe'}: {e['msg']} (is {e['input']!r:.60})" for e in error.errors()
        ]
        raise InputDataError(f"demo recipe {path} has {len(lines)} mistakes: " + "; ".join(lines)) from error
