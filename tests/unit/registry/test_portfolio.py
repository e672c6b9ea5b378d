"""The portfolio: its buildings, and the messages about mistakes."""

from __future__ import annotations

from pathlib import Path

import pytest

from facadelake.core.errors import InputDataError
from facadelake.registry import Building, CocoDetectorSetting, OnnxDetectorSetting, read_portfolio

GOOD = """
buildings:
  - id: hall
    name: Town hall
    model: models/hall.ifc
    photographs: photos/{campaign}/images
    control_points: photos/{campaign}/gcp_list.txt
    detector: {kind: coco, file: "photos/{campaign}/boxes.json", alternatives: {noisy: "photos/{campaign}/noisy.json"}}
    schedule: {cron: "0 6 1 4,10 *", timezone: Europe/Berlin}
"""


def _write(tmp_path: Path, text: str, name: str = "portfolio.yaml") -> Path:
    path = tmp_path / name
    path.write_text(text)
    return path


def test_paths_count_from_the_registry_and_campaigns_are_found(tmp_path: Path) -> None:
    for campaign in ("2026-10", "2026-04"):
        (tmp_path / "photos" / campaign / "images").mkdir(parents=True)
    (tmp_path / "photos" / "no-images-here").mkdir()
    (tmp_path / "photos" / "2026-04" / "noisy.json").write_text("{}")
    building = read_portfolio(_write(tmp_path, GOOD)).get_building("hall")
    assert building.list_campaigns() == ("2026-04", "2026-10")
    assert building.locate_photographs("2026-04") == tmp_path / "photos" / "2026-04" / "images"
    assert building.locate_control_points("2026-04") is None
    assert isinstance(building.detector, CocoDetectorSetting)
    assert building.locate_detections("2026-04", "noisy") == tmp_path / "photos" / "2026-04" / "noisy.json"


def test_a_folder_of_building_files_is_a_registry(tmp_path: Path) -> None:
    one = "id: {id}\nname: x\nmodel: m.ifc\nphotographs: 'p/{{campaign}}'\ndetector: {{kind: onnx, model: d.onnx}}\n"
    _write(tmp_path, one.format(id="a"), "a.yaml")
    _write(tmp_path, one.format(id="b"), "b.yml")
    assert [building.id for building in read_portfolio(tmp_path).buildings] == ["a", "b"]


@pytest.mark.parametrize(
    ("line", "model", "threads", "score_threshold"),
    [
        ("", "default", None, None),
        ("detector: {kind: onnx}", "default", None, None),
        ("detector: {kind: onnx, model: default, threads: 3, score_threshold: 0.4}", "default", 3, 0.4),
        ("detector: {kind: onnx, model: own/d.onnx}", "own/d.onnx", None, None),
    ],
)
def test_a_building_without_a_detector_of_its_own_has_the_default_one(
    tmp_path: Path, line: str, model: str, threads: int | None, score_threshold: float | None
) -> None:
    path = _write(tmp_path, f"id: a\nname: x\nmodel: m.ifc\nphotographs: 'p/{{campaign}}'\n{line}\n")
    detector = read_portfolio(path).get_building("a").detector
    assert isinstance(detector, OnnxDetectorSetting)
    assert detector.model == (model if model == "default" else str(tmp_path / model))
    assert (detector.threads, detector.score_threshold) == (threads, score_threshold)


