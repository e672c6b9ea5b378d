from __future__ import annotations

import re
from dataclasses import replace
from html import unescape
from pathlib import Path
from urllib.parse import unquote

import pytest

from facadelake.reporting.history.comparison import BuildingComparison, compare_campaigns
from facadelake.reporting.history.draw import create_request, create_track_marks, find_release
from facadelake.reporting.history.elevations import draw_elevation_pictures
from facadelake.reporting.history.findings import STYLES, Finding
from facadelake.reporting.history.page import ComparisonPictures, write_page
from facadelake.reporting.history.pairs import PosedPhotographs, write_pairs
from facadelake.reporting.history.since_last_time import SinceLastTime, describe_since_last_time
from facadelake.reporting.inspection import PictureSettings
from tests.unit.reporting.history.painted_history import History
from tests.unit.reporting.painted_wall import NASTY_NAME, PaintedWall
from tests.unit.reporting.test_report import Page, read

SIZES = {"2025": (0.4, 0.2), "2026": (0.8, 0.2)}


def make_history() -> History:
    history = History()
    history.add("wall-0001", {"2025": "first_seen detected", "2026": "seen detected"}, (1.0, 1.0))
    history.add("wall-0002", {"2025": "first_seen detected", "2026": "grown detected"}, (3.0, 2.0))
    history.add("wall-0003", {"2025": "first_seen detected", "2026": "repaired looks_repaired"}, (5.0, 2.0))
    history.add("wall-0004", {"2026": "new detected"}, (6.0, 3.0), defect_class="moisture")
    history.resize("wall-0002", "2026", length_m=0.8)
    history.change("wall-0002", "2026", state_remark=NASTY_NAME)
    history.look("wall-0003", "2026", "2025", "gone")
    return history


def make_comparison() -> BuildingComparison:
    return compare_campaigns(make_history().tables, None, None)


def make_sources(painted: PaintedWall, later: Path | None = None) -> tuple[PosedPhotographs, PosedPhotographs]:
    earlier = PosedPhotographs(campaign_id="2025", posed=painted.posed, root=painted.root)
    return earlier, replace(earlier, campaign_id="2026", root=later or painted.root)


def write(painted: PaintedWall, folder: Path, shown_max: int = 10, later: Path | None = None) -> Path:
    comparison, sources = make_comparison(), make_sources(painted, later)
    origin, tracks = painted.building.origin, comparison.tracks
    marks = create_track_marks([track.place for track in tracks], [track.track_id for track in tracks], origin)
    elevations = draw_elevation_pictures(
        painted.building, painted.surface, sources[1], list(marks.values()), folder / "elevations",
        PictureSettings(cell_m=0.03),
    )  # fmt: skip
    requests = [create_request(track, comparison, marks[track.track_id]) for track in comparison.listed[:shown_max]]
    pictures = ComparisonPictures(
        elevations=elevations,
        pairs=write_pairs(requests, *sources, painted.surface, folder / "pairs", 150),
        cards={("2025", "wall-0002-in-2025"): "../card <1>.png"},
        shown_max=shown_max,
    )
    return write_page(comparison, pictures, NASTY_NAME, folder)


