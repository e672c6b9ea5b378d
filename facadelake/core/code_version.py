"""The code that computes a result: the modules that a module imports, the files that they read, the libraries.

The closure is derived from the source (``ast``), never listed by hand:

- imports anywhere in a module, also inside functions; those under ``if TYPE_CHECKING`` are never executed and not
  followed;
- the ``__init__`` of every package above a module. A name imported from a face (an ``__init__`` that attaches its stub
  ``__init__.pyi`` by ``lazy_loader``) is resolved to the module that defines it, so that one name does not pull in the
  whole package; the stub is part of the code;
- a string that is the name of a module of the checkout, such as the worker's in ``[python, "-m", "facadelake.x"]``;
- files and folders named by ``locate_source("...")``;
- distributions of the third-party packages that are imported, with their versions, and the version of Python;
- where PROJ is imported, the transformation grids that are installed beside it, by name and size: they decide which
  operation PROJ takes.

Every other form that reaches code or files of the checkout (a package bound to a name, a star, ``importlib``,
``__file__``, ``CHECKOUT``, code or a path in a string) raises CodeVersionError: what cannot be followed is no part of a
result.

Source is hashed byte by byte: a changed comment invalidates results, and a changed rule can never be missed. A process
hashes a file once, when it is first asked for it; ``require_unchanged_code`` tells whether it still is what it was.
"""

from __future__ import annotations

import ast
import hashlib
import platform
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path

from facadelake.core.checkout import CHECKOUT
from facadelake.core.errors import CodeVersionError
from facadelake.core.source_code.references import FACE, list_packages, read_references

# Imported but without influence on results: scheduling, locks, memory meters, the terminal.
NOT_COMPUTING = frozenset({"filelock", "lazy-loader", "prefect", "psutil", "rich", "typer"})


@dataclass(frozen=True, kw_only=True)
class CodeVersion:
    """The code of a result: ``files`` (path below the checkout: SHA-256) and ``libraries`` (distribution: version).

    ``sha256`` is the hash over both and over Python's version.
    """

    files: Mapping[str, str]
    libraries: Mapping[str, str]
    sha256: str


def compute_code_version(module: str, root: Path = CHECKOUT) -> CodeVersion:
    """The version of all code that ``module`` (dotted name) of the checkout ``root`` may execute.

    It is that of the files when this process first asked for them, before or right after it loaded them.

    Raises CodeVersionError where the checkout has no such module, or where code cannot be followed.
    """
    return _compute_version(module, root.resolve())


def require_unchanged_code(module: str, root: Path = CHECKOUT) -> None:
    """Raise CodeVersionError if the code of ``module`` was written since this process first computed its version.

    Modules are loaded when they are first used, and worker processes load their own: a result that was computed while
    the code changed belongs to no version, and must not be stored under any. A file that was written counts as changed
    although its content is as before, because modules may have been loaded in between.
    """
    root = root.resolve()
    before = _collect_first_closure(module, root).files
    changed = [path for path, source in before.items() if _read_source_now(path) != source]
    if not changed:  # then the closure can be walked again: a new file may have taken the place of another
        changed = sorted(_collect_closure(module, root, _read_source_now).files.keys() ^ before.keys())
    if changed:
        names = ", ".join(str(path.relative_to(root)) for path in changed[:3])
        raise CodeVersionError(
            f"{names}{' and others' if len(changed) > 3 else ''} changed while Facadelake was running: the result "
            "would mix two versions of the code, so it is not stored; run the command again"
        )


@cache
def _compute_version(module: str, root: Path) -> CodeVersion:
    closure = _collect_first_closure(module, root)
    files = {str(path.relative_to(root)): closure.files[path].sha256 for path in sorted(closure.files)}
    libraries = _read_library_versions(closure.packages)
    digest = hashlib.sha256(platform.python_version().encode())
    for name, value in [*files.items(), *libraries.items()]:
        digest.update(f"\0{name}\0{value}".encode())
    if "pyproj" in libraries:
        from facadelake.core.proj.grids import list_installed_grids  # commands that compute nothing start without PROJ

        for grid, size_bytes in list_installed_grids():
            digest.update(f"\0{grid}\0{size_bytes}".encode())
    return CodeVersion(files=files, libraries=libraries, sha256=digest.hexdigest())


@dataclass(frozen=True, kw_only=True)
class _Source:
    """A file of the checkout as it was read: its content (of Python only), its hash, and when it was written."""

    content: bytes
    sha256: str
    written_ns: int


def _read_source_now(path: Path) -> _Source | None:
    """A file as it is now; None where there is none."""
    try:
        written_ns = path.stat().st_mtime_ns
        content = path.read_bytes()
    except FileNotFoundError:
        return None
    code = path.suffix in (".py", ".pyi")
    return _Source(content=content if code else b"", sha256=hashlib.sha256(content).hexdigest(), written_ns=written_ns)


@cache
def _read_source(path: Path) -> _Source | None:
    """A file as it was when this process first read it."""
    return _read_source_now(path)


@dataclass(kw_only=True)
class _Closure:
    files: dict[Path, _Source] = field(default_factory=dict)
    packages: set[str] = field(default_factory=set)


@cache
def _collect_first_closure(module: str, root: Path) -> _Closure:
    return _collect_closure(module, root, _read_source)


