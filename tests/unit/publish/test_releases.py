"""Published files: positions and CRS as independent readers see them; releases are immutable; latest is the newest."""

import json
import shutil
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pyogrio
import pyproj
import pytest
import shapely
from PIL import Image, ImageChops

from facadelake.core.duckdb_engine import open_duckdb
from facadelake.core.errors import InputDataError, StoreError
from facadelake.core.geodesy import SiteOrigin
from facadelake.lake.regrading import regrade
from facadelake.publish import releases
from facadelake.publish.geopackage import create_coverage_layers, create_facade_layers, create_map_layers
from facadelake.publish.releases import publish_campaign, publish_regraded
from facadelake.reporting.elevations.facades import Facade
from facadelake.reporting.elevations.marks import assign_marks, create_marks
from facadelake.severity.rule_packs import find_rule_file
from tests.unit.lake.small_campaign import BUILDING, CAMPAIGN, HEIGHT, LAT, LON, commit, lake_tables, stage_tables

KEYS = {"building_id": BUILDING, "campaign_id": CAMPAIGN}
ORIGIN = SiteOrigin(lon_deg=LON, lat_deg=LAT, height_ellipsoidal_m=HEIGHT)


def replace_columns(table: pa.Table, values: dict[str, list]) -> pa.Table:
    for name, column in values.items():
        place = table.schema.get_field_index(name)
        table = table.set_column(place, table.schema.field(name), [pa.array(column, table.schema.field(name).type)])
    return table


@pytest.fixture(scope="module")
def committed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    folder = tmp_path_factory.mktemp("lake")
    return folder, commit(folder, defects=3).version


@pytest.fixture
def lake(committed: tuple[Path, int], tmp_path: Path) -> tuple[Path, int]:
    """A copy of the committed lake for each test."""
    shutil.copytree(committed[0], tmp_path / "lake")
    return tmp_path / "lake", committed[1]


@pytest.fixture(scope="module")
def release(committed: tuple[Path, int], tmp_path_factory: pytest.TempPathFactory) -> Path:
    lake = tmp_path_factory.mktemp("published") / "lake"
    shutil.copytree(committed[0], lake)
    return publish_campaign(lake, version=committed[1], **KEYS)


def test_geoparquet_metadata_state_version_crs_types_and_bbox(release: Path) -> None:
    for name, code, kind in (
        ("defects", 4979, "Point Z"),
        ("defects_2d", 4326, "Point"),
        ("observations", 4979, "Point Z"),
    ):
        file = pq.ParquetFile(release / f"{name}.parquet")
        geo = json.loads(file.metadata.metadata[b"geo"])
        column = geo["columns"][geo["primary_column"]]
        assert geo["version"] == "1.1.0"
        assert geo["primary_column"] == "geometry"
        assert column["encoding"] == "WKB"
        assert column["geometry_types"] == [kind]
        assert pyproj.CRS.from_json_dict(column["crs"]) == pyproj.CRS.from_epsg(code)
        assert column["covering"]["bbox"]["xmin"] == ["bbox", "xmin"]
        patch = geo["columns"]["patch"]
        assert (patch["encoding"], patch["geometry_types"]) == ("WKB", [kind.replace("Point", "Polygon")])
        assert pyproj.CRS.from_json_dict(patch["crs"]) == pyproj.CRS.from_epsg(code)
        assert file.schema_arrow.field("bbox").type.num_fields == 4
        assert file.metadata.row_group(0).column(0).compression == "SNAPPY"


