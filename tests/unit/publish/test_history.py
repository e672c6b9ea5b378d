"""The history in a release: every track and campaign of the building as the release's version knows them, styled."""

from __future__ import annotations

import re
import sqlite3
from collections import Counter
from contextlib import closing
from pathlib import Path
from xml.etree import ElementTree

import geopandas as gpd
import numpy as np
import pyarrow.parquet as pq
import pyogrio
import pytest

from facadelake.publish.history import create_history_layers, join_states
from facadelake.publish.releases import publish_campaign
from facadelake.publish.state_styles import create_state_style
from schemas.vocabulary import TrackState
from tests.sql.small_history import FIRST, SECOND, THIRD, commit_history, make_history
from tests.unit.lake.small_campaign import BUILDING, lake_tables


@pytest.fixture(scope="module")
def releases(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Releases of the last campaign: before the history was written, and after."""
    lake = tmp_path_factory.mktemp("history") / "lake"
    versions = commit_history(lake)
    return {
        name: publish_campaign(lake, building_id=BUILDING, campaign_id=THIRD, version=version)
        for name, version in (("before", versions[THIRD]), ("after", versions["history"]))
    }


def test_one_row_per_track_and_campaign_with_the_sizes_of_that_campaign(releases: dict[str, Path]) -> None:
    rows = gpd.read_parquet(releases["after"] / "history.parquet")
    assert rows.crs.to_epsg() == 4979
    assert len(rows) == len(rows[["track_id", "campaign_id"]].drop_duplicates()) == 16
    assert Counter(rows["campaign_id"]) == {FIRST: 4, SECOND: 5, THIRD: 7}  # not the release's campaign alone
    crack = rows[rows["track_id"] == "tower-0004"]
    assert crack["campaign_id"].tolist() == [SECOND, THIRD]
    assert crack["crack_width_mm"].tolist() == [0.4, 0.5]
    assert crack["crack_width_change_sigma_mm"].tolist()[1] == 0.02
    spalling = rows[rows["track_id"] == "tower-0002"]
    assert spalling["campaign_id"].tolist() == [FIRST, SECOND, THIRD]  # in order of time
    assert spalling["area_m2"].isna().tolist() == [False, True, False]
    assert spalling["captured_from"].dt.year.tolist() == [2025, 2025, 2026]
    assert set(rows["facade"]) == {"S"}
    tracks = gpd.read_parquet(releases["after"] / "tracks.parquet")
    assert len(tracks) == 8  # with the withdrawn one
    assert tracks.set_index("track_id")["track_state"]["tower-0004"] == "grown"
    assert pq.read_schema(releases["after"] / "history.parquet").names[:4] == [
        "track_id", "track_state", "state_evidence", "defect_id",
    ]  # fmt: skip


def test_layers_and_their_places(releases: dict[str, Path]) -> None:
    path = releases["after"] / "defects.gpkg"
    names = [str(name) for name, _ in pyogrio.list_layers(path)]
    assert names[-6:] == ["tracks", "tracks_3d", "track_states", "track_states_3d", "tracks_S", "layer_styles"]
    assert names[0] == "defects"  # GIS programs open the first one
    for name, count, kind in (("tracks", 7, "Point"), ("track_states", 16, "Point"), ("tracks_S", 7, "Polygon")):
        info = pyogrio.read_info(path, layer=name)
        assert (info["features"], info["geometry_type"]) == (count, kind)
    rows = pyogrio.read_dataframe(path, layer="tracks_S").set_index("track_id")
    # A track is drawn at x = 0.5 m times its number, z = 3 m and 0.25 m times it, 0.4 by 0.2 m.
    np.testing.assert_allclose(rows.geometry["tower-0004"].bounds, [1.8, 3.9, 2.2, 4.1], rtol=0, atol=1e-9)  # m
    assert rows["track_state"]["tower-0002"] == "reopened"


def test_qgis_finds_a_default_style_for_each_layer(releases: dict[str, Path]) -> None:
    """The table as QGIS writes it: it looks for a row of the layer with an empty schema."""
    with closing(sqlite3.connect(releases["after"] / "defects.gpkg")) as package:
        found = package.execute(
            "SELECT f_table_name, styleQML FROM layer_styles WHERE f_table_schema = '' AND useAsDefault = 1 "
            "AND f_geometry_column = 'geometry' ORDER BY id"
        ).fetchall()
        kinds = dict(package.execute("SELECT table_name, data_type FROM gpkg_contents").fetchall())
    assert [name for name, _ in found] == [
        "coverage_3d", "coverage_S", "tracks", "tracks_3d", "track_states", "track_states_3d", "tracks_S",
    ]  # fmt: skip
    assert kinds["layer_styles"] == "attributes"
    assert ['type="marker"' in text for _, text in found] == [False, False, True, True, True, True, False]


@pytest.mark.parametrize("geometry_type", ["Point", "Point Z", "Polygon", "MultiPolygon"])
def test_every_state_has_a_symbol_of_its_own(geometry_type: str) -> None:
    root = ElementTree.fromstring(create_state_style(geometry_type).split("\n", 1)[1])
    assert {one.get("value") for one in root.iter("category")} == set(TrackState)
    look, shapes = set(), set()
    keys = ("name", "angle", "style", "color")
    for symbol in root.iter("symbol"):
        (layer,) = symbol.findall("layer")
        options = {one.get("name"): one.get("value") for one in layer.iter("Option") if one.get("name")}
        assert options == {one.get("k"): one.get("v") for one in layer.iter("prop")}
        is_open = options["color"].endswith(",0")
        shapes.add((options.get("name"), options.get("angle"), options.get("style"), is_open))
        look.add(tuple(options.get(key) for key in keys))
    assert len(look) == len(TrackState)
    # Without colour, too, but for areas that are solid: grown and new.
    assert len(shapes) >= len(TrackState) - ("Point" not in geometry_type)


def test_a_release_without_a_history_says_so(releases: dict[str, Path]) -> None:
    before, after = ((releases[name] / "README.txt").read_text() for name in ("before", "after"))
    assert (
        "HISTORY\nnone: the building's defects had not been followed over its campaigns in this version of the lake "
        "('facadelake track')"
    ) in before
    assert not list(releases["before"].glob("*history*")) + list(releases["before"].glob("tracks*"))
    names = [str(name) for name, _ in pyogrio.list_layers(releases["before"] / "defects.gpkg")]
    assert not [name for name in names if name.startswith("track")]
    assert f"{SECOND}: 1 new, 1 grown, 2 repaired, 1 not_imaged\n{THIRD}: 1 new, " in after
    assert re.search(r"^state_evidence +what the state rests on", after, re.M)
    assert re.search(r"^trend_per_year ", after, re.M)


def test_nothing_tracked_makes_no_layer() -> None:
    history = make_history()
    tables = {**{name: lake_tables()[name] for name in ("campaigns", "defects")}, **history}
    none = {name: table.slice(0, 0) for name, table in tables.items()}
    assert list(create_history_layers(none["tracks"], join_states(none))) == []