@pytest.fixture(scope="module")
def page_path(painted: PaintedWall, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(painted, tmp_path_factory.mktemp("page"))


def test_the_page_loads_nothing_from_elsewhere_and_escapes_names(page_path: Path) -> None:
    source, page = page_path.read_text(encoding="utf-8"), read(page_path)
    assert not re.search(r"(https?:)?//", source)
    assert "url(" not in source
    assert "@import" not in source
    assert not {"link", "iframe", "object"} & set(page.tags)
    assert page.tags.count("script") == 1  # the slider; names are not tags
    assert NASTY_NAME in page.text
    files = [link for link in page.links if not link.startswith("#") and "card" not in link]
    assert len(files) > 8
    assert all((page_path.parent / unquote(link)).is_file() for link in files)


def test_counts_and_states_are_those_of_the_tables(page_path: Path) -> None:
    page = read(page_path)
    text = re.sub(r"\s+", " ", page.text)
    assert "4defects in 2025 or 2026" in text
    source = page_path.read_text(encoding="utf-8")
    assert re.findall(r'<article id="track-(wall-\d+)" class="f-(\w+)"', source) == [
        ("wall-0002", "grown"), ("wall-0004", "new"), ("wall-0003", "repaired"),
    ]  # fmt: skip
    assert "1 unchanged defect (or still repaired) are counted, not listed" in text
    assert "length +40 ± 2 cm" in text
    assert "+1.0 ± 0.3 cm east" in text  # 2 cm less 1 cm
    assert "All offsets here are of 2026 from 2025." in text
    assert "nine defects agree" not in text  # the sentences of both campaigns are of their offsets from the first one


def test_each_mark_on_the_elevation_has_shape_colour_place_and_link(page_path: Path) -> None:
    source = page_path.read_text(encoding="utf-8")
    svg = source.split('<figure class="elevation">')[1].split("</figure>")[0]
    width = int(re.search(r'<image [^>]*width="(\d+)"', svg).group(1))  # type: ignore[union-attr]
    marks = re.findall(r'<g class="f-(\w+)" transform="translate\(([\d.]+) [\d.]+\)', svg)
    at = {name: float(x) for name, x in marks}
    assert set(at) == {"grown", "new", "repaired", "unchanged"}
    px_per_m = width / 9.0  # the wall is 8 m wide, its view half a metre wider on each side
    for name, x_m in (("unchanged", 1.0), ("grown", 3.0), ("repaired", 5.0), ("new", 6.0)):
        assert at[name] == pytest.approx((x_m + 0.5) * px_per_m, rel=0, abs=3)  # px
        assert f'href="#mark-{name}" class="ink"' in svg
        assert f'id="mark-{name}"' in source
    assert '<a href="#track-wall-0002">' in svg
    assert "wall-0001: unchanged" in svg  # as a title; it has no label and no link
    assert "#track-wall-0001" not in source


def test_a_sign_has_the_colour_of_its_own_state(page_path: Path) -> None:
    """The first state in the timeline of a repaired defect was drawn in the colour of repairs."""
    source = page_path.read_text(encoding="utf-8")
    assert " .ink { fill: var(--mark); stroke: var(--mark); }" in source  # of the nearest finding around it
    assert not re.search(r"\.f-\w+ \.ink", source)
    for finding, style in STYLES.items():
        assert f".f-{finding.name.lower()} {{ --mark: {style.colour}; }}" in source


def test_boxes_hide_rows_of_the_list_too(page_path: Path) -> None:
    source = page_path.read_text(encoding="utf-8")
    assert "body:has(#show-grown:not(:checked)) #list tr:has(svg.f-grown)" in source
    assert '<section id="list"' in source


def test_links_lead_to_cards_and_anchors_exist(page_path: Path) -> None:
    page, source = read(page_path), page_path.read_text(encoding="utf-8")
    assert "../card <1>.png" in page.links
    anchors = {link[1:] for link in page.links if link.startswith("#") and not link.startswith("#mark-")}
    assert all(f'id="{name}"' in source for name in anchors)


def test_the_slider_is_an_input_and_has_a_name(page_path: Path) -> None:
    source = unescape(page_path.read_text(encoding="utf-8"))
    sliders = re.findall(r'<input type="range"[^>]*>', source)
    assert len(sliders) == 3
    assert all("aria-label" in slider for slider in sliders)
    assert "html:not(.scripted)" in source  # without scripts both pictures stand side by side


def test_omitted_pairs_are_told_and_not_drawn(painted: PaintedWall, tmp_path: Path) -> None:
    page = read(write(painted, tmp_path, shown_max=1))
    assert (
        "Pairs of 1 of 3 listed defects are shown, those that matter most; 2 are omitted to limit the size of the page."
    ) in page.text
    assert {path.name.split("_")[0] for path in (tmp_path / "pairs").iterdir()} == {"wall-0002"}
    assert "#track-wall-0003" not in page.links


def test_missing_photographs_are_told_for_each_pair(painted: PaintedWall, tmp_path: Path) -> None:
    page: Page = read(write(painted, tmp_path, later=tmp_path / "gone"))
    assert page.text.count("no picture of 2026") == 3
    assert len(list((tmp_path / "pairs").glob("*_before.jpg"))) == 3
    assert not list((tmp_path / "pairs").glob("*_after.jpg"))


def test_the_report_tells_what_happened_since_last_time(painted: PaintedWall, tmp_path: Path) -> None:
    since = SinceLastTime(comparison=make_comparison(), photographs=make_sources(painted), page="../x.html")
    parts = describe_since_last_time(since, painted.surface, painted.building.origin, tmp_path)
    source = "".join(part.text for part in parts)
    page = Page()
    page.feed(source)
    assert "new" in page.text and "repaired" in page.text
    assert re.findall(r"wall-\d{4}(?=</span>)", source) == ["wall-0002", "wall-0004", "wall-0003"]
    assert "<script" not in source
    assert "../x.html" in page.links
    pictures = [link for link in page.links if link.endswith(".jpg")]
    assert len(set(pictures)) == 6
    assert all((tmp_path / link).is_file() for link in pictures)
    assert Finding.UNCHANGED in {track.finding for track in since.comparison.tracks} if since.comparison else False


def test_a_first_campaign_has_one_sentence(painted: PaintedWall, tmp_path: Path) -> None:
    since = SinceLastTime(comparison=None, remark="This is the first campaign of the building in the lake.")
    parts = describe_since_last_time(since, painted.surface, painted.building.origin, tmp_path)
    assert [part.text for part in parts] == ["<p>This is the first campaign of the building in the lake.</p>"]


def test_the_release_of_a_version_is_the_newest_one_up_to_it(tmp_path: Path) -> None:
    for version in (3, 7, 11):
        (tmp_path / "published" / "wall" / "2025" / f"v{version:06d}").mkdir(parents=True)
    (tmp_path / "published" / "wall" / "2025" / "latest").mkdir()
    found = [find_release(tmp_path, "wall", "2025", version) for version in (None, 10, 2)]
    assert [path.name if path else None for path in found] == ["v000011", "v000007", None]
    assert find_release(tmp_path, "wall", "2026", None) is None
