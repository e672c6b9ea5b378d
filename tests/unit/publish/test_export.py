"""Export of one table to one file; the suffix selects the format."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow.csv as csv
import pyarrow.parquet as pq
import pyogrio
import pytest
import shapely

from facadelake.core.errors import InputDataError
from facadelake.publish.export import export_table
from facadelake.publish.replaced_file import replace_file
from tests.unit.lake.small_campaign import HEIGHT, LAT, LON, lake_tables

TABLES = lake_tables()


def test_defects_in_each_format(tmp_path: Path) -> None:
    table = TABLES["defects"]
    for suffix in (".parquet", ".gpkg", ".geojson", ".csv"):
        assert export_table("defects", table, tmp_path / f"defects{suffix}").is_file()
    assert len(pq.read_table(tmp_path / "defects.parquet")) == 3
    layers = [str(name) for name, _ in pyogrio.list_layers(tmp_path / "defects.gpkg")]
    assert layers == ["defects", "defects_3d", "defects_patches", "defects_patches_3d", "facade_S"]
    features = json.loads((tmp_path / "defects.geojson").read_text())["features"]
    assert len(features) == 3
    assert features[0]["geometry"]["coordinates"] == pytest.approx([LON, LAT, HEIGHT + 3], rel=0, abs=1e-8)
    assert features[0]["properties"]["element_name"] is None
    assert features[0]["properties"]["patch_wkt"].startswith("POLYGON Z ((9.49999")
    rows = csv.read_csv(tmp_path / "defects.csv").to_pylist()
    point = shapely.from_wkt(rows[2]["geometry_wkt"])
    assert (point.x, point.y) == pytest.approx((LON + 2e-6, LAT), rel=0, abs=1e-9)  # deg
    heights = shapely.get_coordinates(shapely.from_wkt(rows[2]["patch_wkt"]), include_z=True)[:, 2]
    assert (heights.min(), heights.max()) == pytest.approx((HEIGHT + 3.4, HEIGHT + 3.6), rel=0, abs=1e-6)  # m
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "defects.csv", "defects.geojson", "defects.gpkg", "defects.parquet",
    ]  # fmt: skip


def test_lists_of_numbers_are_json_text_where_a_format_has_no_lists(tmp_path: Path) -> None:
    wanted = TABLES["defects"]["covariance_site"][0].as_py()
    for suffix in (".gpkg", ".geojson", ".csv"):
        export_table("defects", TABLES["defects"], tmp_path / f"d{suffix}")
    rows = pyogrio.read_dataframe(tmp_path / "d.gpkg", layer="defects")
    assert json.loads(rows["covariance_site"][0]) == wanted
    assert json.loads(csv.read_csv(tmp_path / "d.csv")["covariance_site"][0].as_py()) == wanted
    features = json.loads((tmp_path / "d.geojson").read_text())["features"]
    found = features[0]["properties"]["covariance_site"]  # GDAL writes JSON text as JSON
    assert (json.loads(found) if isinstance(found, str) else found) == wanted
    export_table("poses", TABLES["poses"], tmp_path / "poses.csv")
    assert len(json.loads(csv.read_csv(tmp_path / "poses.csv")["covariance"][0].as_py())) == 36


def test_polygons_and_plain_tables(tmp_path: Path) -> None:
    export_table("elements", TABLES["elements"], tmp_path / "elements.gpkg")
    info = pyogrio.read_info(tmp_path / "elements.gpkg", layer="elements")
    assert (info["features"], info["geometry_type"]) == (1, "Polygon")
    for suffix in (".parquet", ".gpkg", ".csv"):
        export_table("photos", TABLES["photos"], tmp_path / f"photos{suffix}")
    assert pyogrio.read_info(tmp_path / "photos.gpkg", layer="photos")["features"] == 3
    assert len(pq.read_table(tmp_path / "photos.parquet")) == 3
    with pytest.raises(InputDataError, match="table photos has no geometry and cannot be written as GeoJSON"):
        export_table("photos", TABLES["photos"], tmp_path / "photos.geojson")


def test_rows_without_a_position_are_kept(tmp_path: Path) -> None:
    table = TABLES["observations"]
    missing = table.set_column(
        table.column_names.index("geometry"),
        table.schema.field("geometry"),
        [[None, *table["geometry"].to_pylist()[1:]]],
    )
    no_patch = missing.schema.get_field_index("patch")
    missing = missing.set_column(no_patch, missing.schema.field(no_patch), [[None, *missing["patch"].to_pylist()[1:]]])
    for suffix in (".parquet", ".gpkg", ".geojson", ".csv"):
        export_table("observations", missing, tmp_path / f"o{suffix}")
    assert pq.read_table(tmp_path / "o.parquet")["geometry"].null_count == 1
    assert json.loads((tmp_path / "o.geojson").read_text())["features"][0]["geometry"] is None
    for layer, features in (("observations", len(table)), ("observations_patches", len(table) - 1)):
        assert pyogrio.read_info(tmp_path / "o.gpkg", layer=layer)["features"] == features
    assert pq.read_table(tmp_path / "o.parquet")["patch"].null_count == 1


@pytest.mark.parametrize("name", ["defects", "observations"])
def test_an_outline_in_two_parts_among_outlines_in_one_is_written(tmp_path: Path, name: str) -> None:
    """A window divides an outline; GDAL has no type "Unknown Z", and the whole file was refused."""
    table = TABLES[name]
    place = table.schema.get_field_index("patch")
    patches = shapely.from_wkb(table["patch"].to_pylist())
    other = shapely.transform(patches[0], lambda xyz: np.add(xyz, (1e-5, 0, 0)), include_z=True)
    patches[0] = shapely.union(patches[0], other)
    assert patches[0].geom_type == "MultiPolygon"
    divided = table.set_column(place, table.schema.field(place), [shapely.to_wkb(patches).tolist()])
    for suffix in (".gpkg", ".parquet", ".geojson", ".csv"):
        export_table(name, divided, tmp_path / f"o{suffix}")
    kinds = {str(layer): str(kind) for layer, kind in pyogrio.list_layers(tmp_path / "o.gpkg")}
    assert kinds[f"{name}_patches"] == "MultiPolygon"
    assert kinds[f"{name}_patches_3d"] == "MultiPolygon Z"
    read = pyogrio.read_dataframe(tmp_path / "o.gpkg", layer=f"{name}_patches_3d")
    assert sorted(map(len, (shapely.get_parts(one) for one in read.geometry))) == [1] * (len(read) - 1) + [2]
    assert shapely.get_coordinates(read.geometry[0], include_z=True)[:, 2].min() > HEIGHT  # m


def test_the_file_behind_a_link_is_replaced_and_a_folder_is_not(tmp_path: Path) -> None:
    """A link of a GIS project to a shared file was replaced by a file of its own; the shared one stayed as it was."""
    shared, link = tmp_path / "shared.gpkg", tmp_path / "link.gpkg"
    export_table("defects", TABLES["defects"], shared)
    link.symlink_to(shared)
    export_table("defects", TABLES["defects"].slice(0, 1), link)
    assert link.is_symlink()
    assert pyogrio.read_info(shared, layer="defects")["features"] == 1
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(InputDataError, match=r"folder\.csv: it is a folder; give the name of a file"):
        export_table("defects", TABLES["defects"], tmp_path / "folder.csv")


def test_an_earlier_file_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "defects.gpkg"
    export_table("defects", TABLES["defects"], path)
    export_table("defects", TABLES["defects"].slice(0, 1), path)
    assert pyogrio.read_info(path, layer="defects")["features"] == 1


@contextmanager
def open_elsewhere(path: Path) -> Iterator[None]:
    """The GeoPackage as QGIS holds it: open in another process, in write-ahead mode, with a row in the log."""
    code = (
        "import sqlite3, sys; c = sqlite3.connect(sys.argv[1], isolation_level=None); "
        "c.execute('PRAGMA journal_mode = WAL'); c.execute('PRAGMA wal_autocheckpoint = 0'); "
        "c.execute('CREATE TABLE IF NOT EXISTS styles (name)'); c.execute('INSERT INTO styles VALUES (1)'); "
        "print('open', flush=True); sys.stdin.read(1); import os; os._exit(0)"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdin is not None and process.stdout is not None
    try:
        assert process.stdout.readline() == "open\n"
        yield
    finally:
        process.stdin.close()
        process.wait(10)
        process.stdout.close()


def test_a_geopackage_that_is_open_elsewhere_is_refused_and_left_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "defects.gpkg"
    export_table("defects", TABLES["defects"], path)
    with open_elsewhere(path), pytest.raises(InputDataError) as raised:
        export_table("defects", TABLES["defects"].slice(0, 1), path)
    assert str(raised.value) == (
        f"cannot write {path}: it is open in another program (QGIS?); close it there, or give another name"
    )
    assert pyogrio.read_info(path, layer="defects")["features"] == 3


def test_the_log_of_a_program_that_ended_is_removed_with_the_file(tmp_path: Path) -> None:
    """A stale -wal of the old file, applied to the new one, made it unreadable, and the export ended with 0."""
    path, log = tmp_path / "defects.gpkg", tmp_path / "defects.gpkg-wal"
    export_table("defects", TABLES["defects"], path)
    with open_elsewhere(path):
        pass
    assert log.stat().st_size > 0  # it ended without closing
    export_table("defects", TABLES["defects"].slice(0, 1), path)
    assert pyogrio.read_info(path, layer="defects")["features"] == 1
    path.unlink()
    log.write_bytes(b"of a file that is gone")
    export_table("defects", TABLES["defects"], path)
    assert pyogrio.read_info(path, layer="defects")["features"] == 3
    assert [one.name for one in tmp_path.iterdir()] == ["defects.gpkg"]
    path.write_text("no database")
    export_table("defects", TABLES["defects"], path)
    assert pyogrio.read_info(path, layer="defects")["features"] == 3


@pytest.mark.parametrize("suffix", [".gpkg", ".parquet", ".csv", ".geojson"])
def test_what_cannot_be_read_back_does_not_replace_the_earlier_file(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"defects{suffix}"
    export_table("defects", TABLES["defects"], path)
    before = path.read_bytes()

    def write_half(file: Path) -> dict[str, int]:
        file.write_bytes(before[: len(before) // 2])
        return {"defects": 3} if suffix == ".gpkg" else {"": 3}

    with pytest.raises(InputDataError) as raised:
        replace_file(path, write_half)
    assert str(raised.value) == (
        f"{path} was written, but cannot be read back: {raised.value.__cause__}; "
        "check the disk, or write to another folder"
    )
    assert path.read_bytes() == before
    assert [one.name for one in tmp_path.iterdir()] == [path.name]


def test_unsupported_suffix_and_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match=r"defects.shp: the suffix must be one of .parquet, .gpkg, .geojson, .csv"):
        export_table("defects", TABLES["defects"], tmp_path / "defects.shp")
    with pytest.raises(InputDataError, match=r"folder .* does not exist; create it first"):
        export_table("defects", TABLES["defects"], tmp_path / "no" / "defects.csv")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs Linux's /proc")
@pytest.mark.parametrize("suffix", [".parquet", ".gpkg", ".geojson", ".csv"])
def test_a_folder_that_cannot_be_written_is_told(suffix: str) -> None:
    path = Path(f"/proc/defects{suffix}")  # not even root creates files there
    with pytest.raises(InputDataError) as raised:
        export_table("defects", TABLES["defects"], path)
    assert str(raised.value).startswith(f"cannot write {path}: ")
    assert str(raised.value).endswith("; choose a writable folder with free space")
