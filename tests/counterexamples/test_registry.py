"""Mistakes in the portfolio: told by the command line with file, key, value and what is allowed, all at once."""

from __future__ import annotations

from pathlib import Path

import pytest

from facadelake.campaigns.preflight import check_files
from facadelake.core.errors import FacadelakeError, InputDataError
from facadelake.registry import Building, read_portfolio
from facadelake.severity.rule_packs import find_rule_file
from tests.counterexamples.command_line import facadelake

GOOD = """
buildings:
  - id: hall
    name: Town hall
    model: models/hall.ifc
    photographs: photos/{campaign}/images
    detector: {kind: coco, file: "photos/{campaign}/boxes.json", alternatives: {noisy: "photos/{campaign}/noisy.json"}}
    schedule: {cron: "0 6 1 4,10 *", timezone: Europe/Berlin}
"""
TYPOS = """
buildings:
  - id: hall
    name: Town hall
    model: models/hall.ifc
    photograps: photos/{campaign}/images
    detector: {kind: yolo, file: "photos/{campaign}/boxes.json"}
    schedule: {cron: "61 6 1 4,10 *", timezone: Berlin}
    crs: {mapp: EPSG:25832}
    tolerances: {grazing_above_deg: 100}
  - id: town hall
    name: ""
    model: hall.ifc
    photographs: photos/{campaign}
    detector: {kind: coco, file: boxes.json, classes: {Rust: rust}}
  - id: mill
    name: Mill
    model: s3://bucket/mill.ifc
    photographs: photos/{campaign}
    detector: {kind: coco, file: boxes.json}
  - id: barn
    name: Barn
    model: barn.ifc
    photographs: photos
    detector: {kind: coco, file: boxes.json}
"""
MISTAKES = (
    "buildings[0].photographs (id 'hall'): missing; every building needs it",
    "buildings[0].detector.kind (id 'hall'): 'yolo'; allowed are 'coco', 'onnx'",
    "buildings[0].schedule.cron (id 'hall'): '61 6 1 4,10 *': not a cron expression (Bad minute); "
    "use five fields: minute hour day month weekday, such as '0 6 1 4,10 *'",
    "buildings[0].schedule.timezone (id 'hall'): 'Berlin': not a time zone; "
    "use a name of the IANA list such as Europe/Berlin or UTC",
    "buildings[0].tolerances.grazing_above_deg (id 'hall'): 100: Input should be less than or equal to 90",
    "buildings[0].photograps (id 'hall'): unknown key (did you mean 'photographs'?); allowed are id, name, model, ",
    "buildings[0].crs.mapp (id 'hall'): unknown key (did you mean 'map'?); allowed are map, vertical, ",
    "buildings[1].id (id 'town hall'): 'town hall': "
    "an id consists of letters, digits, '.', '_' and '-', and begins with a letter or digit",
    "buildings[1].name (id 'town hall'): '': String should have at least 1 character",
    "buildings[1].detector.classes.Rust (id 'town hall'): 'rust': Input should be 'crack', 'spalling' or 'moisture'",
    "buildings[2]: 's3://bucket/mill.ifc' has the scheme 's3'; a path or a file:// URI is allowed",
    "buildings[3] (id 'barn'): photographs '{folder}/photos' has no {campaign} in it and 'campaigns' is empty, "
    "so that campaigns cannot be distinguished; put {campaign} in the path, or list the campaigns",
)


def registry(folder: Path, text: str) -> Path:
    path = folder / "portfolio.yaml"
    path.write_text(text)
    return path


def hall(folder: Path, text: str = GOOD) -> Building:
    return read_portfolio(registry(folder, text)).get_building("hall")