def test_a_filter_by_the_covering_of_a_column_loses_no_row(release: Path) -> None:
    """A patch reaches beyond its point, so the point's bounding box is no covering of it."""
    for name in ("defects", "defects_2d", "observations"):
        path = release / f"{name}.parquet"
        columns = json.loads(pq.read_schema(path).metadata[b"geo"])["columns"]
        rows = gpd.read_parquet(path)
        assert len(rows) > 1
        for column in ("geometry", "patch"):
            found = shapely.bounds(rows[column].values)
            with_bounds = ~np.isnan(found[:, 0])
            sides = pq.read_table(path)[columns[column]["covering"]["bbox"]["xmin"][0]].to_pylist()
            assert [side is not None for side in sides] == with_bounds.tolist()
            stated = [[side[end] for end in ("xmin", "ymin", "xmax", "ymax")] for side in sides if side is not None]
            np.testing.assert_allclose(stated, found[with_bounds], rtol=0, atol=1e-12)  # deg
        right, top = rows["patch"].iloc[0].bounds[2:]
        box = (right - 1e-9, top - 1e-9, right + 1e-9, top + 1e-9)  # the corner of a patch, off all points
        found_by = {
            column: open_duckdb("spatial")
            .execute(
                f"SELECT count(*) FROM read_parquet('{path}') WHERE {covering}.xmin <= {box[2]} AND {covering}.xmax >= "
                f"{box[0]} AND {covering}.ymin <= {box[3]} AND {covering}.ymax >= {box[1]}"
            )
            .fetchall()[0][0]
            for column in ("geometry", "patch")
            for covering in (columns[column]["covering"]["bbox"]["xmin"][0],)
        }
        assert found_by["patch"] == int(rows["patch"].intersects(shapely.box(*box)).sum()) > 0
        assert found_by["geometry"] == len(gpd.read_parquet(path, bbox=box)) == 0
        x, y = rows.geometry.iloc[0].x, rows.geometry.iloc[0].y
        near = gpd.read_parquet(path, bbox=(x - 1e-7, y - 1e-7, x + 1e-7, y + 1e-7))
        expected = rows.geometry.intersects(shapely.box(x - 1e-7, y - 1e-7, x + 1e-7, y + 1e-7))
        assert len(near) == int(expected.sum()) > 0


def test_duckdb_reads_the_same_positions(release: Path) -> None:
    """DuckDB's reader is independent of GeoPandas."""
    rows = open_duckdb("spatial").execute(
        f"SELECT ST_X(geometry), ST_Y(geometry), ST_Z(geometry), bbox.xmin, typeof(geometry), east_map_m, material "
        f"FROM read_parquet('{release / 'defects.parquet'}') ORDER BY defect_id"
    )
    found = rows.fetchall()
    assert len(found) == 3
    for index, (x, y, z, xmin, kind, east, material) in enumerate(found):
        assert x == pytest.approx(LON + 1e-6 * index, rel=0, abs=1e-12)  # deg
        assert y == pytest.approx(LAT, rel=0, abs=1e-12)  # deg
        assert z == pytest.approx(HEIGHT + 3 + 0.25 * index, rel=0, abs=1e-9)  # m
        assert xmin == pytest.approx(x, rel=0, abs=1e-12)  # deg
        assert "4979" in kind
        assert east == pytest.approx(500000 + 0.5 * index, rel=0, abs=1e-6)  # m
        assert material == "brick"


def test_pandas_and_geopandas_read_every_file_with_its_lists(release: Path) -> None:
    for name in ("defects", "defects_2d", "observations"):
        path = release / f"{name}.parquet"
        assert b"pandas" not in pq.read_schema(path).metadata
        there = gpd.read_parquet(path)
        assert len(there) == len(pd.read_parquet(path)) > 0
        assert there["patch"].dtype == "geometry"
    assert list(gpd.read_parquet(release / "defects.parquet")["covariance_site"].iloc[0]) == pytest.approx(
        pq.read_table(release / "defects.parquet")["covariance_site"][0].as_py(),
        rel=0,
        abs=1e-15,  # m2
    )


def test_attribute_table_begins_with_class_and_size_and_keeps_nulls(release: Path) -> None:
    table = pq.read_table(release / "defects.parquet")
    assert table.column_names[:4] == ["defect_id", "defect_class", "severity", "severity_low"]
    assert table.column_names[-7:] == [
        "building_id", "campaign_id", "run_id", "patch", "geometry", "bbox", "patch_bbox",
    ]  # fmt: skip
    assert table["element_name"].null_count == 3
    assert str(table.schema.field("element_name").type) == "string"


