"""A stage whose code is edited while it runs stores nothing: the result would stand under the other code's key."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from facadelake.core.checkout import CHECKOUT

# Code A is in memory; the file is edited before the stage or while it computes; the next run has code B.
RUN = """
import sys, types
from pathlib import Path

root, lake, edited, when = Path(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:]
sys.path.insert(0, str(root))
import facadelake
from facadelake.core.cache import open_stage_cache
from facadelake.core.code_version import compute_code_version
from facadelake.core.errors import CodeVersionError
from tasks.stage import run_stage

assert Path(facadelake.__file__).is_relative_to(root)
compute_code_version("tasks.measure")  # as a flow does when it is imported

def edit():
    with (root / edited).open("a") as file:
        file.write("# edited" + chr(10))

def make(folder):
    (folder / "result.txt").write_text("code " + ("B" if when == "never" else "A"))
    if when == "during":
        edit()
    return {"things": 1}

make.__module__ = "tasks.measure"
if when == "before":
    edit()
job = types.SimpleNamespace(cache=open_stage_cache(lake), building=types.SimpleNamespace(id="b"))
try:
    result = run_stage(job, "measure", reads={}, inputs={}, make=make)
    print("hit" if result.hit else "made", (result.folder / "result.txt").read_text())
except CodeVersionError as error:
    print("refused", error)
"""


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("checkout")
    for name in ("facadelake", "tasks", "schemas", "sql", "data"):
        shutil.copytree(CHECKOUT / name, root / name, ignore=shutil.ignore_patterns("__pycache__", "*.onnx"))
    return root


@pytest.mark.parametrize("when", ["before", "during"])
def test_a_result_of_mixed_code_is_not_stored(when: str, checkout: Path, tmp_path: Path) -> None:
    edited = "facadelake/measurement/width.py"

    def run(time: str) -> str:
        command = [sys.executable, "-c", RUN, str(checkout), str(tmp_path), edited, time]
        return subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path).stdout

    refused = run(when)
    assert refused.startswith(f"refused {edited} changed while Facadelake was running") and "run the command" in refused
    assert list(tmp_path.glob("cache/*/*/*.json")) == []
    assert run("never") == "made code B\n"
    assert run("never") == "hit code B\n"