def test_every_typo_is_told_at_once_without_a_traceback(tmp_path: Path) -> None:
    path = registry(tmp_path, TYPOS)
    done = facadelake("campaigns", "--portfolio", path, "--lake", tmp_path / "lake")
    assert (done.returncode, done.stdout) == (1, "")
    head, *lines = done.stderr.splitlines()
    assert head == "InputDataError: the portfolio has mistakes:"
    assert len(lines) == len(MISTAKES), done.stderr
    for said in MISTAKES:
        start = f"  {path}: {said.replace('{folder}', str(tmp_path))}"
        assert any(line.startswith(start) for line in lines), (start, done.stderr)
    assert not (tmp_path / "lake").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("inspect", "tower", "2026-04"), "there is no building 'tower' in the portfolio; it has hall"),
        (
            ("inspect", "hall", "2026-04"),
            "the model {folder}/models/hall.ifc of building 'hall' does not exist; correct the path in the portfolio",
        ),
    ],
    ids=["unknown building", "no model"],
)
def test_what_the_command_line_refuses_before_any_work(
    tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    done = facadelake(*arguments, "--portfolio", registry(tmp_path, GOOD), "--lake", tmp_path / "lake")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == f"InputDataError: {message.replace('{folder}', str(tmp_path))}\n"
    assert not (tmp_path / "lake").exists()


def test_no_registry(tmp_path: Path) -> None:
    path = tmp_path / "nothing.yaml"
    with pytest.raises(InputDataError) as raised:
        read_portfolio(path)
    assert str(raised.value) == (
        f"there is no portfolio at {path}; give a YAML file, or a folder of them, with --portfolio"
    )


def refused(building: Building, campaign: str) -> str:
    with pytest.raises(FacadelakeError) as raised:
        building.locate_photographs(campaign)
    return str(raised.value)


def test_a_missing_folder_of_photographs_names_the_campaigns_there_are(tmp_path: Path) -> None:
    folder = tmp_path / "photos" / "2026-04" / "images"
    assert refused(hall(tmp_path), "2026-04") == (
        f"the photographs' folder {folder} of building 'hall', campaign '2026-04', does not exist "
        "(campaigns with photographs: none found); correct the path in the portfolio"
    )
    folder.mkdir(parents=True)
    other = tmp_path / "photos" / "2026-05" / "images"
    assert refused(hall(tmp_path), "2026-05") == (
        f"the photographs' folder {other} of building 'hall', campaign '2026-05', does not exist "
        "(campaigns with photographs: 2026-04); correct the path in the portfolio"
    )
    listed = GOOD.replace("photos/{campaign}/images", 'photos\n    campaigns: ["2026-04", "2026-10"]')
    assert refused(hall(tmp_path, listed), "2026-05") == (
        "building 'hall' has no campaign '2026-05' (did you mean '2026-04'?); it has 2026-04, 2026-10 (key 'campaigns')"
    )


def test_a_folder_named_by_an_environment_variable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HALL_DATA", raising=False)
    text = GOOD.replace("photos/{campaign}/images", "${HALL_DATA:-nowhere}/{campaign}")
    assert refused(hall(tmp_path, text), "2026-04") == (
        f"the photographs' folder {tmp_path / 'nowhere' / '2026-04'} of building 'hall', campaign '2026-04', does not "
        "exist (campaigns with photographs: none found); "
        "correct the path in the portfolio, or set the environment variable HALL_DATA"
    )
    with pytest.raises(InputDataError) as raised:
        hall(tmp_path, GOOD.replace("models/hall.ifc", "${HALL_DATA}/hall.ifc"))
    assert str(raised.value) == (
        f"the portfolio has mistakes:\n  {tmp_path / 'portfolio.yaml'}: buildings[0]: '${{HALL_DATA}}/hall.ifc' needs "
        "the environment variable HALL_DATA, which is not set; set it to a folder"
    )


def test_detections_that_are_not_there(tmp_path: Path) -> None:
    building = hall(tmp_path)
    with pytest.raises(InputDataError) as raised:
        building.locate_detections("2026-04", None)
    assert str(raised.value) == (
        f"the detections file {tmp_path / 'photos' / '2026-04' / 'boxes.json'} of building 'hall' does not exist; "
        "correct the path in the portfolio"
    )
    with pytest.raises(InputDataError) as raised:
        building.locate_detections("2026-04", "nosy")
    assert str(raised.value) == (
        "detections 'nosy' are neither a file nor one of building 'hall's alternatives (noisy); "
        "give a path, or add the name under detector: alternatives"
    )


def test_an_unknown_severity_rule_pack(tmp_path: Path) -> None:
    building = hall(tmp_path, GOOD + "    severity_rules: extent_v9\n")
    with pytest.raises(InputDataError) as raised:
        find_rule_file(building.severity_rules)
    folder = Path(__file__).resolve().parents[2] / "data" / "severity"
    assert str(raised.value) == (
        f"there is no severity rule pack extent_v9 in {folder} (did you mean 'extent_v1'?); available: "
        "bre251_v1, concrete_03_v1, extent_v1, "
        "nyc_fisp_v1, paper_crack_width_v1, width_and_extent_v1"
    )


@pytest.mark.parametrize("model", ["hall.ifczip", "hall.dwg", "hall"])
def test_a_model_of_no_known_kind(tmp_path: Path, model: str) -> None:
    with pytest.raises(InputDataError) as raised:
        hall(tmp_path, GOOD.replace("models/hall.ifc", model))
    said = (
        "is of no known kind; allowed are an IFC (.ifc, not zipped), a mesh (.obj, .ply, .stl, .glb, .gltf), and the "
        "keyword 'as-built' for none"
    )
    assert said in str(raised.value)


def test_surveyed_points_that_are_not_there(tmp_path: Path) -> None:
    photographs = tmp_path / "photos" / "2026-05" / "images"
    photographs.mkdir(parents=True)
    (photographs.parent / "boxes.json").write_text("{}")
    path = tmp_path / "portfolio.yaml"
    named = (
        "    control_points: photos/{campaign}/gcp.txt\n    check_points: photos/{campaign}/check.txt\n"
        '    crs: {map: "EPSG:25832", vertical: ellipsoidal}\n'
    )
    path.write_text(GOOD.replace("models/hall.ifc", "as-built") + named)
    told = check_files(read_portfolio(path).get_building("hall"), "2026-05", None)
    at = photographs.parent
    assert told == (
        f"the portfolio names control points, but {at}/gcp.txt does not exist; the campaign is placed without them",
        f"the portfolio names check points, but {at}/check.txt does not exist; the campaign is placed without them",
    )


@pytest.mark.parametrize(
    ("crs", "message"),
    [
        (
            "{map: EPSG:99999}",
            "crs.map (id 'hall'): 'EPSG:99999': CRS 'EPSG:99999' is not known to PROJ; set crs.map in the portfolio to "
            "an EPSG code such as EPSG:25832",
        ),
        (
            "{map: EPSG:4326}",
            "crs.map (id 'hall'): 'EPSG:4326': CRS 'EPSG:4326' (WGS 84) is not a projected CRS",
        ),
        (
            "{vertical: EPSG:25832}",
            "crs.vertical (id 'hall'): 'EPSG:25832': EPSG:25832 (ETRS89 / UTM zone 32N) is not a vertical CRS",
        ),
        ("{vertical: sea level}", "crs.vertical (id 'hall'): 'sea level': PROJ knows no single vertical CRS named"),
        (
            "{gnss: ETRS98}",
            "crs.gnss (id 'hall'): 'ETRS98': not known to PROJ; a geographic CRS such as EPSG:4258 (ETRS89) or "
            "EPSG:6318 (NAD83(2011)) is expected",
        ),
        (
            "{gnss: EPSG:25832}",
            "crs.gnss (id 'hall'): 'EPSG:25832': ETRS89 / UTM zone 32N is not a geographic CRS; a geographic CRS",
        ),
        (
            "{map: EPSG:25832+7837, vertical: ellipsoidal}",
            "crs (id 'hall'): 'map' EPSG:25832+7837 has heights in EPSG:7837, 'vertical' is ellipsoidal; "
            "give one of them",
        ),
    ],
)
def test_each_crs_is_checked_when_the_portfolio_is_read(crs: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputDataError) as raised:
        hall(tmp_path, GOOD + f"    crs: {crs}\n")
    assert f"buildings[0].{message}" in str(raised.value)


def test_the_datum_of_a_positions_file_is_checked_when_the_portfolio_is_read(tmp_path: Path) -> None:
    with pytest.raises(InputDataError) as raised:
        hall(tmp_path, GOOD + '    positions: {file: ppk.csv, vertical: "EPSG:25832"}\n')
    assert "positions.vertical (id 'hall'): 'EPSG:25832': EPSG:25832 (ETRS89 / UTM zone 32N) is not a" in str(
        raised.value
    )


def test_crs_values_that_are_right_are_kept_as_written(tmp_path: Path) -> None:
    good = "{map: EPSG:25832+7837, vertical: DHHN2016, gnss: EPSG:4258}"
    crs = hall(tmp_path, GOOD + f"    crs: {good}\n").crs
    assert (crs.map, crs.vertical, crs.gnss) == ("EPSG:25832+7837", "DHHN2016", "EPSG:4258")
