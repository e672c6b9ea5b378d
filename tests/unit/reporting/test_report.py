from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import cv2
import numpy as np
import pyarrow as pa
import pytest

from facadelake.core.tables import table_from_rows
from facadelake.reporting.cards.crops import write_crops
from facadelake.reporting.drawing.labels import label_ids
from facadelake.reporting.drawing.palette import bgr_from_hex, get_outcome_colour
from facadelake.reporting.html import STYLE
from facadelake.reporting.inspection import PictureSettings
from facadelake.reporting.overlays import draw_overlays, select_overlay_photographs
from facadelake.reporting.page.report import write_report
from facadelake.reporting.severity_order import sort_by_severity
from facadelake.severity.rule_packs import list_rule_packs
from tests.unit.reporting.painted_wall import NASTY_NAME, PaintedWall, make_defect_row, make_inspection
from tests.unit.severity.rule_headers import read_severities

COARSE = PictureSettings(cell_m=0.03, overlay_width_px=500)


class Page(HTMLParser):
    """What a browser would load, and the text it would show."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.tags: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href", "data", "srcset") and value]

    def handle_data(self, data: str) -> None:
        self.text += data


def read(path: Path) -> Page:
    page = Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page


def test_the_report_loads_nothing_from_elsewhere_and_escapes_names(painted: PaintedWall, tmp_path: Path) -> None:
    defects = [
        make_defect_row("D1", 2.0, 1.0),
        make_defect_row("D2", 3.0, 2.0, severity="severe", severity_rule="width_and_extent_v1"),
        make_defect_row("D3", 4.0, 2.0, severity="minor_or_worse", severity_rule="width_and_extent_v1"),
    ]
    inspection = make_inspection(painted, defects, ["D1", "D2"])
    path = write_report(inspection, painted.surface, tmp_path, COARSE)
    source, page = path.read_text(encoding="utf-8"), read(path)
    assert not re.search(r"(https?:)?//", source)
    assert "url(" not in source and "@import" not in source
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    assert NASTY_NAME in page.text  # as text, not as a tag
    assert "<script" not in source
    files = [link for link in page.links if not link.startswith("#")]
    assert len(files) > 4
    assert all((tmp_path / unquote(link)).is_file() for link in files)


def test_defects_are_sorted_by_severity_with_crops_and_cards(painted: PaintedWall, tmp_path: Path) -> None:
    defects = [
        make_defect_row("D1", 2.0, 1.0),
        make_defect_row("D2", 3.0, 2.0, severity="severe", severity_rule="width_and_extent_v1"),
        make_defect_row("D3", 4.0, 2.0, severity="minor_or_worse", severity_rule="width_and_extent_v1"),
    ]
    settings = replace(COARSE, report_cards=1, report_overlays=1)
    inspection = make_inspection(painted, defects, ["D1", "D2"])
    found = [{**row, "detector": "onnx:nano"} for row in inspection.detections.to_pylist()]
    inspection = replace(inspection, detections=table_from_rows("detections", found))
    path = write_report(inspection, painted.surface, tmp_path, settings)
    page = read(path)
    assert "Detected by onnx:nano. Automatic detection misses defects" in page.text
    assert [link for link in page.links if "card_" in link] == ["cards/card_2.png"] * 2  # from its number and its crop
    assert [link for link in page.links if "overlay_" in link] == ["overlay_a.jpg"] * 2
    assert "Only the first 1 of 3 defects have a card" in page.text
    table = path.read_text(encoding="utf-8").split('id="defects"')[1].split("</section>")[0]
    assert re.findall(r'<b title="(D\d)">', table) == ["D2", "D3", "D1"]
    assert table.count('class="crop"') == 2
    assert table.count("no picture") == 1
    rules = re.sub(r"\s+", " ", page.text.split("Severity rules")[-1])
    assert "severe wider than 15 mm (categories 4 and 5)" in rules  # the rules that were used are printed
    assert "Rule pack size-1 is not in data/severity/" in rules
    assert "Width measured of" in rules and "not measured of" in rules


def test_the_report_tells_uncertain_severities_and_overstated_widths(painted: PaintedWall, tmp_path: Path) -> None:
    wide = {"crack_width_mm": 24.5, "crack_width_sigma_mm": 9.0, "crack_width_outcome": "measured"}
    defects = [
        make_defect_row("D1", 2.0, 1.0, **wide, severity="severe", severity_low="moderate", severity_high="severe"),
        make_defect_row("D2", 3.0, 2.0, **wide, crack_width_blur_mm=13.4),
    ]
    text = read(write_report(make_inspection(painted, defects, ["D1", "D2"]), painted.surface, tmp_path, COARSE)).text
    assert "severe (moderate to severe)" in text
    assert "The severity of 1 cracks is not certain" in text
    assert "Warning: the widths of 1 cracks may be overstated, by about 13 to 13 mm" in text
    assert "may be overstated by about 13 mm (unknown blur)" in text


def test_a_report_fits_a_narrow_screen_and_has_cards_of_all_defects(painted: PaintedWall, tmp_path: Path) -> None:
    """What a browser of 390 px showed 612 px wide: the contents, which could not wrap, and tables side by side."""
    defects = [make_defect_row(f"D{n:02d}", 0.5 + 0.5 * n, 1.0) for n in range(9)]
    path = write_report(make_inspection(painted, defects, ["D00"]), painted.surface, tmp_path, COARSE)
    page = read(path)
    assert len({link for link in page.links if "card_" in link}) == 9
    assert "Each defect has a card" in page.text
    assert "8.40000000, 48.90000000, 181.000" in page.text  # as on cards: longitude, latitude, ellipsoidal height
    rules = dict(re.findall(r"(?m)^([a-z.][^{}@]*?) \{([^}]*)\}", STYLE))
    assert "flex-wrap: wrap" in rules["nav"]
    assert "min-width: 0" in rules[".side > div"]
    assert "overflow-x: auto" in rules[".scroll"]
    assert "pre { white-space: pre-wrap; }" in STYLE
    outside = re.sub(r'(?s)<div class="scroll">.*?</div>', "", path.read_text("utf-8"))
    assert "<table" not in outside  # a table scrolls in its own box


@pytest.mark.parametrize("pack", list_rule_packs())
def test_grades_of_every_rule_pack_are_sorted_by_severity(pack: str) -> None:
    words = read_severities(pack)
    rows = [
        {"severity": word, "severity_rule": pack, "area_m2": float(place), "defect_id": word}
        for place, word in enumerate(words)
    ]
    found = sort_by_severity(pa.Table.from_pylist(rows[::-1]))
    assert [row["severity"] for row in found] == list(words)


def test_a_campaign_without_defects_has_a_report(painted: PaintedWall, tmp_path: Path) -> None:
    page = read(write_report(make_inspection(painted, [], []), painted.surface, tmp_path, COARSE))
    assert "0defects" in page.text
    assert (tmp_path / "plan.png").stat().st_size > 5000
    assert (tmp_path / "distribution.png").stat().st_size > 2000


def test_the_passport_lists_disagreements_before_agreements(painted: PaintedWall, tmp_path: Path) -> None:
    inspection = make_inspection(painted, [], [])
    text = read(write_report(inspection, painted.surface, tmp_path, COARSE)).text
    assert "Placement checks" in text
    assert text.index("GPS deviates by +0.40 m") < text.index("810 of 1000 tie points lie on the model")


def test_a_crop_shows_the_box_it_was_cut_for(painted: PaintedWall, tmp_path: Path) -> None:
    inspection = make_inspection(painted, [make_defect_row("D1", 2.0, 1.0)], ["D1"])
    crop = cv2.imread(str(write_crops(inspection, tmp_path, PictureSettings(thumbnail_px=128))["D1"]))
    photograph = cv2.imread(str(painted.root / "a.png"))
    box = inspection.detections.to_pylist()[0]
    side = int(40 * (1 + 2 * 1.1))
    left, top = int(box["box_x_px"] + 20 - side / 2), int(box["box_y_px"] + 10 - side / 2)
    piece = cv2.resize(photograph[top : top + side, left : left + side], (128, 128), interpolation=cv2.INTER_CUBIC)
    difference = cv2.absdiff(crop, piece).max(axis=2)
    assert 0.75 < (difference < 25).mean() < 1.0  # the same but for the box drawn on it and JPEG


def test_overlays_show_posed_and_unposed_photographs(
    painted: PaintedWall, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    inspection = make_inspection(painted, [make_defect_row("D1", 2.0, 1.0)], ["D1"])
    inspection = replace(inspection, posed={"a.png": painted.posed["a.png"]})
    paths = draw_overlays(inspection, painted.surface, ["a.png", "b.png", "gone.png"], tmp_path, COARSE)
    assert {name: path.name for name, path in paths.items()} == {"a.png": "overlay_a.jpg", "b.png": "overlay_b.jpg"}
    sheets = [cv2.imread(str(path)).astype(int) for path in paths.values()]
    assert [sheet.shape[1:] for sheet in sheets] == [(500, 3)] * 2
    posed, unposed = (sheet[-350:] for sheet in sheets)  # below the legend
    cyan = [((p[..., 0] > 200) & (p[..., 1] > 200) & (p[..., 2] < 90)).sum() for p in (posed, unposed)]
    assert cyan[0] > 200  # pixels of the model's edges
    assert cyan[1] < 20
    assert "gone.png cannot be decoded" in caplog.text


@pytest.mark.parametrize("outcome", ["registered", "masked"])
def test_boxes_have_the_colour_of_their_outcome_where_they_are(
    painted: PaintedWall, tmp_path: Path, outcome: str
) -> None:
    inspection = make_inspection(painted, [make_defect_row("D1", 2.5, 1.5)], ["D1"])
    rows = [{**row, "observation_outcome": outcome, "defect_id": None} for row in inspection.observations.to_pylist()]
    inspection = replace(
        inspection, observations=table_from_rows("observations", rows), defects=table_from_rows("defects", [])
    )
    whole = PictureSettings(overlay_width_px=1000)
    paths = draw_overlays(inspection, painted.surface, ["a.png"], tmp_path, whole)
    picture = cv2.imread(str(paths["a.png"]))[-700:].astype(int)
    ink = np.array(bgr_from_hex(get_outcome_colour(outcome)))
    before = cv2.imread(str(painted.root / "a.png")).astype(int)
    changed = (np.abs(picture - ink).max(axis=2) < 60) & (np.abs(before - ink).max(axis=2) > 80)
    box = inspection.detections.to_pylist()[0]
    left, top = box["box_x_px"], box["box_y_px"]
    ys, xs = np.nonzero(changed[int(top) - 15 : int(top) + 36, int(left) - 15 : int(left) + 56])
    found = np.array([xs.min(), ys.min(), xs.max(), ys.max()]) - 15
    np.testing.assert_allclose(found, [0, 0, 40, 20], rtol=0, atol=2.5)  # px
    cross = np.array([xs, ys]).T - 15 - [20, 10]
    assert (np.abs(cross).max(axis=1) <= 2).any()  # the registered point, in the box's centre


def test_overlay_photographs_show_outcomes_first_and_then_defects(painted: PaintedWall) -> None:
    inspection = make_inspection(
        painted, [make_defect_row(f"D{n}", 2.0 + 0.2 * n, 1.0) for n in range(3)], ["D0", "D1", "D2"]
    )
    rows = inspection.observations.to_pylist()
    rows.append({**rows[0], "detection_id": "x", "photo_id": "b.png", "observation_outcome": "masked",
                 "defect_id": None})  # fmt: skip
    rows.append({**rows[0], "detection_id": "y", "photo_id": "b.png"})
    both = replace(inspection, observations=table_from_rows("observations", rows))
    assert select_overlay_photographs(both, 1) == ["b.png"]  # two outcomes, one defect
    assert select_overlay_photographs(both, 5) == ["b.png", "a.png"]
    again = replace(inspection, observations=table_from_rows("observations", [*rows[:3], rows[4]]))
    assert select_overlay_photographs(again, 5) == ["a.png"]  # b.png adds nothing
    assert select_overlay_photographs(replace(both, posed={}), 5) == []


@pytest.mark.parametrize(
    ("ids", "labels"),
    [
        (["D0001", "D0012", "D0100"], ["1", "12", "100"]),
        (["castle-d1", "castle-d2"], ["1", "2"]),
        (["defect-9f3ac1d2", "defect-17be0a11"], ["1", "2"]),
        (["D7"], ["7"]),
        (["a", "b"], ["a", "b"]),
        ([], []),
    ],
)
def test_short_ids_are_short_and_different(ids: list[str], labels: list[str]) -> None:
    assert [label_ids(ids)[name] for name in ids] == labels
