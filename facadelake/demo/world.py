"""What all campaigns have in common: the solids of the model, the charts and the frames."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field

import numpy as np

from facadelake.core.arrays import Float64Array, Float64Nx3, Float64x4x4
from facadelake.demo.building.charts import Chart, make_box_charts, make_building_charts, make_flat_chart
from facadelake.demo.building.solids import Solid
from facadelake.demo.recipe import DemoRecipe

GROUND_HALF_M = 42.0


@dataclass(frozen=True, kw_only=True, eq=False)
class DemoWorld:
    """What all campaigns have in common.

    ``site_from_ifc`` is (4, 4); ``ifc`` are the solids of the written model, ``charts`` the textured surfaces by name.
    """

    recipe: DemoRecipe
    site_from_ifc: Float64x4x4
    ifc: list[Solid]
    charts: dict[str, Chart] = field(repr=False)

    def transform_to_site(self, xyz_ifc: Float64Array) -> Float64Array:
        """Points (..., 3) of the model in site, metres."""
        return np.asarray(xyz_ifc @ self.site_from_ifc[:3, :3].T + self.site_from_ifc[:3, 3])

    def rotate_to_site(self, directions_ifc: Float64Nx3) -> Float64Nx3:
        """Directions (n, 3) in the model as unit vectors in site."""
        out = directions_ifc @ self.site_from_ifc[:3, :3].T
        return np.asarray(out / np.linalg.norm(out, axis=-1, keepdims=True))


def make_world(recipe: DemoRecipe, site_from_ifc: Float64x4x4, ifc: list[Solid]) -> DemoWorld:
    """The world of a recipe with the solids of its written model."""
    b = recipe.building
    charts = make_building_charts(b, recipe.texel_m)
    for box in (*recipe.neighbours, *(o for c in recipe.campaigns for o in c.obstacles)):
        charts += make_box_charts(box, 3 * recipe.texel_m)
    centre = (b.length_m / 2, b.depth_m / 2)
    corner = (centre[0] - GROUND_HALF_M, centre[1] - GROUND_HALF_M, -0.02)
    charts.append(make_flat_chart("ground", corner, (2 * GROUND_HALF_M, 2 * GROUND_HALF_M), 6 * recipe.texel_m))
    charts.append(
        make_flat_chart("roof", (-0.5, -0.5, b.shoulder_m), (b.length_m + 1, b.depth_m + 1), 3 * recipe.texel_m)
    )
    return DemoWorld(recipe=recipe, site_from_ifc=site_from_ifc, ifc=ifc, charts={c.name: c for c in charts})


def seed_generator(recipe: DemoRecipe, name: str) -> np.random.Generator:
    """Random numbers for the object ``name`` of the recipe, independent of all others."""
    return np.random.default_rng([recipe.seed, zlib.crc32(name.encode())])
