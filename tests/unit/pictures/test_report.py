from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import cv2
import pytest

from facadelake.pictures.crops import defect_crops
from facadelake.pictures.inspection import PictureSettings
from facadelake.pictures.overlays import photo_overlays
from facadelake.pictures.palette import short_ids
from facadelake.pictures.report import write_report
from tests.unit.pictures.painted_wall import NASTY_NAME, Painted, defect_row, inspection_of

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


def test_the_report_loads_nothing_from_elsewhere_and_escapes_names(painted: Painted, tmp_path: Path) -> None:
    defects = [
        defect_row("D1", 2.0, 1.0),
        defect_row("D2", 3.0, 2.0, severity="high"),
        defect_row("D3", 4.0, 2.0, severity="low"),
    ]
    inspection = inspection_of(painted, defects, ["D1", "D2"])
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


def test_defects_stand_worst_first_with_their_crops(painted: Painted, tmp_path: Path) -> None:
    defects = [
        defect_row("D1", 2.0, 1.0),
        defect_row("D2", 3.0, 2.0, severity="high"),
        defect_row("D3", 4.0, 2.0, severity="low"),
    ]
    path = write_report(inspection_of(painted, defects, ["D1", "D2"]), painted.surface, tmp_path, COARSE)
    table = path.read_text(encoding="utf-8").split('id="defects"')[1].split("</section>")[0]
    assert re.findall(r'<b title="(D\d)">', table) == ["D2", "D3", "D1"]
    assert table.count('class="crop"') == 2
    assert table.count("no picture") == 1


def test_a_campaign_without_defects_has_a_report(painted: Painted, tmp_path: Path) -> None:
    page = read(write_report(inspection_of(painted, [], []), painted.surface, tmp_path, COARSE))
    assert "0defects" in page.text
    assert (tmp_path / "plan.png").stat().st_size > 5000
    assert (tmp_path / "distribution.png").stat().st_size > 2000


def test_a_crop_shows_the_box_it_was_cut_for(painted: Painted, tmp_path: Path) -> None:
    inspection = inspection_of(painted, [defect_row("D1", 2.0, 1.0)], ["D1"])
    crop = cv2.imread(str(defect_crops(inspection, tmp_path, PictureSettings(thumbnail_px=128))["D1"]))
    photograph = cv2.imread(str(painted.root / "a.png"))
    box = inspection.detections.to_pylist()[0]
    side = int(40 * (1 + 2 * 1.1))
    left, top = int(box["box_x_px"] + 20 - side / 2), int(box["box_y_px"] + 10 - side / 2)
    piece = cv2.resize(photograph[top : top + side, left : left + side], (128, 128), interpolation=cv2.INTER_CUBIC)
    difference = cv2.absdiff(crop, piece).max(axis=2)
    assert 0.75 < (difference < 25).mean() < 1.0  # the same but for the box drawn on it and JPEG


def test_overlays_show_posed_and_unposed_photographs(
    painted: Painted, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    from dataclasses import replace

    inspection = inspection_of(painted, [defect_row("D1", 2.0, 1.0)], ["D1"])
    inspection = replace(inspection, posed={"a.png": painted.posed["a.png"]})
    paths = photo_overlays(inspection, painted.surface, ["a.png", "b.png", "gone.png"], tmp_path, COARSE)
    assert [path.name for path in paths] == ["overlay_a.jpg", "overlay_b.jpg"]
    posed, unposed = (cv2.imread(str(path)).astype(int) for path in paths)
    assert posed.shape == unposed.shape == (350, 500, 3)
    cyan = [((p[30:, :, 0] > 200) & (p[30:, :, 1] > 200) & (p[30:, :, 2] < 90)).sum() for p in (posed, unposed)]
    assert cyan[0] > 200  # pixels of the model's edges
    assert cyan[1] < 20
    assert "gone.png cannot be decoded" in caplog.text


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
    assert [short_ids(ids)[name] for name in ids] == labels
