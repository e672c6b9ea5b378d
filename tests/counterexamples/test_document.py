"""docs/bad-input.md says nothing that no test checks; most are the counterexamples beside this file."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

HERE = Path(__file__).parent
DOCUMENT = HERE.parents[1] / "docs" / "bad-input.md"
ANY = "…"
GAP = "\0"  # what a test computes, such as a path; no message runs across it


def spoken(node: ast.AST, names: Mapping[str, str]) -> str:
    """The text that an expression makes of string constants and of the module's own named ones."""
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.Name(id=name):
            return names.get(name, GAP)
        case ast.JoinedStr(values=parts):
            return "".join(spoken(part, names) for part in parts)
        case ast.FormattedValue(value=value):
            return spoken(value, names)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return spoken(left, names) + spoken(right, names)
    return GAP


def texts_of(module: Path) -> Iterator[str]:
    """Every text that the module's tests may compare a message with."""
    tree = ast.parse(module.read_text("utf-8"))
    names: dict[str, str] = {}
    for statement in tree.body:
        if isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name):
            names[statement.targets[0].id] = spoken(statement.value, names)
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant | ast.JoinedStr | ast.BinOp):
            yield spoken(node, names)


TEXTS = [
    text
    for module in sorted(HERE.parent.rglob("test_*.py"))
    if module.name != Path(__file__).name
    for text in texts_of(module)
]
ROWS = [
    [cell.strip() for cell in line.strip("| \n").split(" | ")]
    for line in DOCUMENT.read_text("utf-8").splitlines()
    if line.startswith("| ") and not line.startswith("| Input ")
]


def test_the_table_has_every_kind_of_input() -> None:
    assert len(ROWS) > 60
    assert all(len(row) == 3 for row in ROWS)


@pytest.mark.parametrize(("given", "message"), [(row[0], row[2]) for row in ROWS if row[2] != "(none)"])
def test_each_message_is_one_that_a_test_expects(given: str, message: str) -> None:
    parts = [part.strip() for part in message.split(ANY) if part.strip(" :;,")]
    assert parts
    for part in parts:
        assert any(part in text for text in TEXTS), f"{given}: no test expects {part!r}"
