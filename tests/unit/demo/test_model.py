"""The written IFC: valid, stable, and the place of every defect."""

from __future__ import annotations

import csv
from pathlib import Path

import ifcopenshell
import ifcopenshell.geom
import ifcopenshell.util.element
import ifcopenshell.validate
import numpy as np
import pyproj
import pytest
import trimesh

from facadelake.demo.building.ifc_writer import write_ifc
from facadelake.demo.building.placement import place_model
from facadelake.demo.generate import DemoFiles
from facadelake.demo.recipe import DemoRecipe


@pytest.fixture(scope="module")
def model(recipe: DemoRecipe, tmp_path_factory: pytest.TempPathFactory) -> ifcopenshell.file:
    path = tmp_path_factory.mktemp("ifc") / "demo.ifc"
    write_ifc(recipe, place_model(recipe.place), path)
    return ifcopenshell.open(str(path))


def test_ifc_is_valid(model: ifcopenshell.file) -> None:
    logger = ifcopenshell.validate.json_logger()
    ifcopenshell.validate.validate(model, logger, express_rules=True)
    assert logger.statements == []


def test_ifc_has_what_the_building_is_made_of(model: ifcopenshell.file, recipe: DemoRecipe) -> None:
    assert [s.Elevation for s in sorted(model.by_type("IfcBuildingStorey"), key=lambda s: s.Elevation)] == [
        s.floor_m for s in recipe.building.storeys
    ]
    openings = sum(len(row.centres_u_m) for row in recipe.building.openings)
    assert len(model.by_type("IfcRelVoidsElement")) == len(model.by_type("IfcRelFillsElement")) == openings
    assert len(model.by_type("IfcRailing")) == len(recipe.building.balconies)
    corner = next(w for w in model.by_type("IfcWall") if w.Name == "Round corner, first floor")
    outline = corner.Representation.Representations[0].Items[0].SweptArea.OuterCurve
    assert [s.is_a() for s in outline.Segments].count("IfcArcIndex") == 2
    for wall in model.by_type("IfcWall"):
        assert ifcopenshell.util.element.get_psets(wall)["Pset_WallCommon"]["IsExternal"] is True
        assert ifcopenshell.util.element.get_material(wall).is_a("IfcMaterialLayerSet")
        assert ifcopenshell.util.element.get_container(wall).is_a("IfcBuildingStorey")


def test_same_recipe_gives_same_global_ids(model: ifcopenshell.file, recipe: DemoRecipe, tmp_path: Path) -> None:
    write_ifc(recipe, place_model(recipe.place), tmp_path / "again.ifc")
    again = ifcopenshell.open(str(tmp_path / "again.ifc"))
    ids = [e.GlobalId for e in model.by_type("IfcRoot")]
    assert len(set(ids)) == len(ids)
    assert sorted(ids) == sorted(e.GlobalId for e in again.by_type("IfcRoot"))


def test_check_points_lie_on_their_element(small_demo: DemoFiles) -> None:
    """From geographic truth into the model by hand: PROJ to the grid, IfcMapConversion inverted, nearest triangle."""
    model = ifcopenshell.open(str(small_demo.ifc))
    conversion = model.by_type("IfcMapConversion")[0]
    crs = pyproj.CRS(model.by_type("IfcProjectedCRS")[0].Name).to_3d()
    to_grid = pyproj.Transformer.from_crs("EPSG:4979", crs, always_xy=True)
    turn = np.arctan2(conversion.XAxisOrdinate, conversion.XAxisAbscissa)
    settings = ifcopenshell.geom.settings()
    settings.set("use-world-coords", True)
    settings.set("mesher-linear-deflection", 0.0005)
    path = small_demo.campaigns[1].folder / "truth" / "checkpoints.csv"
    with path.open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) >= 30
    distances = []
    for row in rows:
        east, north, height = to_grid.transform(
            *(float(row[k]) for k in ("lon_deg", "lat_deg", "height_ellipsoidal_m"))
        )
        d = np.array([east - conversion.Eastings, north - conversion.Northings, height - conversion.OrthogonalHeight])
        c, s = np.cos(turn), np.sin(turn)
        scale = conversion.Scale
        xyz = np.array([(c * d[0] + s * d[1]) / scale, (c * d[1] - s * d[0]) / scale, d[2]])
        element = model.by_guid(row["element_guid"])
        shape = ifcopenshell.geom.create_shape(settings, element).geometry
        mesh = trimesh.Trimesh(
            np.asarray(shape.verts).reshape(-1, 3), np.asarray(shape.faces).reshape(-1, 3), process=False
        )
        distances.append(float(trimesh.proximity.closest_point_naive(mesh, xyz[None])[1][0]))
        assert ifcopenshell.util.element.get_container(element).Name == row["storey"]
    assert max(distances) < 0.002  # m


def test_curved_and_set_back_walls_carry_defects(recipe: DemoRecipe) -> None:
    surfaces = {d.surface for d in recipe.defects}
    assert {"corner", "top south", "south", "north"} <= surfaces
    assert {d.kind for d in recipe.defects} == {"crack", "spalling", "moisture"}
    assert len(recipe.defects) >= 30