def test_variables_have_defaults_and_are_named_when_a_path_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = GOOD.replace("models/hall.ifc", "${HALL_DATA:-nowhere}/hall.ifc")
    path = _write(tmp_path, text)
    monkeypatch.delenv("HALL_DATA", raising=False)
    with pytest.raises(InputDataError, match=r"nowhere/hall\.ifc.*does not exist.*environment variable HALL_DATA"):
        read_portfolio(path).get_building("hall").locate_model()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "hall.ifc").write_text("")
    monkeypatch.setenv("HALL_DATA", str(tmp_path / "elsewhere"))
    assert read_portfolio(path).get_building("hall").locate_model() == tmp_path / "elsewhere" / "hall.ifc"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("photographs:", "photograps:"), r"buildings\[0\]\.photograps .*unknown key \(did you mean 'photographs'\?\)"),
        (("name: Town hall", "nam: x"), r"buildings\[0\]\.name .*missing; every building needs it"),
        (("kind: coco", "kind: yolo"), r"detector\.kind .*'yolo'; allowed are 'coco', 'onnx'"),
        (('cron: "0 6 1 4,10 *"', 'cron: "61 6 * * *"'), r"schedule\.cron .*'61 6 \* \* \*': not a cron expression"),
        (("Europe/Berlin", "Berlin"), r"schedule\.timezone .*'Berlin': not a time zone; .*Europe/Berlin"),
        (("id: hall", "id: town hall"), r"buildings\[0\]\.id .*'town hall': an id consists of letters, digits"),
        (
            ("models/hall.ifc", "s3://bucket/hall.ifc"),
            r"'s3://bucket/hall\.ifc' has the scheme 's3'; a path or a file://",
        ),
        (("photos/{campaign}/images", "photos"), r"has no \{campaign\} in it and 'campaigns' is empty"),
        (("buildings:", "bildings:"), r"unknown key.*allowed are id, name"),
        (("buildings:", "buildings: [3]\nx:"), r"unknown key 'x'"),
        (("- id", "- [id"), "not readable as YAML"),
        (("detector: {", "tolerances: {grazing_above_deg: 100}\n    detector: {"), r"grazing_above_deg .* 100: .*90"),
    ],
)
def test_the_message_of_a_mistake_names_file_key_value_and_what_is_allowed(
    tmp_path: Path, change: tuple[str, str], message: str
) -> None:
    text = GOOD.replace(*change)
    assert text != GOOD
    path = _write(tmp_path, text)
    with pytest.raises(InputDataError, match=message) as caught:
        read_portfolio(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("cron", "message"),
    [
        (
            "0 6 30 2 *",
            "no date: there is no day 30 in month 2; give days that the months have, or L for their last one",
        ),
        ("0 6 31 4,6 *", "no date: there is no day 31 in month 4,6"),
        ("0 6 32 1 *", "no date: there is no day 32 in month 1"),
        ("0 0 6 1 4 *", "not a cron expression (6 fields); use five fields: minute hour day month weekday"),
        ("@daily", "not a cron expression (1 fields)"),
        (
            "0 6 */2 * 1",
            "cron takes the days that are both, Prefect those that are either; give '*' for one of the two",
        ),
        ("0 6 1-7 * */7", "day '1-7' and weekday '*/7': cron takes the days that are both"),
        ("0 6 LW * *", "Prefect knows no W and no weekday with L"),
        ("0 6 * * 5L", "Prefect knows no W and no weekday with L"),
    ],
)
def test_a_schedule_without_dates_or_with_two_readings_is_refused(cron: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputDataError) as raised:
        read_portfolio(_write(tmp_path, GOOD.replace("0 6 1 4,10 *", cron)))
    assert message in str(raised.value)


@pytest.mark.parametrize(
    "cron", ["0 6 29 2 *", "0 6 L * *", "0 6 * * WED", "0 6 1 * 1", "0 6 * * MON#1", "*/5 * * * *"]
)
def test_schedules_that_cron_and_prefect_read_alike_are_taken(cron: str, tmp_path: Path) -> None:
    read_portfolio(_write(tmp_path, GOOD.replace("0 6 1 4,10 *", cron)))


def test_all_mistakes_are_reported_at_once_and_ids_are_unique(tmp_path: Path) -> None:
    second = GOOD.replace("buildings:\n", "").replace("schedule: {cron", "shedule: {cron")
    with pytest.raises(InputDataError) as caught:
        read_portfolio(_write(tmp_path, GOOD + second.replace("Town hall", "''")))
    assert "shedule" in str(caught.value) and "buildings[1].name" in str(caught.value)
    with pytest.raises(InputDataError, match="several buildings have the id 'hall'"):
        read_portfolio(_write(tmp_path, GOOD + GOOD.replace("buildings:\n", "")))


