"""Names hold: functions are verbs, a class name has one meaning, no private dialect.

``a_from_b`` is a verb here: transforms and conversions are named ``target_from_source`` throughout.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGES = sorted(
    [
        *(path.parent.relative_to(REPOSITORY).as_posix() for path in REPOSITORY.glob("facadelake/*/__init__.py")),
        *("cli", "flows", "tasks", "schemas"),
    ]
)

VERBS = frozenset(
    """
    accept add adjust advance align answer append apply archive arrange ask assemble assign attach attribute average
    bake begin blend bound build bundle cache calibrate card cast catch check choose classify clear clip close
    cluster collect colour combine commit compare compute concatenate condense configure connect convert convolve
    copy correct correlate count cover create crop cut decide declare decode deduplicate delete demo deploy derive
    describe
    detect develop diff dilate distribute divide doctor download draft drape draw drop eliminate encode end enter erode
    escape estimate evaluate exclude expand expect explain export extend extract extrude fill filter find fit fix
    flatten follow forget format gate generate georeference get grade group grow guess guide handle has hash hold
    import include index infer ingest initialise insert inspect install integrate interpolate intersect invert is
    join judge keep label lay letterbox light limit linearise link list listen load localise locate lock log look
    make map mark mask match measure merge mesh migrate move name normalise notify observe offer open order orient
    outline pack paint pair parse partition place plan plot point postprocess predict prefer prepare present preview
    print probe project promote propagate propose prune publish put query quote raise rank rasterise reach read reassign
    receive recognise reconstruct record recover rectify reduce refine refuse register regrade reject release
    remove render repair replace report represent require resample resect reset resolve restart restore
    restrict retrieve review rotate
    round run sample save scale scan score search seed segment select send separate serve set shade share shift show
    shrink simplify smooth snap solve sort split square standardise start state step stop store straighten strip
    subdivide subtract suggest sum summarise suppress take test thin tile time tint trace track train transform
    translate triangulate trim trust try turn undistort union unite unpack update upload use validate verify view
    visit vote wait walk warn weigh weight whiten widen wrap write
    """.split()  # noqa: SIM905
)
# Named as the command line, Prefect or a library wants them.
NAMED_BY_OTHERS = frozenset(
    {"main", "campaigns", "coverage", "defects", "tracks", "sql", "pictures", "doctor", "cache", "emit", "training_set"}
    | {"why", "up", "down", "status", "systemd_unit"}
)
# Short ways to declare a column (schemas/column_type.py): the declaration reads as a list of nouns.
DECLARATIONS = frozenset({"text", "real", "count", "time", "flag"})
# Words of this project's early private dialect; docs/glossary.md has the field's.
DIALECT = frozenset(
    """
    behind casts honest honesty heard hang looked looks middle middles nought on_the_wall said shelf shown sighting
    sightings standing stray strays settled told united votes word words
    """.split()  # noqa: SIM905
)


def modules(package: str) -> Iterator[Path]:
    return iter(sorted((REPOSITORY / package).rglob("*.py")))


def definitions(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.ClassDef]:
    """Functions and classes of a module, and the methods of its classes that are no properties."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node
        if isinstance(node, ast.ClassDef):
            for method in node.body:
                decorators = {ast.unparse(d).split("(")[0] for d in getattr(method, "decorator_list", [])}
                if isinstance(method, ast.FunctionDef) and not any("property" in d for d in decorators):
                    yield method


def is_verb(name: str) -> bool:
    first = name.split("_")[0]
    return first in VERBS or "_from_" in name or name.startswith(("__", "from_"))  # from_x: a constructor


@pytest.mark.parametrize("package", PACKAGES)
def test_public_functions_are_verbs(package: str) -> None:
    wrong = [
        f"{path.relative_to(REPOSITORY)}:{node.lineno} {node.name}"
        for path in modules(package)
        for node in definitions(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef)
        and not node.name.startswith("_")
        and not is_verb(node.name)
        and node.name not in NAMED_BY_OTHERS | DECLARATIONS
    ]
    assert wrong == []


@pytest.mark.parametrize("package", PACKAGES)
def test_no_private_dialect_in_names(package: str) -> None:
    wrong = [
        f"{path.relative_to(REPOSITORY)}:{node.lineno} {node.name}"
        for path in modules(package)
        for node in definitions(ast.parse(path.read_text()))
        if DIALECT & set(_words(node.name))
    ]
    wrong += [str(path.relative_to(REPOSITORY)) for path in modules(package) if DIALECT & set(path.stem.split("_"))]
    assert wrong == []


def _words(name: str) -> list[str]:
    snake = "".join(f"_{c.lower()}" if c.isupper() else c for c in name)
    return snake.strip("_").split("_")


def test_a_class_name_is_defined_once() -> None:
    places = defaultdict(list)
    for package in PACKAGES:
        for path in modules(package):
            for node in ast.parse(path.read_text()).body:
                if isinstance(node, ast.ClassDef):
                    places[node.name.lstrip("_")].append(str(path.relative_to(REPOSITORY)))
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


@pytest.mark.parametrize("package", PACKAGES)
def test_no_room_is_too_large(package: str) -> None:
    """A module past 350 lines wants a wall; a folder past twenty modules wants floors."""
    large = {
        str(path.relative_to(REPOSITORY)): len(path.read_text().splitlines())
        for path in modules(package)
        if len(path.read_text().splitlines()) > 350
    }
    assert large == {}
    folders = {path.parent for path in modules(package)}
    crowded = {str(folder): len(list(folder.glob("*.py"))) - 1 for folder in folders}
    assert {folder: count for folder, count in crowded.items() if count > 20} == {}
