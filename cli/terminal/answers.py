"""Results in the terminal: SQL, the figures of an evaluation, the doctor's checks."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

from facadelake.core.errors import InputDataError, suggest_name
from facadelake.core.tables import list_rows

_CELL_WIDTH = 24  # longer text may wrap in its cell

if TYPE_CHECKING:
    import pyarrow as pa

    from facadelake.doctor import Check
    from facadelake.evaluation.campaigns import CampaignFigures


def show_questions(console: Console) -> None:
    """Print the stored questions with their meaning and parameters."""
    from facadelake.lake import list_questions

    table = RichTable(title="Stored questions: facadelake sql NAME [name=value ...]", title_justify="left")
    for column in ("name", "meaning", "parameters"):
        table.add_column(column)
    for question in list_questions():
        table.add_row(
            question.name,
            escape(question.meaning),
            ", ".join(question.parameters),
        )
    console.print(table)


def print_answer(
    console: Console, lake: Path, question: str, parameters: Sequence[str], *, as_of: int | None, as_json: bool
) -> None:
    """Print the rows of a stored question or a SELECT statement."""
    from facadelake.lake import answer_question as ask_stored
    from facadelake.lake import list_questions, query

    given: dict[str, str] = {}
    for text in parameters:
        name, equals, value = text.partition("=")
        if not equals:
            raise InputDataError(f"parameter '{text}' is not name=value, such as building_id=castle")
        given[name] = value
    if question in {stored.name for stored in list_questions()}:
        answer = ask_stored(lake, question, given, as_of=as_of)
    elif " " not in question.strip():
        names = [stored.name for stored in list_questions()]
        raise InputDataError(
            f"there is no stored question '{question}'{suggest_name(question, names)}; there are {', '.join(names)}, "
            "or write a SELECT statement"
        )
    else:
        answer = query(lake, question, given, as_of=as_of)
    if as_json:
        sys.stdout.write(json.dumps(list_rows(answer), default=str, indent=2) + "\n")
    else:
        _print_rows(console, answer)


def _format_cell(name: str, value: Any) -> str:
    if isinstance(value, float) and name.endswith(("lon_deg", "lat_deg")):
        return f"{value:.8f}"  # a millimetre
    if isinstance(value, float):
        return f"{value:.6g}" if abs(value) < 1000 else f"{value:.3f}"
    if isinstance(value, bytes):
        return f"<{len(value)} bytes>"
    return "" if value is None else escape(str(value))


def _print_rows(console: Console, answer: pa.Table) -> None:
    """Print a table, or one line per column of each row where the terminal is too narrow."""
    rows = [{name: _format_cell(name, value) for name, value in row.items()} for row in list_rows(answer)]
    count = f"{len(rows)} row{'s' if len(rows) != 1 else ''}"
    needed = sum(
        3 + min(_CELL_WIDTH, max(len(text) for text in (name, *(row[name] for row in rows))))
        for name in answer.column_names
    )
    if not rows or needed + 1 <= console.width:
        table = RichTable(caption=count, caption_justify="left")
        for name in answer.column_names:
            table.add_column(name)
        for row in rows:
            table.add_row(*row.values())
        console.print(table)
        return
    names = max(len(name) for name in answer.column_names)
    for number, row in enumerate(rows, start=1):
        console.rule(f"row {number} of {len(rows)}", align="left")
        record = RichTable.grid(padding=(0, 2))
        record.add_column(no_wrap=True, min_width=names)
        record.add_column(overflow="fold")
        for name, text in row.items():
            if text:
                record.add_row(f"[bold]{name}[/bold]", text)
        console.print(record)
    console.print(count)


def show_figures(console: Console, figures: CampaignFigures) -> None:
    """Print the figures of an evaluation, and the paper's Table 2 beside ours."""
    from facadelake.evaluation.campaigns import PAPER_REMARK

    table = RichTable(title="Against truth (no alignment after the run)", title_justify="left")
    for index, name in enumerate(figures.COLUMNS):
        table.add_column(name, justify="left" if index == 0 else "right")
    for row in figures.format_rows():
        table.add_row(*row)
    console.print(table)
    beside = RichTable(
        title="The paper's Table 2 beside ours: MAE / RMSE in cm (the paper's as printed)",
        title_justify="left",
        caption=PAPER_REMARK,
        caption_justify="left",
    )
    for name in ("axis", "paper: round trip", "round trip", "of defects", "observations", "defects"):
        beside.add_column(name, justify="left" if name == "axis" else "right")
    for row in figures.table2.format_rows():
        beside.add_row(*row)
    console.print(beside)


def show_checks(console: Console, checks: Sequence[Check]) -> None:
    """Print the doctor's findings and the remedies."""
    colours = {"ok": "green", "warning": "yellow", "missing": "red"}
    table = RichTable(title="This machine", title_justify="left")
    for column in ("what", "state", "found", "how to get it"):
        table.add_column(column, overflow="fold")
    for check in checks:
        colour = colours[check.status]
        table.add_row(check.name, f"[{colour}]{check.status}[/{colour}]", escape(check.found), escape(check.remedy))
    console.print(table)
