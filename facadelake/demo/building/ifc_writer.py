"""The demo building as an IFC4 file: walls with openings, windows, doors, slabs, storey bands and balconies."""

from __future__ import annotations

from pathlib import Path

import ifcopenshell
import ifcopenshell.api.feature
import ifcopenshell.api.material
import ifcopenshell.api.project
import ifcopenshell.api.pset
import ifcopenshell.api.root
import numpy as np

from facadelake.demo.building.charts import Chart, make_building_charts
from facadelake.demo.building.ifc_entities import (
    Entity,
    add_product,
    assign_stable_guids,
    extrude,
    make_profile,
    make_rectangle,
    make_ring_sector,
    make_tangent_rectangle,
    set_body,
)
from facadelake.demo.building.ifc_project import add_materials, add_spatial_structure
from facadelake.demo.building.placement import DemoPlacement
from facadelake.demo.recipe import DemoBuilding, DemoRecipe, OpeningRow

BAND_DEPTH_M, BAND_HEIGHT_M = 0.06, 0.15
SILL_DEPTH_M, SILL_HEIGHT_M = 0.05, 0.05


class _BuildingWriter:
    """The model under construction."""

    def __init__(self, building: DemoBuilding, placement: DemoPlacement) -> None:
        self.b = building
        self.charts = {c.name: c for c in make_building_charts(building, 0.01)}
        self.model = ifcopenshell.api.project.create_file(version="IFC4")
        self.walls: dict[tuple[str, int], Entity] = {}
        self.storeys = add_spatial_structure(self.model, building, placement)
        self.materials, self.layers = add_materials(self.model, building.wall_m)

    def describe(self, element: Entity, pset: str, material: str | None, *, external: bool = True) -> None:
        """Assign the common property set and the material of an element.

        Args:
            element: the element.
            pset: name of the property set.
            material: name of the material; None: the layers of the external wall.
            external: the property IsExternal.
        """
        m = self.model
        common = ifcopenshell.api.pset.add_pset(m, product=element, name=pset)
        ifcopenshell.api.pset.edit_pset(m, pset=common, properties={"IsExternal": external})
        if material is None:
            ifcopenshell.api.material.assign_material(
                m, products=[element], type="IfcMaterialLayerSet", material=self.layers
            )
        else:
            ifcopenshell.api.material.assign_material(m, products=[element], material=self.materials[material])

    def add_wall(self, facade: str, storey: int, name: str, solid: Entity) -> None:
        """Add an external wall.

        Args:
            facade: name of the facade.
            storey: index of the storey.
            name: name of the wall; the first one of a facade and storey gets the openings.
            solid: its body.
        """
        wall = add_product(self.model, "IfcWall", name, self.storeys[storey], [solid], predefined_type="SOLIDWALL")
        self.describe(wall, "Pset_WallCommon", None)
        self.walls.setdefault((facade, storey), wall)

    def add_straight_wall(
        self, facade: str, storey: int, name: str, plan: tuple[float, float, float, float], base: float, height: float
    ) -> None:
        """Add a wall of rectangular plan.

        Args:
            facade: name of the facade.
            storey: index of the storey.
            name: name of the wall.
            plan: x0, y0, x1, y1, metres.
            base: height of its lower edge, metres.
            height: its height, metres.
        """
        profile = make_profile(self.model, make_rectangle(*plan))
        self.add_wall(facade, storey, name, extrude(self.model, profile, base, height))

    def make_corner_profile(self, radius_in: float, radius_out: float) -> Entity:
        """Profile of the round corner between two radii."""
        b = self.b
        centre = (b.length_m - b.corner_radius_m, b.corner_radius_m)
        return make_profile(self.model, *make_ring_sector(centre, radius_in, radius_out, -np.pi / 2, 0.0))

    def add_walls(self) -> None:
        """Add the walls of the lower storeys, their parapets, and the recessed walls of the top storey."""
        b, w, r, m = self.b, self.b.wall_m, self.b.corner_radius_m, self.model
        length, depth, s, last = b.length_m, b.depth_m, b.setback_m, len(b.storeys) - 1
        lower = {
            "south": (0.0, 0.0, length - r, w),
            "east": (length - w, r, length, depth - w),
            "north": (0.0, depth - w, length, depth),
            "west": (0.0, w, w, depth - w),
        }
        upper = {
            "top south": (s, s, length - s, s + w),
            "top east": (length - s - w, s + w, length - s, depth - w),
            "north": (s, depth - w, length - s, depth),
            "top west": (s, s + w, s + w, depth - w),
        }
        for i, storey in enumerate(b.storeys[:-1]):
            for facade, plan in lower.items():
                self.add_straight_wall(
                    facade,
                    i,
                    f"{facade.capitalize()} wall, {storey.name.lower()}",
                    plan,
                    storey.floor_m,
                    storey.height_m,
                )
            solid = extrude(m, self.make_corner_profile(r - w, r), storey.floor_m, storey.height_m)
            self.add_wall("corner", i, f"Round corner, {storey.name.lower()}", solid)
        for facade, plan in upper.items():
            name = f"{facade.removeprefix('top ').capitalize()} wall, {b.storeys[-1].name.lower()}"
            self.add_straight_wall(facade, last, name, plan, b.shoulder_m, b.storeys[-1].height_m)
        parapets = {k: v for k, v in lower.items() if k != "north"}
        parapets |= {
            "north, west end": (0.0, depth - w, s, depth),
            "north, east end": (length - s, depth - w, length, depth),
        }
        for facade, plan in parapets.items():
            self.add_straight_wall(f"parapet {facade}", last, f"Parapet, {facade}", plan, b.shoulder_m, b.parapet_m)
        self.add_wall(
            "parapet corner",
            last,
            "Parapet, round corner",
            extrude(m, self.make_corner_profile(r - w, r), b.shoulder_m, b.parapet_m),
        )

    def add_slabs(self) -> None:
        """Add the floors, the terrace and the roof."""
        b, w, r, m = self.b, self.b.wall_m, self.b.corner_radius_m, self.model
        length, depth, s = b.length_m, b.depth_m, b.setback_m
        a = (r - w) * np.sqrt(0.5)
        cx, cy = length - r, r
        inner_outline = [(w, w), (cx, w), (cx + a, cy - a), (length - w, cy), (length - w, depth - w), (w, depth - w)]
        for i, storey in enumerate(b.storeys):
            profile = make_profile(m, inner_outline, [[1, 2], [2, 3, 4], [4, 5], [5, 6], [6, 1]])
            name = "Terrace and floor slab" if i == len(b.storeys) - 1 else f"Floor slab, {storey.name.lower()}"
            solid = extrude(m, profile, storey.floor_m - 0.2, 0.2)
            slab = add_product(m, "IfcSlab", name, self.storeys[i], [solid], predefined_type="FLOOR")
            self.describe(slab, "Pset_SlabCommon", "Reinforced concrete", external=i == len(b.storeys) - 1)
        plan = make_rectangle(s - 0.3, s - 0.3, length - s + 0.3, depth + 0.3)
        roof = add_product(
            m,
            "IfcSlab",
            "Roof slab",
            self.storeys[-1],
            [extrude(m, make_profile(m, plan), b.top_m, 0.2)],
            predefined_type="ROOF",
        )
        self.describe(roof, "Pset_SlabCommon", "Reinforced concrete")

    def add_storey_bands(self) -> None:
        """Add bands in front of the wall at the floor of every storey except the lowest."""
        b, o, r, m = self.b, BAND_DEPTH_M, self.b.corner_radius_m, self.model
        length, depth = b.length_m, b.depth_m
        plans = {
            "south": make_rectangle(-o, -o, length - r, 0.0),
            "east": make_rectangle(length, r, length + o, depth + o),
            "north": make_rectangle(-o, depth, length, depth + o),
            "west": make_rectangle(-o, 0.0, 0.0, depth),
        }
        for i, storey in enumerate(b.storeys[1:], start=1):
            profiles = {k: make_profile(m, p) for k, p in plans.items()} | {
                "round corner": self.make_corner_profile(r, r + o)
            }
            for facade, profile in profiles.items():
                solid = extrude(m, profile, storey.floor_m - BAND_HEIGHT_M, BAND_HEIGHT_M)
                band = add_product(
                    m, "IfcMember", f"Storey band, {facade}, {storey.name.lower()}", self.storeys[i], [solid]
                )
                self.describe(band, "Pset_MemberCommon", "Sandstone")

    def add_opening(self, row: OpeningRow, u: float) -> None:
        """Add an opening in a wall, and the window or door that fills it, with the pane behind the reveal."""
        b, m, chart = self.b, self.model, self.charts[row.facade]
        wall, storey = self.walls[(row.facade, row.storey)], b.storeys[row.storey]
        base = storey.floor_m + row.sill_m
        place = f"{row.facade}, {storey.name.lower()}, {u:.2f} m"

        def block(width: float, out: tuple[float, float], z: float, height: float) -> Entity:
            return extrude(m, make_profile(m, make_tangent_rectangle(chart, u, width, *out)), z, height)

        opening = ifcopenshell.api.root.create_entity(m, ifc_class="IfcOpeningElement", name=f"Opening {place}")
        set_body(m, opening, [block(row.width_m, (-b.wall_m - 0.2, 0.2), base, row.height_m)])
        ifcopenshell.api.feature.add_feature(m, feature=opening, element=wall)
        sill_height = SILL_HEIGHT_M if row.kind == "window" and chart.radius_m == 0 else 0.0
        kind = "IfcWindow" if row.kind == "window" else "IfcDoor"
        pane = block(row.width_m, (-b.reveal_m - 0.06, -b.reveal_m), base + sill_height, row.height_m - sill_height)
        filling = add_product(m, kind, f"{row.kind.capitalize()} {place}", self.storeys[row.storey], [pane])
        filling.OverallHeight, filling.OverallWidth = row.height_m, row.width_m
        ifcopenshell.api.feature.add_filling(m, opening=opening, element=filling)
        self.describe(filling, "Pset_WindowCommon" if kind == "IfcWindow" else "Pset_DoorCommon", "Glass")
        if sill_height:
            sill_solid = block(row.width_m, (-b.reveal_m - 0.06, SILL_DEPTH_M), base, sill_height)
            member = add_product(m, "IfcMember", f"Sill {place}", self.storeys[row.storey], [sill_solid])
            self.describe(member, "Pset_MemberCommon", "Sandstone")

    def add_balconies(self) -> None:
        """Add slabs in front of the facade with railings of posts and rails."""
        m = self.model
        for balcony in self.b.balconies:
            chart, storey = self.charts[balcony.facade], self.b.storeys[balcony.storey]
            u, width, depth, floor = balcony.centre_u_m, balcony.width_m, balcony.depth_m, storey.floor_m
            place = f"{balcony.facade}, {storey.name.lower()}, {u:.2f} m"
            solid = extrude(
                m, make_profile(m, make_tangent_rectangle(chart, u, width, BAND_DEPTH_M, depth)), floor - 0.18, 0.18
            )
            slab = add_product(
                m, "IfcSlab", f"Balcony {place}", self.storeys[balcony.storey], [solid], predefined_type="FLOOR"
            )
            self.describe(slab, "Pset_SlabCommon", "Reinforced concrete")
            bars = []
            for z, thick in ((0.95, 0.06), (0.12, 0.03), (0.40, 0.03), (0.68, 0.03)):
                for plan in self._plan_rail(chart, u, width, depth, thick):
                    bars.append(extrude(m, make_profile(m, plan), floor + z, thick))
            for at in np.linspace(-width / 2 + 0.05, width / 2 - 0.05, 5):
                bars.append(
                    extrude(
                        m,
                        make_profile(m, make_tangent_rectangle(chart, u + at, 0.04, depth - 0.07, depth - 0.03)),
                        floor,
                        0.95,
                    )
                )
            railing = add_product(
                m, "IfcRailing", f"Railing {place}", self.storeys[balcony.storey], bars, predefined_type="BALUSTRADE"
            )
            self.describe(railing, "Pset_RailingCommon", "Galvanised steel")

    @staticmethod
    def _plan_rail(chart: Chart, u: float, width: float, depth: float, thick: float) -> list[list[tuple[float, float]]]:
        """Plan corners of a rail on the three free sides of a balcony."""
        edge = width / 2 - 0.05
        return [
            make_tangent_rectangle(chart, u, width - 0.1 + thick, depth - 0.05 - thick / 2, depth - 0.05 + thick / 2),
            make_tangent_rectangle(chart, u - edge, thick, 0.0, depth - 0.05 - thick / 2),
            make_tangent_rectangle(chart, u + edge, thick, 0.0, depth - 0.05 - thick / 2),
        ]


def write_ifc(recipe: DemoRecipe, placement: DemoPlacement, path: Path) -> None:
    """Write the demo building to ``path``; the same recipe gives the same GlobalIds."""
    writer = _BuildingWriter(recipe.building, placement)
    writer.add_walls()
    writer.add_slabs()
    writer.add_storey_bands()
    for row in recipe.building.openings:
        for u in row.centres_u_m:
            writer.add_opening(row, u)
    writer.add_balconies()
    assign_stable_guids(writer.model)
    writer.model.header.file_name.time_stamp = f"{recipe.campaigns[0].starts[:10]}T00:00:00"
    writer.model.write(str(path))
