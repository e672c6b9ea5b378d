from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from facadelake.core.errors import InputDataError
from facadelake.reporting.inspection import Inspection, PictureSettings
from facadelake.reporting.pictures import (
    PictureSelection,
    draw_selection,
    select_all,
    select_by_name,
    select_report_pictures,
)
from tests.unit.reporting.painted_wall import NASTY_NAME, PaintedWall, make_defect_row, make_inspection

SETTINGS = PictureSettings(cell_m=0.05, overlay_width_px=300, report_cards=1, report_overlays=1)
IDS = ["wall-2026-D0007", "wall-2026-D0012"]


@pytest.fixture
def two(painted: PaintedWall) -> Inspection:
    rows = [
        make_defect_row(IDS[0], 2.0, 1.0),
        make_defect_row(IDS[1], 3.0, 2.0, severity="severe", severity_rule="extent_v1"),
    ]
    return make_inspection(painted, rows, IDS)


def select(painted: PaintedWall, inspection: Inspection, **names: list[str]) -> PictureSelection:
    given = {"defects": [], "facades": [], "photos": [], **names}
    return select_by_name(inspection, painted.surface, settings=SETTINGS, **given)


@pytest.mark.parametrize(
    ("kind", "word", "found"),
    [
        ("defects", "wall-2026-D0012", IDS[1]),
        ("defects", "12", IDS[1]),
        ("defects", "d0007", IDS[0]),
        ("facades", "south", "S"),
        ("facades", "S", "S"),
        ("photos", "a.png", "a.png"),
        ("photos", "B", "b.png"),
    ],
)
def test_names_as_people_write_them(painted: PaintedWall, two: Inspection, kind: str, word: str, found: str) -> None:
    wanted = select(painted, two, **{kind: [word]})
    assert (*wanted.defect_ids, *wanted.facades, *wanted.photo_ids) == (found,)
    assert not wanted.distribution


@pytest.mark.parametrize(
    ("kind", "word", "message"),
    [
        ("defects", "D0013", "defect 'D0013'.*similar names: .*wall-2026-D0012"),
        ("facades", "sout", "facade 'sout'.*similar names: S"),
        ("photos", "c.png", r"photograph: 'c.png' .*similar names: .*[ab]\.png"),
        ("photos", "zzzzzzz", r"photograph: 'zzzzzzz' .*similar names: a.png.*\(of 3\)"),
    ],
)
def test_an_unknown_name_is_refused_with_similar_ones(
    painted: PaintedWall, two: Inspection, kind: str, word: str, message: str
) -> None:
    with pytest.raises(InputDataError, match=message):
        select(painted, two, **{kind: [word]})
    with pytest.raises(InputDataError, match="the campaign has none"):
        select(painted, make_inspection(painted, [], []), defects=["1"])


def test_selected_pictures_are_written_and_overwritten(painted: PaintedWall, two: Inspection, tmp_path: Path) -> None:
    wanted = select_all(two, painted.surface, SETTINGS)
    assert wanted == PictureSelection(
        defect_ids=tuple(IDS), facades=("S",), photo_ids=("a.png", "b.png"), distribution=True
    )
    drawn = draw_selection(two, painted.surface, wanted, tmp_path, SETTINGS)
    assert drawn.missing == ()
    names = [
        "distribution.png", "distribution.csv", "elevations/elevation_S.png", "cards/card_7.png",
        "cards/card_12.png", "overlays/overlay_a.jpg", "overlays/overlay_b.jpg",
    ]  # fmt: skip
    assert [path.relative_to(tmp_path).as_posix() for path in drawn.paths] == names
    card = tmp_path / "cards" / "card_7.png"
    first = card.read_bytes()
    card.write_bytes(b"half a file")  # as a run that was killed leaves it
    few = PictureSelection(defect_ids=(IDS[0],), facades=("S",))
    assert draw_selection(two, painted.surface, few, tmp_path, SETTINGS).paths[-1] == card
    assert card.read_bytes() == first


def test_missing_photographs_are_listed(painted: PaintedWall, two: Inspection, tmp_path: Path) -> None:
    elsewhere = tmp_path / "photographs"
    elsewhere.mkdir()
    (elsewhere / "b.png").write_bytes((painted.root / "b.png").read_bytes())
    moved = replace(two, photographs_root=elsewhere)
    wanted = PictureSelection(defect_ids=tuple(IDS), photo_ids=("a.png", "b.png"))
    drawn = draw_selection(moved, painted.surface, wanted, tmp_path / "out", SETTINGS)
    assert drawn.missing == ("a.png",)
    assert [path.name for path in drawn.paths] == ["card_7.png", "card_12.png", "overlay_b.jpg"]


def test_without_names_the_pictures_of_the_report_are_selected(painted: PaintedWall, two: Inspection) -> None:
    wanted = select_report_pictures(two, painted.surface, SETTINGS)
    assert wanted == PictureSelection(defect_ids=(IDS[1],), facades=("S",), photo_ids=("a.png",), distribution=True)
    assert NASTY_NAME not in wanted.photo_ids
