"""Answers of SQL in the terminal: a table where it fits, else row after row; coordinates to the millimetre."""

import json
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from cli.terminal.answers import print_answer
from tests.unit.lake.small_campaign import commit


def _answer(lake: Path, question: str, *, width: int) -> str:
    console = Console(file=StringIO(), width=width)
    print_answer(console, lake, question, (), as_of=None, as_json=False)
    assert isinstance(console.file, StringIO)
    return console.file.getvalue()


def test_a_wide_answer_is_told_row_after_row_and_cuts_nothing(tmp_path: Path) -> None:
    commit(tmp_path, defects=3)
    narrow = _answer(tmp_path, "worst_defects", width=100)
    assert "row 3 of 3" in narrow and "3 rows" in narrow
    assert "…" not in narrow
    assert max(map(len, narrow.splitlines())) <= 100
    wide = _answer(tmp_path, "worst_defects", width=600)
    assert "row 3 of 3" not in wide and "3 rows" in wide
    for line in narrow.splitlines():
        if line.startswith("defect_id "):
            assert line.split()[1] in wide


def test_coordinates_keep_a_millimetre(tmp_path: Path) -> None:
    commit(tmp_path, defects=1)
    told = _answer(
        tmp_path, "SELECT 8.408103795217519::DOUBLE AS lon_deg, 0.12345678::DOUBLE AS separation_m", width=100
    )
    assert "8.40810380" in told
    assert "0.123457" in told


def test_columns_of_one_name_are_all_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commit(tmp_path, defects=1)
    twice = "SELECT 1 AS a, 2 AS a, 3 AS b, 4 AS a, 5 AS a_1"
    told = _answer(tmp_path, twice, width=100)
    assert [cell.strip() for cell in told.splitlines()[1].split("┃")[1:-1]] == ["a", "a_1", "b", "a_2", "a_1_1"]
    narrow = [line.split() for line in _answer(tmp_path, twice, width=20).splitlines()]
    assert [line for line in narrow if line[0] in ("a", "a_1", "a_2")] == [["a", "1"], ["a_1", "2"], ["a_2", "4"]]
    empty = _answer(
        tmp_path, "SELECT t.track_id, d.* FROM tracks AS t JOIN tracks AS d USING (building_id)", width=2000
    )
    assert "track_id_1" in empty and "0 rows" in empty
    console = Console(file=StringIO())
    print_answer(console, tmp_path, twice, (), as_of=None, as_json=True)
    assert json.loads(capsys.readouterr().out) == [{"a": 1, "a_1": 2, "b": 3, "a_2": 4, "a_1_1": 5}]
