"""Comparisons and explanations in the terminal."""

from __future__ import annotations

from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

from cli.main import app
from cli.terminal.history import show_comparison, show_explanation
from facadelake.reporting.history.comparison import compare_campaigns
from facadelake.reporting.history.explanation import explain_rows
from tests.unit.lake.small_campaign import BUILDING, commit
from tests.unit.reporting.history.painted_history import History


def make_history() -> History:
    history = History(("2025", "2026"))
    history.add("wall-0001", {"2025": "first_seen detected", "2026": "seen detected"})
    history.add("wall-0002", {"2025": "first_seen detected", "2026": "not_imaged hidden"}, storey="[red]attic[/red]")
    history.add("wall-0003", {"2025": "first_seen detected", "2026": "grown detected"})
    history.resize("wall-0003", "2026", length_m=0.6)
    return history


def show(width: int, limit: int) -> str:
    console = Console(file=StringIO(), width=width)
    show_comparison(console, compare_campaigns(make_history().tables, None, None), limit)
    assert isinstance(console.file, StringIO)
    return console.file.getvalue()


def test_the_table_lists_what_needs_attention_and_counts_the_rest() -> None:
    text = show(200, 10)
    assert text.index("wall-0003") < text.index("wall-0002")
    assert "wall-0001" not in text
    assert "[red]attic[/red]" in text  # a name is no markup
    assert "length +20 ± 1 cm" in text
    assert "something before the wall hides its place" in text
    line = next(line for line in text.splitlines() if "detected again" in line)
    assert [cell.strip() for cell in line.strip("\u2502").split("\u2502")][:3] == ["unchanged", "1", "S 1"]
    assert "+1.0 ± 0.2 cm east" in text


def test_a_narrow_terminal_and_a_limit_leave_out_and_say_so() -> None:
    text = show(100, 1)
    assert "something before" not in text
    assert "1 more; --limit 2 shows all" in text


def test_an_explanation_is_printed_by_campaign() -> None:
    console = Console(file=StringIO(), width=200)
    history = make_history()
    history.rows["tracks"][0]["element_name"] = "[bold]lintel"
    show_explanation(console, explain_rows(history.tables, "wall-0003"))
    show_explanation(
        console, explain_rows({**history.tables, "tracks": history.tables["tracks"].slice(0, 1)}, "wall-0001")
    )
    assert isinstance(console.file, StringIO)
    text = console.file.getvalue()
    assert "2025: first seen" in text
    assert "2026: grown" in text
    assert "[bold]lintel" in text


@pytest.mark.parametrize("command", [["compare", BUILDING, "--no-page"], ["why", f"{BUILDING}-0001"]])
def test_without_tracks_the_commands_say_what_to_run(tmp_path: Path, command: list[str]) -> None:
    for campaign in ("2025-04", "2026-04"):
        commit(tmp_path, defects=1, campaign_id=campaign)
    found = CliRunner().invoke(app, [*command, "--lake", str(tmp_path)])
    assert found.exit_code != 0
    assert f"run 'facadelake track {BUILDING}'" in str(found.exception)