def test_geopackage_layers_as_gdal_sees_them(release: Path) -> None:
    path = release / "defects.gpkg"
    assert [str(name) for name, _ in pyogrio.list_layers(path)] == [
        "defects", "defects_3d", "defects_patches", "defects_patches_3d", "facade_S", "coverage_3d", "coverage_S",
        "layer_styles",
    ]  # fmt: skip
    for layer, code, kind in (("defects", 4326, "Point"), ("defects_3d", 4979, "Point Z")):
        info = pyogrio.read_info(path, layer=layer)
        assert (info["features"], info["geometry_type"]) == (3, kind)
        assert pyproj.CRS(info["crs"]) == pyproj.CRS.from_epsg(code)
        points = pyogrio.read_dataframe(path, layer=layer).geometry
        np.testing.assert_allclose(points.x, LON + 1e-6 * np.arange(3), rtol=0, atol=1e-12)  # deg
        np.testing.assert_allclose(points.y, LAT, rtol=0, atol=1e-12)  # deg
        assert set(points.has_z) == {code == 4979}


def test_coverage_is_on_the_surface_and_in_the_plane_of_its_facade(release: Path) -> None:
    flat = pyogrio.read_dataframe(release / "defects.gpkg", layer="coverage_S")
    assert len(flat) == 5
    assert flat.geometry[1].bounds == (0.25, 3.0, 0.5, 3.25)  # m: u, v
    assert "facade S" in pyogrio.read_info(release / "defects.gpkg", layer="coverage_S")["crs"]
    solid = pyogrio.read_info(release / "defects.gpkg", layer="coverage_3d")
    assert (solid["geometry_type"], pyproj.CRS(solid["crs"])) == ("Polygon Z", pyproj.CRS.from_epsg(4979))
    cells = gpd.read_parquet(release / "coverage.parquet")
    assert cells.crs.to_epsg() == 4979
    assert cells["found_crack_width_mm"].isna().sum() == 3
    assert set(cells["coverage_outcome"]) == {"imaged", "not_in_view"}


def test_a_campaign_without_coverage_has_no_layers_of_it() -> None:
    empty = stage_tables()["coverage"].slice(0, 0)
    assert list(create_coverage_layers(empty)) == []


def test_patches_are_a_separate_layer_joined_by_defect_id(release: Path) -> None:
    path = release / "defects.gpkg"
    for layer, code, kind in (("defects_patches", 4326, "Polygon"), ("defects_patches_3d", 4979, "Polygon Z")):
        info = pyogrio.read_info(path, layer=layer)
        assert (info["features"], info["geometry_type"]) == (3, kind)
        assert pyproj.CRS(info["crs"]) == pyproj.CRS.from_epsg(code)
    rows = pyogrio.read_dataframe(path, layer="defects_patches_3d")
    assert rows["defect_id"].tolist() == [f"defect-{index:04d}" for index in range(3)]
    up = shapely.get_coordinates(rows.geometry[1], include_z=True)[:, 2]
    np.testing.assert_allclose([up.min(), up.max()], HEIGHT + 3.25 + np.array([-0.1, 0.1]), rtol=0, atol=1e-9)  # m


def _make_hexagon(u: float, v: float) -> shapely.Polygon:
    """The patch of the small campaign, 40 x 20 cm, about (u, v) in metres."""
    corners = [(-2, 0), (-1, -1), (1, -1), (2, 0), (1, 1), (-1, 1)]
    return shapely.Polygon([(u + 0.1 * a, v + 0.1 * b) for a, b in corners])


def test_facade_layer_is_an_elevation_in_metres(release: Path) -> None:
    """On the south facade, right is east: u is x, v is z of the site."""
    info = pyogrio.read_info(release / "defects.gpkg", layer="facade_S")
    assert pyproj.CRS(info["crs"]).type_name == "Engineering CRS"
    rows = pyogrio.read_dataframe(release / "defects.gpkg", layer="facade_S")
    for index, found in enumerate(rows.geometry):
        expected = _make_hexagon(0.5 * index, 3 + 0.25 * index)
        # The campaign's degrees are of a sphere: up to 0.3 % of 20 cm to each side, 0.6 mm.
        np.testing.assert_allclose(
            shapely.get_coordinates(found), shapely.get_coordinates(expected), rtol=0, atol=0.001
        )  # m


