"""A stage's key covers all the code that computes its result: a change planted in a copy of the checkout changes it."""

from __future__ import annotations

import os
import shutil
from importlib import metadata
from pathlib import Path

import pytest

from facadelake.core import code_version as module
from facadelake.core.checkout import CHECKOUT
from facadelake.core.code_version import compute_code_version, require_unchanged_code
from facadelake.core.errors import CodeVersionError

FOLDERS = ("cli", "facadelake", "flows", "tasks", "schemas", "sql", "data")
STAGES = (
    "detect", "draw", "georeference", "import_detections", "import_poses", "ingest", "load_model", "measure",
    "measure_coverage", "merge", "reconstruct", "register", "track", "validate", "verify_model", "without_model",
)  # fmt: skip

# What is changed, and the stages whose results depend on it: (kind, file, stages).
PLANTED = [
    *(("task", f"tasks/{stage}.py", [stage]) for stage in STAGES),
    ("what all tasks share", "tasks/stage.py", STAGES),
    ("vocabulary", "schemas/vocabulary.py", STAGES),
    ("columns", "schemas/columns.py", STAGES),
    ("environment of all", "facadelake/core/environment.py", STAGES),
    ("how the worker is run", "facadelake/sfm/worker_process.py", ["reconstruct"]),
    ("the worker, named by a string", "facadelake/sfm/worker/mapping.py", ["reconstruct"]),
    ("the job of the worker", "facadelake/sfm/reconstruction_job.py", ["reconstruct"]),
    ("deep import", "facadelake/building/model_georeference/map_placement.py", ["load_model"]),
    (
        "deep import",
        "facadelake/core/proj/operations.py",
        ["load_model", "georeference", "merge", "draw"],
    ),
    ("deep import", "facadelake/registration/rays.py", ["register", "merge"]),
    ("deep import", "facadelake/photos/xmp.py", ["ingest"]),
    ("deep import", "facadelake/measurement/width.py", ["measure"]),
    ("deep import", "facadelake/detection/layouts/output_reader.py", ["detect"]),
    ("deep import", "facadelake/detection/coco/mask.py", ["import_detections"]),
    ("deep import", "facadelake/georeferencing/imported/colmap.py", ["import_poses"]),
    ("deep import", "facadelake/sfm/free_space.py", ["verify_model", "without_model"]),
    ("deep import", "facadelake/measurement/blur_map.py", ["measure_coverage"]),
    ("SQL check", "sql/checks/covariances_of_poses.sql", ["validate"]),
    ("rule pack", "data/severity/bre251_v1.sql", ["merge", "track"]),
]
# What only draws, prints, evaluates, reviews or demonstrates, and the stages whose keys must not change with it.
COMPUTING = tuple(stage for stage in STAGES if stage != "draw")
UNRELATED = [
    ("picture", "facadelake/reporting/elevations/elevation.py", COMPUTING),
    ("report", "facadelake/reporting/page/report.py", COMPUTING),
    ("terminal", "cli/terminal/inspection.py", STAGES),
    ("command line", "cli/main.py", STAGES),
    ("the flow itself", "flows/inspect_building.py", STAGES),
    ("evaluation", "facadelake/evaluation/campaigns/comparison.py", STAGES),
    ("reviews", "facadelake/reviews/review.py", STAGES),
    ("demo", "facadelake/demo/generate.py", STAGES),
    ("publishing", "facadelake/publish/geopackage.py", STAGES),
    ("question", "sql/questions/passport.sql", STAGES),
    ("placing a block", "facadelake/georeferencing/initial_placement.py", ["reconstruct", "ingest", "load_model"]),
    ("merging", "facadelake/deduplication/merge.py", ["register", "georeference", "reconstruct"]),
    ("the portfolio's model", "data/detector/facadelake-nano.card.yaml", STAGES),
    ("a note beside the code", "facadelake/sfm/NOTES.txt", STAGES),
]


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the checkout's code."""
    root = tmp_path_factory.mktemp("checkout")
    for name in FOLDERS:
        shutil.copytree(CHECKOUT / name, root / name, ignore=shutil.ignore_patterns("__pycache__", "*.onnx"))
    return root


def forget_sources() -> None:
    """As in a new process."""
    for cached in (module._compute_version, module._collect_first_closure, module._read_source, module.list_packages):
        cached.cache_clear()


def sha256(stage: str, root: Path) -> str:
    forget_sources()
    return compute_code_version(f"tasks.{stage}", root).sha256


