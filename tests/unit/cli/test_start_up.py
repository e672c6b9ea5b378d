"""What a command imports before it prints, its version, its examples, and what mistyped names are answered with."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path

import pytest
import typer

from cli.main import app
from facadelake.core.duckdb_engine import open_duckdb
from facadelake.core.errors import InputDataError, suggest_name
from facadelake.lake import answer_question, query
from facadelake.lake.connect import LAKE_EXTENSIONS
from tests.unit.lake.small_campaign import commit

REPOSITORY = Path(__file__).resolve().parents[3]
RUN = """import sys
from cli.main import main
try:
    main()
finally:
    print("LOADED", *sys.modules, file=sys.stderr)
"""


def run(*arguments: str) -> tuple[str, set[str]]:
    """Standard output of a command, and the modules that it imported."""
    done = subprocess.run([sys.executable, "-c", RUN, *arguments], capture_output=True, text=True, cwd=REPOSITORY)
    assert done.returncode == 0, done.stderr
    return done.stdout, set(done.stderr.split("LOADED")[-1].split())


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("start-up") / "lake"
    commit(folder)
    return folder


def test_version_and_help_import_no_library_of_tables() -> None:
    printed, loaded = run("--version")
    assert printed == f"facadelake {version('facadelake')}\n"
    assert not {"numpy", "pyarrow", "duckdb", "pydantic", "pandas", "prefect"} & loaded
    printed, loaded = run("--help")
    assert "--version" in printed
    assert not {"numpy", "pyarrow", "duckdb", "pydantic", "pandas", "prefect"} & loaded


@pytest.mark.parametrize("arguments", [("campaigns",), ("sql", "worst_defects", "limit=1"), ("defects", "tower")])
def test_queries_import_no_pandas(lake: Path, arguments: tuple[str, ...]) -> None:
    printed, loaded = run(*arguments, "--lake", str(lake))
    assert "tower" in printed
    assert not {"pandas", "geopandas", "prefect", "scipy", "cv2"} & loaded


@pytest.mark.parametrize("arguments", [("campaigns",), ("sql", "worst_defects", "limit=1")])
def test_listings_compute_nothing_in_arrow(lake: Path, arguments: tuple[str, ...]) -> None:
    assert "pyarrow.compute" not in run(*arguments, "--lake", str(lake))[1]  # 0.05 s


def test_an_extension_is_loaded_without_reading_it_whole() -> None:
    """Its signature is verified by ``facadelake doctor``; hashing 70 MB took 0.25 s of every command."""
    before = time.process_time()
    open_duckdb(*LAKE_EXTENSIONS).close()
    assert time.process_time() - before < 0.15  # s


def test_values_are_bound_as_they_are(lake: Path) -> None:
    row = query(
        lake, "SELECT $a AS a, $b + 1 AS b, $c AS c, $d AS d, $limit AS e",
        {"a": "it's; --", "b": 2, "c": 0.1, "d": None, "limit": True},
    ).to_pylist()  # fmt: skip
    assert row == [{"a": "it's; --", "b": 3, "c": 0.1, "d": None, "e": True}]
    spatial = query(lake, "SELECT ST_Area(ST_GeomFromText('POLYGON ((0 0, 2 0, 2 2, 0 0))')) AS area").to_pylist()
    assert spatial == [{"area": 2.0}]


def list_examples() -> list[str]:
    """The command lines in the help of all commands."""
    texts = []
    commands = [("", typer.main.get_command(app))]
    while commands:
        name, command = commands.pop()
        texts += [command.help or "", *(getattr(parameter, "help", None) or "" for parameter in command.params)]
        commands += [(f"{name} {child}", found) for child, found in getattr(command, "commands", {}).items()]
    joined = [re.sub(r"\[/?bold\]|\s+", " ", text) for text in texts]
    return [found for text in joined for found in re.findall(r"Example: (facadelake .+?)\s*$", text)]


def test_the_examples_of_the_help_are_commands_that_parse() -> None:
    examples = list_examples()
    assert len(examples) >= 2
    for example in examples:
        _, *arguments = shlex.split(example)
        command = typer.main.get_command(app)
        while arguments and arguments[0] in getattr(command, "commands", {}):
            command = command.commands[arguments.pop(0)]
        command.make_context(str(command.name), arguments)  # raises for an unknown option or a missing argument


def test_the_example_of_sql_is_answered(lake: Path) -> None:
    (example,) = [text for text in list_examples() if text.startswith("facadelake sql")]
    assert query(lake, shlex.split(example)[2]).num_rows > 0


def test_a_mistyped_name_is_answered_with_the_one_it_resembles(lake: Path) -> None:
    assert suggest_name("Tower", ["tower", "hall"]) == " (did you mean 'tower'?)"
    assert suggest_name("xyz", ["tower", "hall"]) == ""
    with pytest.raises(InputDataError, match=r"no question worst_defect \(did you mean 'worst_defects'\?\); there are"):
        answer_question(lake, "worst_defect")
    done = subprocess.run(
        [sys.executable, "-c", RUN, "defects", "tower", "2026-4", "--lake", str(lake)],
        capture_output=True, text=True, cwd=REPOSITORY,
    )  # fmt: skip
    assert "has no campaign '2026-4' of building 'tower' (did you mean '2026-04'?); it has 2026-04" in done.stderr
    done = subprocess.run([sys.executable, "-c", RUN, "campagns"], capture_output=True, text=True, cwd=REPOSITORY)
    assert "campaigns" in done.stderr