def test_defect_without_a_patch_is_a_box_on_the_elevation() -> None:
    table = lake_tables()["defects"]
    place = table.schema.get_field_index("patch")
    some = table.set_column(place, table.schema.field(place), [[None, *table["patch"].to_pylist()[1:]]])
    (layer,) = create_facade_layers(some)
    first, second, _ = shapely.from_wkb(layer.geometry)
    assert first.symmetric_difference(shapely.box(-0.2, 2.9, 0.2, 3.1)).area == pytest.approx(0, abs=1e-9)  # m2
    assert second.area == pytest.approx(0.06, abs=0.001)  # m2
    none = some.set_column(place, table.schema.field(place), [pa.nulls(3, pa.binary())])
    (layer,) = create_facade_layers(none)
    assert layer.geometry_type == "Polygon"
    assert [name.name for name in create_map_layers(none, "defects")] == ["defects", "defects_3d"]


def test_a_facade_layer_and_an_elevation_have_one_frame() -> None:
    """A wall that faces 156.1 degrees: u is along the wall, not along the compass point of its name."""
    azimuth = np.radians(156.1)
    right, outward = np.array([-np.cos(azimuth), np.sin(azimuth)]), np.array([np.sin(azimuth), np.cos(azimuth)])
    places = [7.0 * outward + u * right for u in (-4.0, 0.5, 6.0)]
    table = replace_columns(
        lake_tables()["defects"],
        {
            "facade": ["SE"] * 3, "facade_azimuth_deg": [156.1] * 3,
            "x_site_m": [place[0] for place in places], "y_site_m": [place[1] for place in places],
            "normal_x": [outward[0]] * 3, "normal_y": [outward[1]] * 3, "patch": [None] * 3,
        },
    )  # fmt: skip
    (layer,) = create_facade_layers(table)
    assert layer.name == "facade_SE"
    centres = [shapely.from_wkb(one).centroid for one in layer.geometry]
    np.testing.assert_allclose([c.x for c in centres], [-4.0, 0.5, 6.0], rtol=0, atol=1e-9)  # m
    view = Facade(
        code="SE", part=0, azimuth_deg=156.1, area_m2=1, u_min_m=-10, u_max_m=10, v_min_m=0, v_max_m=9, near_w_m=9,
        far_w_m=0,
    )  # fmt: skip
    (marks,), _ = assign_marks([view], create_marks(table, ORIGIN))
    for mark, wkb in zip(marks, layer.geometry, strict=True):
        drawn = shapely.Polygon(view.uvw_from_site(mark.corners_site_m)[:, :2])
        assert drawn.symmetric_difference(shapely.from_wkb(wkb)).area == pytest.approx(0, abs=1e-9)  # m2


def test_an_outline_where_the_wall_turns_away_keeps_its_size_in_a_facade_layer() -> None:
    """A patch of 0.4 x 0.2 m at a round corner, 40 degrees off its facade, is not foreshortened to 0.31 m."""
    turn = np.radians(140.0)
    along = np.array([-np.cos(turn), np.sin(turn), 0.0])
    centre = np.array([3.0, -4.0, 2.0])
    corners = centre + np.array(
        [a * along + [0, 0, b] for a, b in ((-0.2, -0.1), (0.2, -0.1), (0.2, 0.1), (-0.2, 0.1))]
    )
    patch = shapely.to_wkb(shapely.Polygon(ORIGIN.geo_from_site(corners)), output_dimension=3)
    geo = ORIGIN.geo_from_site(centre[None])[0]
    values = dict(zip(("x_site_m", "y_site_m", "z_site_m"), centre, strict=True))
    values |= dict(zip(("lon_deg", "lat_deg", "height_ellipsoidal_m"), geo, strict=True))
    values |= {"normal_x": np.sin(turn), "normal_y": np.cos(turn), "facade_azimuth_deg": 180.0, "patch": patch}
    one = replace_columns(lake_tables()["defects"].slice(0, 1), {name: [value] for name, value in values.items()})
    (layer,) = create_facade_layers(one)
    outline = shapely.from_wkb(layer.geometry[0])
    np.testing.assert_allclose(outline.bounds, [2.8, 1.9, 3.2, 2.1], rtol=0, atol=1e-4)  # m