@pytest.fixture(scope="module")
def before(copied: Path) -> dict[str, str]:
    return {stage: sha256(stage, copied) for stage in STAGES}


def plant(path: Path) -> str | None:
    """Change a file; returns what it held."""
    held = path.read_text() if path.exists() else None
    comment = "--" if path.suffix == ".sql" else "#"
    path.write_text(f"{held or ''}\n{comment} planted\n")
    return held


def restore(path: Path, held: str | None) -> None:
    if held is None:
        path.unlink()
    else:
        path.write_text(held)


def test_every_stage_is_here() -> None:
    """Tasks that keep a result in the cache: those that call run_stage."""
    using = {path.stem for path in (CHECKOUT / "tasks").glob("*.py") if "run_stage(" in path.read_text()} - {"stage"}
    assert using == set(STAGES)


def test_a_copy_has_the_keys_of_the_checkout(before: dict[str, str]) -> None:
    assert before == {stage: compute_code_version(f"tasks.{stage}").sha256 for stage in STAGES}
    assert len(set(before.values())) == len(STAGES)


@pytest.mark.parametrize(("kind", "file", "stages"), PLANTED, ids=[f"{kind}: {file}" for kind, file, _ in PLANTED])
def test_changed_code_changes_the_keys(
    kind: str, file: str, stages: list[str], copied: Path, before: dict[str, str]
) -> None:
    held = plant(copied / file)
    try:
        same = [stage for stage in stages if sha256(stage, copied) == before[stage]]
    finally:
        restore(copied / file, held)
    assert held is not None and same == [], kind


@pytest.mark.parametrize(("kind", "file", "stages"), UNRELATED, ids=[f"{kind}: {file}" for kind, file, _ in UNRELATED])
def test_unrelated_code_leaves_them(
    kind: str, file: str, stages: list[str], copied: Path, before: dict[str, str]
) -> None:
    held = plant(copied / file)
    try:
        changed = [stage for stage in stages if sha256(stage, copied) != before[stage]]
    finally:
        restore(copied / file, held)
    assert changed == [], kind


def test_a_new_file_of_a_folder_that_code_reads_counts(copied: Path, before: dict[str, str]) -> None:
    new = copied / "sql" / "checks" / "new_check.sql"
    held = plant(new)
    try:
        assert sha256("validate", copied) != before["validate"]
        assert sha256("merge", copied) == before["merge"]
    finally:
        restore(new, held)


