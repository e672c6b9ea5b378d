"""docs/finding-your-way.md names files and functions that exist, and the layers of the contract."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
DOCUMENT = (REPOSITORY / "docs" / "finding-your-way.md").read_text(encoding="utf-8")
QUESTIONS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in DOCUMENT.splitlines()
    if re.match(r"\| \d+\. ", line)
]


def _find_files(cell: str) -> list[Path]:
    """The files of a cell; one without its folder is beside, or in the package of, the first."""
    files: list[Path] = []
    for name in re.findall(r"`([^`]+)`", cell):
        folders = [REPOSITORY, *(files[0].parents if files else ())]
        found = [path for folder in folders if folder.is_relative_to(REPOSITORY) for path in folder.glob(name)]
        assert found, f"{name} does not exist"
        files += found[:1]
    return files


def _list_definitions(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    named = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    return named | {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}


def test_there_are_twelve_questions_or_more() -> None:
    assert len(QUESTIONS) >= 12


@pytest.mark.parametrize("row", QUESTIONS, ids=lambda row: row[0][:40])
def test_the_answer_exists(row: list[str]) -> None:
    definitions = set().union(*(_list_definitions(path) for path in _find_files(row[1]) if path.suffix == ".py"))
    for name in re.findall(r"`([^`]+)`", row[2]):
        assert set(name.split(".")) <= definitions, name


def test_the_layers_are_those_of_the_contract() -> None:
    settings = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    contract = next(
        one for one in settings["tool"]["importlinter"]["contracts"] if one["type"] == "layers" and "containers" in one
    )
    layers = [set(re.findall(r"\w+", layer)) for layer in reversed(contract["layers"])]
    rows = re.findall(r"^\| \d+ \| ([^|]+) \|", DOCUMENT, re.MULTILINE)
    assert [set(re.findall(r"`(\w+)`", row)) for row in rows] == layers