def test_two_facades_of_one_compass_point_are_two_layers_each_in_its_own_plane() -> None:
    table = replace_columns(
        lake_tables()["defects"],
        {"facade": ["N-350", "N-016", "inside"], "facade_azimuth_deg": [350.2, 16.4, None]},
    )
    layers = list(create_facade_layers(table))
    assert [layer.name for layer in layers] == ["facade_N-016", "facade_N-350"]
    # Right of a facade that faces 16.4 degrees east of north is west-northwest.
    bearing = np.radians(16.4)
    right = np.cross([-np.sin(bearing), -np.cos(bearing), 0], [0, 0, 1])
    row = table.slice(1, 1).to_pylist()[0]
    u = np.array([row["x_site_m"], row["y_site_m"], 0.0]) @ right
    assert shapely.from_wkb(layers[0].geometry[0]).centroid.x == pytest.approx(u, abs=1e-3)  # m


def test_a_facade_whose_azimuth_changed_between_campaigns_has_a_layer_for_each() -> None:
    """One of the two was taken for both, so that outlines of the other campaign lay in a wrong plane."""
    table = replace_columns(
        lake_tables()["defects"], {"facade": ["N", "N", "N"], "facade_azimuth_deg": [350.0, 353.0, 353.001]}
    )
    layers = list(create_facade_layers(table))
    assert [(layer.name, len(layer.rows)) for layer in layers] == [("facade_N_350.00", 1), ("facade_N_353.00", 2)]


def test_readme_names_crs_datum_version_and_columns(release: Path) -> None:
    text = (release / "README.txt").read_text("utf-8")
    for words in (
        "EPSG:4979",
        "EPSG:25832; heights: ellipsoidal",
        f"version {int(release.name[1:])} of the lake",
        "georeferenced by GPS: 2 of 2 points used",
        "severity_rule",
        "Run run-1",
        "width_m                 horizontal extent",
        "deviation_from_model_m  signed distance",
    ):
        assert words in text, words


def test_same_version_again_changes_nothing(lake: tuple[Path, int], tmp_path: Path) -> None:
    pictures = tmp_path / "pictures"
    (pictures / "elevations").mkdir(parents=True)
    (pictures / "elevations" / "S.png").write_bytes(b"picture")
    first = publish_campaign(lake[0], version=lake[1], pictures=pictures, **KEYS)
    assert (first / "elevations" / "S.png").read_bytes() == b"picture"
    before = {path: path.stat().st_mtime_ns for path in first.rglob("*")}
    assert publish_campaign(lake[0], version=lake[1], **KEYS) == first
    assert {path: path.stat().st_mtime_ns for path in first.rglob("*")} == before
    assert all(not path.stat().st_mode & 0o222 for path in first.rglob("*") if path.is_file())
    assert first == lake[0] / "published" / BUILDING / CAMPAIGN / f"v{lake[1]:06d}"


def test_latest_leads_to_the_highest_version(lake: tuple[Path, int]) -> None:
    folder, old = lake
    new = commit(folder, run_id="run-2", inputs="j" * 64, defects=5).version
    newer = publish_campaign(folder, version=new, **KEYS)
    older = publish_campaign(folder, version=old, **KEYS)
    latest = newer.parent / "latest"
    assert str(latest.readlink()) == newer.name
    assert len(pq.read_table(latest / "defects.parquet")) == 5
    assert len(pq.read_table(older / "defects.parquet")) == 3
    assert sorted(path.name for path in newer.parent.iterdir()) == sorted([older.name, newer.name, "latest"])


def test_latest_is_a_copy_where_links_cannot_be_made(lake: tuple[Path, int], monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: Path, target: str, target_is_directory: bool = False) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(Path, "symlink_to", refuse)
    folder, old = lake
    latest = publish_campaign(folder, version=old, **KEYS).parent / "latest"
    assert len(pq.read_table(latest / "defects.parquet")) == 3
    new = commit(folder, run_id="run-2", inputs="j" * 64, defects=5).version
    publish_campaign(folder, version=new, **KEYS)
    assert not latest.is_symlink()
    assert len(pq.read_table(latest / "defects.parquet")) == 5
    assert len(list(latest.parent.iterdir())) == 3