def test_unknown_building_and_missing_registry_name_what_there_is(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match="no building 'tower' in the portfolio; it has hall"):
        read_portfolio(_write(tmp_path, GOOD)).get_building("tower")
    with pytest.raises(InputDataError, match=r"there is no portfolio at .*nothing\.yaml"):
        read_portfolio(tmp_path / "nothing.yaml")


def test_positions_are_a_word_or_a_file(tmp_path: Path) -> None:
    def read(line: str) -> Building:
        return read_portfolio(_write(tmp_path, GOOD + f"    positions: {line}\n")).get_building("hall")

    for word in ("xmp", "exif"):
        positions = read(word).positions
        assert positions is not None and (positions.source, positions.file) == (word, None)
        assert read(word).locate_positions("2026-04") is None
    building = read('{file: "photos/{campaign}/ppk.csv", vertical: "EPSG:7837"}')
    with pytest.raises(InputDataError) as raised:
        building.locate_positions("2026-04")
    path = tmp_path / "photos" / "2026-04" / "ppk.csv"
    assert str(raised.value) == (
        f"the positions file {path} of building 'hall' does not exist; correct the path in the portfolio"
    )
    path.parent.mkdir(parents=True)
    path.write_text("name,lat,lon\n")
    assert building.locate_positions("2026-04") == path
    assert read_portfolio(_write(tmp_path, GOOD)).get_building("hall").positions is None


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("xpm", "buildings[0].positions.source (id 'hall'): 'xpm': Input should be 'xmp', 'exif' or 'file'"),
        ("{source: xmp, vertical: ellipsoidal}", "give 'xmp', 'exif', or a mapping with 'file'"),
        ("{file: a.csv, sigma_vertical_m: 0.1}", "give both 'sigma_horizontal_m' and 'sigma_vertical_m', or neither"),
        ("{file: a.csv, datum: x}", "unknown key; allowed are source, file, columns, vertical, sigma_horizontal_m"),
        ("{file: a.csv, vertical: DHHN2016}", "String should match pattern"),
    ],
)
def test_mistakes_in_positions_are_named(line: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputDataError) as raised:
        read_portfolio(_write(tmp_path, GOOD + f"    positions: {line}\n"))
    assert message in str(raised.value)


def test_statements_are_accepted_for_the_campaigns_that_are_named(tmp_path: Path) -> None:
    line = "{statement: tie_points, deviation_max_m: 1.2, reason: shell without its insulation, campaigns: [2026-04]}"
    building = read_portfolio(_write(tmp_path, GOOD + f"    accept_placement: [{line}]\n")).get_building("hall")
    assert [one.deviation_max_m for one in building.list_accepted_statements("2026-04")] == [1.2]
    assert building.list_accepted_statements("2026-10") == ()


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("accept_placement: [{statement: gps_height, share_min: 0.5, reason: no receiver on board}]",
         "'gps_height' is compared by 'deviation_max_m'; give that one"),
        ("accept_placement: [{statement: model_in_view, deviation_max_m: 5, reason: an annex is in view}]",
         "'model_in_view' is compared by 'share_min'; give that one"),
        ("crs: {placement: {east_m: .nan, north_m: 5421033, height_m: 178}}", "should be a finite number"),
        ("tolerances: {placement_sigma_max_m: .inf}", "should be a finite number"),
    ],
)  # fmt: skip
def test_limits_that_could_never_apply_are_named(lines: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputDataError) as raised:
        read_portfolio(_write(tmp_path, GOOD + f"    {lines}\n"))
    assert message in str(raised.value)


@pytest.mark.parametrize("text", ["", "# nothing but a remark\n", "---\n"])
def test_an_empty_portfolio_is_named(text: str, tmp_path: Path) -> None:
    (tmp_path / "portfolio.yaml").write_text(text)
    with pytest.raises(InputDataError, match=r"portfolio\.yaml: the file is empty; 'buildings:' with a list"):
        read_portfolio(tmp_path / "portfolio.yaml")
