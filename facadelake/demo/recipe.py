"""The recipe of the demo: building, defects, surroundings, flights and light (data/demo/recipe.yaml)."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import yaml
from pydantic import Field, ValidationError, model_validator

from facadelake.core.errors import InputDataError
from facadelake.demo.defect_recipe import DemoDefect, RecipePart

Vector3 = tuple[float, float, float]


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


class DemoControlPoint(RecipePart):
    """A control point painted on a surface, surveyed to a few millimetres."""

    id: str
    surface: str
    u_m: float
    v_m: float


class BoxVolume(RecipePart):
    """An upright box outside the model (a neighbour, a container), metres in the model's frame.

    A scaffold's box is its sheeted part; one lift without sheeting stands on it.
    """

    name: str
    origin_m: Vector3
    size_m: Vector3
    look: Literal["brick", "plaster", "container", "scaffold"]


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

    def scale_pixels(self, factor: float) -> Optics:
        """The same lens before a sensor of the same size with ``factor`` times as many pixels a side."""
        lengths = {name: getattr(self, name) * factor for name in ("fx_px", "fy_px", "cx_px", "cy_px")}
        size = {name: round(getattr(self, name) * factor) for name in ("width_px", "height_px")}
        return self.model_copy(update={**lengths, **size, "pitch_um": self.pitch_um / factor})


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
    """The orbit, the close-range rows, and the errors of the aircraft's position and attitude.

    The orbit has ``orbit_count`` stations, anticlockwise from the south-west corner. Photographs are taken at the first
    ``orbit_share`` of them: a smaller share leaves a gap, and what only the others see is not photographed.
    """

    orbit_count: int
    orbit_share: float = Field(default=1.0, gt=0, le=1)
    orbit_distance_m: float
    orbit_heights_m: list[float]
    close: list[CloseRangeRow]
    jitter_m: float
    jitter_deg: float
    gps_bias_m: Vector3
    gps_noise_m: Vector3
    attitude_bias_deg: Vector3
    attitude_noise_deg: float

    def count_orbit_photographs(self) -> int:
        """Photographs taken on the orbit."""
        return round(self.orbit_share * self.orbit_count)

    def count_photographs(self) -> int:
        """Photographs of the orbit and of all close-range rows."""
        return self.count_orbit_photographs() + sum(row.count for row in self.close)


class Daylight(RecipePart):
    """Sun and sky of a day; azimuth clockwise from north."""

    sun_azimuth_deg: float
    sun_elevation_deg: float
    sun: Vector3
    sky: Vector3
    exposure: float
    noise: float
    overcast: float = Field(default=0.0, ge=0, le=1)


class Season(RecipePart):
    """Colours of leaves (0 to 1; none: bare trees) and of the lawn (0 to 255)."""

    leaves: Vector3 | None = (0.30, 0.42, 0.16)
    lawn: Vector3 = (88.0, 104.0, 62.0)


class CampaignRecipe(RecipePart):
    """One campaign: its flight, light, season and temporary obstacles, and whether control points were surveyed.

    ``pixels``: factor of the photographs' sides against those of the recipe's optics; an older drone has fewer.
    """

    id: str
    starts: str
    seed: int
    flight: DemoFlight
    light: Daylight
    season: Season = Season()
    obstacles: list[BoxVolume] = Field(default_factory=list)
    has_control_points: bool = True
    pixels: float = Field(default=1.0, gt=0)


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

    def find_optics(self, campaign: CampaignRecipe) -> Optics:
        """The optics of a campaign's photographs."""
        return self.optics if campaign.pixels == 1 else self.optics.scale_pixels(campaign.pixels)

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
