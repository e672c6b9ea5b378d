"""The import contracts refuse what they forbid: imports planted in a copy of the checkout, one or more a contract."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]

# (contract, importing module, line to plant, what the report names)
PLANTED = [
    ("cli -> flows -> tasks -> facadelake -> schemas", "facadelake.lake.read", "import tasks.job", "facadelake is not"),
    ("cli -> flows -> tasks -> facadelake -> schemas", "tasks.job", "import flows.inspect_building", "tasks is not"),
    ("cli -> flows -> tasks -> facadelake -> schemas", "flows.inspect_building", "import cli.options", "flows is not"),
    ("cli -> flows -> tasks -> facadelake -> schemas", "schemas.columns", "import facadelake.lake", "schemas is not"),
    *(
        (
            "Inside the domain: every package in its layer",
            f"facadelake.{lower}",
            f"import facadelake.{higher}",
            f"facadelake.{lower.split('.')[0]} is not allowed to import facadelake.{higher}",
        )
        for lower, higher in [
            ("building.model", "evaluation"),
            ("registration.observe", "evaluation"),
            ("lake.read", "evaluation"),
            ("detection.campaign", "lake"),
            ("photos.exif", "building"),
            ("sfm.pairing", "georeferencing"),
            ("deduplication.merge", "reporting"),
            ("measurement.crack", "reviews"),
            ("core.frames", "registry"),
            ("severity.rule_packs", "demo"),
            ("integrity.views", "campaigns"),
        ]
    ),
    ("Inside the domain: every package in its layer", "facadelake.somewhere", "import numpy", "somewhere"),
    (
        "No circles inside packages",
        "facadelake.core.frames",
        "import facadelake.core.pose_table",
        "No cycles are allowed in facadelake.core.",
    ),
    (
        "No circles inside packages",
        "facadelake.registration.rays",
        "import facadelake.registration.observation",
        "No cycles are allowed in facadelake.registration.",
    ),
    (
        "No circles inside packages",
        "facadelake.georeferencing.initial_placement",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import facadelake.georeferencing.georeference",
        "No cycles are allowed in facadelake.georeferencing.",
    ),
    (
        "A package is entered through its face",
        "tasks.ingest",
        "from facadelake.photos.exif import read_exif",
        "tasks.ingest -> facadelake.photos.exif",
    ),
    (
        "A package is entered through its face",
        "facadelake.lake.commit",
        "from facadelake.lake import query",
        "facadelake.lake.commit -> facadelake.lake",
    ),
    (
        "A package is entered through its face",
        "facadelake.registration.rays",
        "from facadelake import read_table",
        "facadelake.registration.rays -> facadelake (",
    ),
    (
        "A package is entered through its face",
        "facadelake.deduplication.merge",
        "from facadelake.building import ifc",
        "facadelake.deduplication.merge -> facadelake.building.ifc (",
    ),
    (
        "Tasks know no picture but the report, no evaluation, no review, no demo",
        "tasks.draw",
        "import facadelake.evaluation",
        "tasks is not allowed to import facadelake.evaluation",
    ),
    (
        "The lake and what is published see tables alone",
        "facadelake.publish.geopackage",
        "import facadelake.building",
        "facadelake.publish is not allowed to import facadelake.building",
    ),
    (
        "Registration and deduplication know no photograph's metadata",
        "facadelake.registration.raycast",
        "import facadelake.photos",
        "facadelake.registration is not allowed to import facadelake.photos",
    ),
    (
        "Flows hold flows: of the domain they see the portfolio, the checks before a run and the versions of code",
        "flows.inspect_portfolio",
        "import facadelake.registration",
        "flows is not allowed to import facadelake.registration",
    ),
    (
        "Only the lake and the engine below it import duckdb",
        "facadelake.publish.readme",
        "import duckdb",
        "facadelake is not allowed to import duckdb",
    ),
    (
        "pycolmap works in a process of its own: only the worker imports it",
        "facadelake.sfm.pairing",
        "import pycolmap",
        "facadelake is not allowed to import pycolmap",
    ),
    (
        "The product does not need what trained its detector",
        "facadelake.detection.boxes",
        "import torch",
        "facadelake is not allowed to import torch",
    ),
    (
        "The domain knows no Prefect, and no terminal",
        "facadelake.core.progress",
        "import prefect",
        "facadelake is not allowed to import prefect",
    ),
]  # fmt: skip


def contracts() -> list[str]:
    config = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())
    return [contract["name"] for contract in config["tool"]["importlinter"]["contracts"]]


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> str:
    """What lint-imports says of a copy with all of PLANTED in it, on one line."""
    root = tmp_path_factory.mktemp("checkout")
    shutil.copy(REPOSITORY / "pyproject.toml", root)
    for name in ("cli", "flows", "tasks", "facadelake", "schemas", "scripts"):
        shutil.copytree(REPOSITORY / name, root / name, ignore=shutil.ignore_patterns("__pycache__"))
    for _, module, line, _ in PLANTED:
        path = root / f"{module.replace('.', '/')}.py"
        path.write_text(f"{path.read_text() if path.exists() else ''}\n{line}\n")
    command = [sys.executable, "-c", "from importlinter.cli import lint_imports_command; lint_imports_command()"]
    done = subprocess.run([*command, "--no-cache", "--no-logo"], cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stdout + done.stderr
    return " ".join(done.stdout.split())


def test_every_contract_has_a_planted_import() -> None:
    assert {contract for contract, *_ in PLANTED} == set(contracts())


@pytest.mark.parametrize(
    ("contract", "module", "named"),
    [(contract, module, named) for contract, module, _, named in PLANTED],
    ids=[f"{module}: {contract}" for contract, module, *_ in PLANTED],
)
def test_planted_imports_are_refused(contract: str, module: str, named: str, report: str) -> None:
    assert f"{contract} BROKEN" in report
    assert named in report, module


def test_all_packages_at_the_top_are_looked_at() -> None:
    config = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["importlinter"]
    beside = {"benchmarks", "scripts", "tests", "training"}  # not of the product
    packages = {path.parent.name for path in REPOSITORY.glob("*/__init__.py")} - beside
    assert packages == set(config["root_packages"])


@pytest.mark.parametrize(
    "text",
    [
        "import importlib\n\nX = importlib.import_module('facadelake.evaluation.campaigns')",
        "from importlib import import_module as m\n\nX = m('facadelake.evaluation.campaigns')",
        "import runpy\n\nX = runpy.run_module('facadelake.evaluation.campaigns')",
        "import pkgutil\n\nX = pkgutil.resolve_name('facadelake.evaluation.campaigns')",
    ],
)
@pytest.mark.parametrize("package", ["cli", "facadelake/registration", "schemas"])
def test_imports_that_the_contracts_cannot_see_are_refused(package: str, text: str) -> None:
    """The linter refuses what loads a module by a text."""
    command = [sys.executable, "-m", "ruff", "check", "--stdin-filename", f"{package}/planted.py", "-"]
    done = subprocess.run(
        command, cwd=REPOSITORY, input=f'"""Planted."""\n\n{text}\n', capture_output=True, text=True, check=False
    )
    assert done.returncode == 1 and "TID251" in done.stdout, done.stdout
