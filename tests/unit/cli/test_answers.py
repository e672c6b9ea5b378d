"""Answers of SQL in the terminal: a table where it fits, else row after row; coordinates to the millimetre."""

from io import StringIO
from pathlib import Path

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