def _collect_closure(module: str, root: Path, read: Callable[[Path], _Source | None]) -> _Closure:
    first = _find_module_file(module, root)
    if first is None:
        raise CodeVersionError(f"the checkout {root} has no module {module}")
    closure = _Closure()
    pending = [first]
    while pending:
        path = pending.pop()
        if path in closure.files:
            continue
        source = read(path)
        if source is None:
            raise CodeVersionError(f"{path} was removed while Facadelake was running; run the command again")
        closure.files[path] = source
        if path.suffix != ".py":
            continue
        for dependency in _find_dependencies(path, source.content, root):
            if isinstance(dependency, Path):
                pending.append(dependency)
            else:
                closure.packages.add(dependency)
    return closure


def _find_dependencies(path: Path, content: bytes, root: Path) -> Iterator[Path | str]:
    """Files of the checkout that a module uses, and top-level names of other packages that it imports."""
    references = read_references(path, content, root)
    yield from _find_packages_above(path, root)
    for module in references.modules:
        yield from _resolve_module(module, root)
    for module, name in references.names:
        yield from _resolve_name(path, module, name, root)
    for relative in references.sources:
        yield from _list_files(root / relative)
    for text in references.strings:
        found = _find_module_file(text, root)
        if found is not None:
            yield found
            main = found.with_name("__main__.py")
            if found.name == "__init__.py" and main.is_file():
                yield main


def _resolve_module(name: str, root: Path) -> Iterator[Path | str]:
    found = _find_module_file(name, root)
    package = name.partition(".")[0]
    if found is not None:
        yield from _include_packages_above(found, root)
    elif package in list_packages(root):
        raise CodeVersionError(f"the checkout {root} has no module {name}, which is imported")
    elif package not in sys.stdlib_module_names:
        yield package


def _resolve_name(importer: Path, module: str, name: str, root: Path) -> Iterator[Path | str]:
    """What ``from module import name`` executes: the submodule ``name``, or the module that defines it."""
    found = _find_module_file(module, root)
    if found is None:
        yield from _resolve_module(module, root)
        return
    yield from _include_packages_above(found, root)
    submodule = _find_module_file(f"{module}.{name}", root)
    if submodule is not None and submodule.name == "__init__.py":
        raise CodeVersionError(
            f"{importer}: from {module} import {name} binds a package, whose attributes are not followed; write "
            f"from {module}.{name} import and the name that is used"
        )
    if submodule is not None:
        yield submodule
    elif found.name == "__init__.py" and _attaches_stub(found):
        stub = found.with_suffix(".pyi")
        yield stub
        defined_in = _read_face(stub).get(name)
        if defined_in is None:
            raise CodeVersionError(f"{importer}: {module} has no name {name}; {stub} lists those that it has")
        yield from _resolve_name(importer, f"{module}.{defined_in}", name, root)


def _include_packages_above(path: Path, root: Path) -> Iterator[Path]:
    yield path
    yield from _find_packages_above(path, root)


def _find_packages_above(path: Path, root: Path) -> Iterator[Path]:
    """The ``__init__`` files that are executed before a module."""
    folder = path.parent
    while folder != root:
        init = folder / "__init__.py"
        if init.is_file() and init != path:
            yield init
        folder = folder.parent


def _attaches_stub(init: Path) -> bool:
    """Whether an ``__init__`` is a face: its names come from its stub."""
    source = _read_source(init)
    return source is not None and FACE[1] in source.content.decode().splitlines()


def _read_face(stub: Path) -> Mapping[str, str]:
    """The names that a face re-exports, each with the submodule that it comes from."""
    source = _read_source(stub)
    return {} if source is None else _parse_face(source.content)


@cache
def _parse_face(content: bytes) -> Mapping[str, str]:
    return {
        alias.name: node.module
        for node in ast.parse(content).body
        if isinstance(node, ast.ImportFrom) and node.level == 1 and node.module
        for alias in node.names
    }


def _find_module_file(module: str, root: Path) -> Path | None:
    if not all(part.isidentifier() for part in module.split(".")):
        return None
    path = root.joinpath(*module.split("."))
    found = [path for path in (path.with_suffix(".py"), path / "__init__.py") if path.is_file()]
    if len(found) > 1:
        raise CodeVersionError(f"the module {module} is there twice, as {found[0]} and as {found[1]}; remove one")
    return found[0] if found else None


def _list_files(path: Path) -> Iterator[Path]:
    """The file itself, or all files below a folder."""
    if not path.exists():
        raise CodeVersionError(f"{path} is named by locate_source and does not exist")
    yield from sorted(found for found in path.rglob("*") if found.is_file()) if path.is_dir() else [path]


@cache
def _map_packages_to_distributions() -> Mapping[str, list[str]]:
    return metadata.packages_distributions()


def _read_library_versions(packages: set[str]) -> dict[str, str]:
    """Versions of the distributions that provide the packages, without those of ``NOT_COMPUTING``."""
    names = {name for package in packages for name in _map_packages_to_distributions().get(package, [])}
    found = {name.lower().replace("_", "-"): metadata.version(name) for name in sorted(names)}
    return {name: version for name, version in sorted(found.items()) if name not in NOT_COMPUTING}