def test_regraded_campaign_keeps_its_pictures_with_a_note(lake: tuple[Path, int], tmp_path: Path) -> None:
    (tmp_path / "pictures" / "crops").mkdir(parents=True)
    (tmp_path / "pictures" / "crops" / "1.png").write_bytes(b"picture")
    (tmp_path / "pictures" / "report.html").write_text("<h1>Tower</h1><h1>minor</h1>")
    (tmp_path / "pictures" / "cards").mkdir()
    card = Image.new("RGB", (1200, 100), "white")
    card.save(tmp_path / "pictures" / "cards" / "card_1.png")
    folder, old = lake
    first = publish_campaign(folder, version=old, pictures=tmp_path / "pictures", **KEYS)
    for pack in ("nyc_fisp_v1", "bre251_v1"):
        version = regrade(folder, rule_file=find_rule_file(pack), **KEYS).version
        assert version is not None
        new = publish_regraded(folder, version=version, **KEYS)
        assert (new / "crops" / "1.png").read_bytes() == b"picture"
        report = (new / "report.html").read_text()
        assert report.count("regraded") == 1
        assert report.startswith("<h1>Tower</h1><p ")
        assert f"This report shows version {old} of the lake" in report
        with Image.open(new / "cards" / "card_1.png") as marked:  # a card that is printed alone says so, too
            note = f"Grades of version {old} of the lake. Regraded since: the current grades are in the tables."
            assert marked.info["Older grades"] == note
            assert marked.size == (1200, 148)
            assert ImageChops.difference(marked.crop((0, 48, 1200, 148)), card).getbbox() is None
            assert marked.crop((0, 0, 1200, 48)).getextrema()[0][0] < 50  # dark text
        assert set(pq.read_table(new / "defects.parquet")["severity_rule"].to_pylist()) == {pack}
        assert f"Graded by: {pack} (rules)" in (new / "README.txt").read_text()
        assert str((new.parent / "latest").readlink()) == new.name
        assert publish_regraded(folder, version=version, **KEYS) == new
    assert "regraded" not in (first / "report.html").read_text()
    assert len(list(new.parent.iterdir())) == 4


def test_regraded_campaign_that_was_never_published(lake: tuple[Path, int]) -> None:
    version = regrade(lake[0], rule_file=find_rule_file("nyc_fisp_v1"), **KEYS).version
    assert version is not None
    assert (publish_regraded(lake[0], version=version, **KEYS) / "defects.gpkg").is_file()


def test_campaign_without_defects_is_published_too(tmp_path: Path) -> None:
    version = commit(tmp_path, defects=0).version
    release = publish_campaign(tmp_path, version=version, **KEYS)
    assert len(pq.read_table(release / "defects.parquet")) == 0
    assert pyogrio.read_info(release / "defects.gpkg", layer="defects")["features"] == 0


def test_failure_leaves_no_folder(lake: tuple[Path, int], monkeypatch: pytest.MonkeyPatch) -> None:
    def full(text: str) -> str:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(releases, "format_readme", lambda *_, **__: full(""))
    with pytest.raises(StoreError, match=r"No space left .*; the data are committed in version \d+ of the lake: check"):
        publish_campaign(lake[0], version=lake[1], **KEYS)
    assert list((lake[0] / "published" / BUILDING / CAMPAIGN).iterdir()) == []


def test_unknown_campaign(committed: tuple[Path, int]) -> None:
    with pytest.raises(InputDataError, match="has no campaign 1999-01 of tower in version"):
        publish_campaign(committed[0], building_id=BUILDING, campaign_id="1999-01", version=committed[1])
    with pytest.raises(InputDataError, match=r"the id '\.\./x' cannot name a folder"):
        publish_campaign(committed[0], building_id="../x", campaign_id=CAMPAIGN, version=committed[1])