@pytest.mark.parametrize(
    ("library", "stages", "others"),
    [
        ("pycolmap", ["reconstruct"], ["georeference", "merge", "ingest"]),
        ("open3d", ["register", "merge", "verify_model", "load_model"], ["reconstruct", "measure"]),
        ("onnxruntime", ["detect"], ["measure", "merge"]),
        ("opencv-python-headless", ["detect", "measure", "draw"], []),
        ("ifcopenshell", ["load_model"], ["merge", "reconstruct"]),
        ("numpy", STAGES, []),
        ("scipy", ["georeference", "merge", "verify_model"], []),
        ("duckdb", ["merge", "validate"], ["reconstruct", "georeference"]),
        ("great-expectations", ["validate"], ["merge"]),
        ("prefect", [], STAGES),
    ],
)
def test_versions_of_the_computing_libraries_count(
    library: str,
    stages: list[str],
    others: list[str],
    copied: Path,
    before: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    version = metadata.version
    monkeypatch.setattr(
        metadata, "version", lambda name: "99" if name.lower().replace("_", "-") == library else version(name)
    )
    after = {stage: sha256(stage, copied) for stage in {*stages, *others}}
    assert [stage for stage in stages if after[stage] == before[stage]] == []
    assert [stage for stage in others if after[stage] != before[stage]] == []


def test_the_flow_covers_every_stage() -> None:
    """``runs.code_sha256``: what any stage runs, the flow runs."""
    flow = compute_code_version("flows.inspect_building").files
    for stage in STAGES:
        assert compute_code_version(f"tasks.{stage}").files.keys() <= flow.keys(), stage
    assert "facadelake/evaluation/campaigns/comparison.py" not in flow


FACE = "import lazy_loader\n\n__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)\n"
STUB = "from .walls import wall as wall\nfrom .roofs import roof as roof\n"
OF_FACE = {"house/__init__.py", "house/__init__.pyi"}


def write_house(root: Path, **modules: str) -> None:
    """A checkout with a package ``house`` that has a face and two modules, and top-level ``modules``."""
    (root / "house").mkdir()
    for name, text in {
        "house/__init__.py": f'"""A face."""\n\n{FACE}', "house/__init__.pyi": STUB, "house/walls.py": "wall = 1\n",
        "house/roofs.py": "roof = 2\n",
    }.items():  # fmt: skip
        (root / name).write_text(text)
    for name, text in modules.items():
        (root / f"{name}.py").write_text(f"{text}\n")


def test_a_name_of_a_face_is_followed_to_its_module_alone(tmp_path: Path) -> None:
    write_house(
        tmp_path,
        use="from house import wall",
        whole="import house.roofs",
        late="def f():\n    from house import roof\n    return roof",
        typed="from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from house import roof",
        otherwise="from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    x = 1\nelse:\n    from house import roof",
        worker='command = ["python", "-m", "house.roofs"]',
    )
    roof = {"house/roofs.py", "house/__init__.py"}
    assert set(compute_code_version("use", tmp_path).files) == {"use.py", "house/walls.py", *OF_FACE}
    assert set(compute_code_version("whole", tmp_path).files) == {"whole.py", *roof}
    assert set(compute_code_version("late", tmp_path).files) == {"late.py", "house/roofs.py", *OF_FACE}
    assert set(compute_code_version("typed", tmp_path).files) == {"typed.py"}
    assert set(compute_code_version("otherwise", tmp_path).files) == {"otherwise.py", "house/roofs.py", *OF_FACE}
    assert set(compute_code_version("worker", tmp_path).files) >= {"worker.py", "house/roofs.py"}


def test_a_stub_that_points_a_name_elsewhere_is_other_code(tmp_path: Path) -> None:
    """Both modules are in the code before and after; only the stub says which of them a name comes from."""
    write_house(tmp_path, use="from house import roof, wall")
    (tmp_path / "house" / "roofs.py").write_text("roof = 2\nwall = 3\n")
    before = compute_code_version("use", tmp_path)
    (tmp_path / "house" / "__init__.pyi").write_text(STUB.replace(".walls", ".roofs") + "from .walls import w as w\n")
    forget_sources()
    assert compute_code_version("use", tmp_path).sha256 != before.sha256


def test_an_init_that_does_something_is_code(tmp_path: Path) -> None:
    (tmp_path / "house").mkdir()
    (tmp_path / "house" / "__init__.py").write_text("import settings\n\nsettings.switch_off\n")
    (tmp_path / "house" / "walls.py").write_text("wall = 1\n")
    (tmp_path / "settings.py").write_text("def switch_off(): ...\n")
    (tmp_path / "use.py").write_text("from house.walls import wall\n")
    with pytest.raises(CodeVersionError, match=r"__init__\.py:3: an attribute of settings is not followed"):
        compute_code_version("use", tmp_path)
    (tmp_path / "house" / "__init__.py").write_text("from settings import switch_off\n\nswitch_off()\n")
    forget_sources()
    files = {"use.py", "house/walls.py", "house/__init__.py", "settings.py"}
    assert set(compute_code_version("use", tmp_path).files) == files


LOCATE = "from facadelake.core.checkout import locate_source"
REFUSED = {
    "relative": "from . import walls",
    "package bound": "from house import attic",
    "face under a name": "import house as h\nh.wall",
    "module under a name": "import house.walls as w",
    "attribute of a package": "import house\nhouse.wall",
    "attribute of a package that is imported later": "def f():\n    return house.wall\n\n\nimport house.walls",
    "star": "from house import *",
    "name that the face does not have": "from house import door",
    "module that is not there": "import house.cellar",
    "locate_source of a variable": f"{LOCATE}\nlocate_source(name)",
    "locate_source by keyword": f'{LOCATE}\nlocate_source(relative="house")',
    "locate_source under a name": f'{LOCATE} as ls\nls("house")',
    "locate_source mapped": f'{LOCATE}\nlist(map(locate_source, ["house"]))',
    "locate_source as an attribute": 'from facadelake.core import checkout\ncheckout.locate_source("house")',
    "CHECKOUT": 'from house.walls import CHECKOUT\nCHECKOUT / "data"',
    "CHECKOUT as an attribute": "from house import walls\nwalls.CHECKOUT",
    "__file__": "from pathlib import Path\nPath(__file__)",
    "__file__ of a module": "from house import walls\nwalls.__file__",
    "__spec__": "__spec__.origin",
    "import_module": "import importlib\nimportlib.import_module('house.walls')",
    "import_module of a text": "from importlib import import_module\nimport_module(f'house.{name}')",
    "import_module relative": "from importlib import import_module\nimport_module('.walls', 'house')",
    "import_module under a name": "from importlib import import_module as m",
    "importlib.util": "from importlib.util import spec_from_file_location",
    "resources": "from importlib.resources import files\nfiles('house')",
    "resources as an attribute": "from importlib import resources",
    "pkgutil": "import pkgutil",
    "runpy": "from runpy import run_module",
    "__import__": "__import__('house.walls')",
    "exec": "exec('import house')",
    "sys.modules": "import sys\nsys.modules['house.walls']",
    "lazy_loader": "import lazy_loader as ll\nll.load('house.walls')",
    "code in a string": 'command = ["python", "-c", "from house.walls import wall"]',
    "code in bytes": 'command = [b"import house"]',
    "script": 'command = ["python", "house/walls.py"]',
    "module named by a text": 'command = ["python", "-m", f"house.{name}"]',
    "removed": f'{LOCATE}\nlocate_source("house/nowhere.sql")',
}


@pytest.mark.parametrize("text", REFUSED.values(), ids=REFUSED)
def test_what_the_closure_cannot_follow_is_refused(text: str, tmp_path: Path) -> None:
    write_house(tmp_path, use=text)
    (tmp_path / "house" / "attic").mkdir()
    (tmp_path / "house" / "attic" / "__init__.py").write_text('"""A package of the house."""\n')
    (tmp_path / "facadelake" / "core").mkdir(parents=True)
    (tmp_path / "facadelake" / "__init__.py").touch()
    shutil.copy(CHECKOUT / "facadelake" / "core" / "checkout.py", tmp_path / "facadelake" / "core")
    with pytest.raises(CodeVersionError, match=r"use\.py|cellar|nowhere\.sql"):
        compute_code_version("use", tmp_path)


def test_a_module_that_is_there_twice_is_refused(tmp_path: Path) -> None:
    """Python would take the package, and a reader of the imports the module."""
    write_house(tmp_path, use="from house.walls import wall")
    (tmp_path / "house" / "walls").mkdir()
    (tmp_path / "house" / "walls" / "__init__.py").write_text("wall = 3\n")
    with pytest.raises(CodeVersionError, match=r"house\.walls is there twice"):
        compute_code_version("use", tmp_path)
    with pytest.raises(CodeVersionError, match="has no module nowhere"):
        compute_code_version("nowhere", tmp_path)


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("use.py", "from house import wall\n\nwall += 1\n"),
        ("house/walls.py", "wall = 2\n"),
        ("house/walls.py", "wall = 1\n"),  # written with the same content, as by going to a branch and back
        ("house/__init__.pyi", STUB + "\n"),
        ("house/walls/__init__.py", "wall = 3\n"),  # takes the place of walls.py
    ],
)
def test_code_that_changes_while_it_runs_is_noticed(file: str, text: str, tmp_path: Path) -> None:
    write_house(tmp_path, use="from house import wall")
    before = compute_code_version("use", tmp_path)
    require_unchanged_code("use", tmp_path)
    (tmp_path / "house" / "roofs.py").write_text("roof = 3\n")  # no part of it
    require_unchanged_code("use", tmp_path)
    changed = tmp_path / file
    changed.parent.mkdir(exist_ok=True)
    written_ns = changed.stat().st_mtime_ns if changed.exists() else 0
    changed.write_text(text)
    os.utime(changed, ns=(written_ns + 10**9, written_ns + 10**9))
    with pytest.raises(CodeVersionError, match=r"changed while Facadelake was running|is there twice"):
        require_unchanged_code("use", tmp_path)
    assert compute_code_version("use", tmp_path) == before  # what is in memory is the code of before


def test_only_one_module_knows_where_the_checkout_lies() -> None:
    """A path built from ``__file__`` elsewhere would be a file that the keys do not see."""
    folders = ("cli", "facadelake", "flows", "tasks", "schemas")
    product = [path for folder in folders for path in (CHECKOUT / folder).rglob("*.py")]
    using = [path for path in product if "Path(__file__)" in path.read_text()]
    assert [path.relative_to(CHECKOUT).as_posix() for path in using] == ["facadelake/core/checkout.py"]
    dynamic = [path for path in product if "import_module(" in path.read_text() or "__import__(" in path.read_text()]
    assert dynamic == []
