"""The code that computes a result: the modules that a module imports, the files that they read, the libraries.

The closure is derived from the source (``ast``), never listed by hand:

- imports anywhere in a module, also inside functions; those under ``if TYPE_CHECKING`` are never executed and not
  followed;
- the ``__init__`` of every package above a module, unless it is a face: ``lazy_loader`` with a stub ``__init__.pyi``
  beside it, or nothing but a docstring. A name imported from a face is resolved to the module that defines it, so that
  one name does not pull in the whole package;
- a string that is the name of a module of the checkout, such as the worker's in ``[python, "-m", "facadelake.x"]``;
- files and folders named by ``locate_source("...")``;
- distributions of the third-party packages that are imported, with their versions, and the version of Python;
- where PROJ is imported, the transformation grids that are installed beside it, by name and size: they decide which
  operation PROJ takes.

Source is hashed byte by byte: a changed comment invalidates results, and a changed rule can never be missed.
"""

from __future__ import annotations

import ast
import hashlib
import platform
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path

from facadelake.core.checkout import CHECKOUT
from facadelake.core.hashing import hash_file
from facadelake.core.proj.grids import list_installed_grids

# Imported but without influence on results: scheduling, locks, memory meters, the terminal.
NOT_COMPUTING = frozenset({"filelock", "lazy-loader", "prefect", "psutil", "rich", "typer"})
_LOCATE_SOURCE = "locate_source"


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

    Raises LookupError where the checkout has no such module.
    """
    return _compute_version(module, root.resolve())


@cache
def _compute_version(module: str, root: Path) -> CodeVersion:
    closure = _collect_closure(module, root)
    files = {str(path.relative_to(root)): hash_file(path) for path in sorted(closure.files)}
    libraries = _read_library_versions(closure.packages)
    digest = hashlib.sha256(platform.python_version().encode())
    for name, value in [*files.items(), *libraries.items()]:
        digest.update(f"\0{name}\0{value}".encode())
    for grid, size_bytes in list_installed_grids() if "pyproj" in libraries else ():
        digest.update(f"\0{grid}\0{size_bytes}".encode())
    return CodeVersion(files=files, libraries=libraries, sha256=digest.hexdigest())


@dataclass(kw_only=True)
class _Closure:
    files: set[Path] = field(default_factory=set)
    packages: set[str] = field(default_factory=set)


def _collect_closure(module: str, root: Path) -> _Closure:
    first = _find_module_file(module, root)
    if first is None:
        raise LookupError(f"the checkout {root} has no module {module}")
    closure = _Closure()
    pending = [first]
    while pending:
        path = pending.pop()
        if path in closure.files:
            continue
        closure.files.add(path)
        if path.suffix != ".py":
            continue
        for dependency in _find_dependencies(path, root):
            if isinstance(dependency, Path):
                pending.append(dependency)
            else:
                closure.packages.add(dependency)
    return closure


@dataclass(frozen=True, kw_only=True)
class _References:
    """What a module refers to: modules, names of modules, source files, and strings that may name a module."""

    modules: tuple[str, ...]
    names: tuple[tuple[str, str], ...]
    sources: tuple[str, ...]
    strings: tuple[str, ...]


def _find_dependencies(path: Path, root: Path) -> Iterator[Path | str]:
    """Files of the checkout that a module uses, and top-level names of other packages that it imports."""
    references = _read_references(path, hash_file(path))
    yield from _find_packages_above(path, root)
    for module in references.modules:
        yield from _resolve_module(module, root)
    for module, name in references.names:
        yield from _resolve_name(module, name, root)
    for relative in references.sources:
        yield from _list_files(root / relative)
    for text in references.strings:
        found = _find_module_file(text, root)
        if found is not None:
            yield found
            main = found.with_name("__main__.py")
            if found.name == "__init__.py" and main.is_file():
                yield main


@cache
def _read_references(path: Path, sha256: str) -> _References:
    """The references of a module whose content has this hash: many stages share a module, which is parsed once."""
    modules: list[str] = []
    names: list[tuple[str, str]] = []
    sources: list[str] = []
    strings: list[str] = []
    for node in _walk_executed_nodes(ast.parse(path.read_bytes(), filename=str(path))):
        match node:
            case ast.Import(names=aliases):
                modules += [alias.name for alias in aliases]
            case ast.ImportFrom(module=str(module), names=aliases, level=0):
                names += [(module, alias.name) for alias in aliases]
            case ast.ImportFrom():
                raise ValueError(f"{path}: relative imports are not followed; write the full name of the module")
            case ast.Call(func=ast.Name(id=name), args=[ast.Constant(value=str(relative))]) if name == _LOCATE_SOURCE:
                sources.append(relative)
            case ast.Call(func=ast.Name(id=name)) if name == _LOCATE_SOURCE:
                raise ValueError(
                    f"{path}:{node.lineno}: locate_source takes a literal, so that the cache's keys cover it"
                )
            case ast.Constant(value=str(text)) if "." in text and all(part.isidentifier() for part in text.split(".")):
                strings.append(text)
    return _References(modules=tuple(modules), names=tuple(names), sources=tuple(sources), strings=tuple(strings))


def _walk_executed_nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes except those under ``if TYPE_CHECKING``."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
            continue
        yield node
        yield from _walk_executed_nodes(node)


def _resolve_module(name: str, root: Path) -> Iterator[Path | str]:
    found = _find_module_file(name, root)
    if found is not None:
        yield from _include_packages_above(found, root)
    elif not (root / name.partition(".")[0]).is_dir() and name.partition(".")[0] not in sys.stdlib_module_names:
        yield name.partition(".")[0]


def _resolve_name(module: str, name: str, root: Path) -> Iterator[Path | str]:
    """What ``from module import name`` executes: the submodule ``name``, or the module that defines it."""
    found = _find_module_file(module, root)
    if found is None:
        yield from _resolve_module(module, root)
        return
    submodule = _find_module_file(f"{module}.{name}", root)
    if submodule is not None:
        yield from _include_packages_above(submodule, root)
        return
    defined_in = _read_face(found).get(name) if found.name == "__init__.py" else None
    if defined_in is not None:
        yield from _resolve_name(f"{module}.{defined_in}", name, root)
    else:
        yield from _include_packages_above(found, root)


def _include_packages_above(path: Path, root: Path) -> Iterator[Path]:
    yield path
    yield from _find_packages_above(path, root)


def _find_packages_above(path: Path, root: Path) -> Iterator[Path]:
    """The ``__init__`` files that are executed before a module, without faces, which execute no code of their own."""
    folder = path.parent
    while folder != root:
        init = folder / "__init__.py"
        if init.is_file() and init != path and not _is_face(init):
            yield init
        folder = folder.parent


@cache
def _is_face(init: Path) -> bool:
    """Whether an ``__init__`` only re-exports names (``lazy_loader.attach_stub``), or is empty."""
    body = [
        node
        for node in ast.parse(init.read_bytes()).body
        if not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))
    ]
    return all(ast.unparse(node) in _FACE_STATEMENTS for node in body)


_FACE_STATEMENTS = ("import lazy_loader", "__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)")


@cache
def _read_face(init: Path) -> Mapping[str, str]:
    """The names that a face re-exports, each with the submodule that it comes from."""
    stub = init.with_suffix(".pyi")
    if not stub.is_file():
        return {}
    return {
        alias.name: node.module
        for node in ast.parse(stub.read_bytes()).body
        if isinstance(node, ast.ImportFrom) and node.level == 1 and node.module
        for alias in node.names
    }


def _find_module_file(module: str, root: Path) -> Path | None:
    if not all(part.isidentifier() for part in module.split(".")):
        return None
    path = root.joinpath(*module.split("."))
    return next((found for found in (path.with_suffix(".py"), path / "__init__.py") if found.is_file()), None)


def _list_files(path: Path) -> Iterator[Path]:
    """The file itself, or all files below a folder."""
    if not path.exists():
        raise LookupError(f"{path} is named by locate_source and does not exist")
    yield from sorted(found for found in path.rglob("*") if found.is_file()) if path.is_dir() else [path]


@cache
def _map_packages_to_distributions() -> Mapping[str, list[str]]:
    return metadata.packages_distributions()


def _read_library_versions(packages: set[str]) -> dict[str, str]:
    """Versions of the distributions that provide the packages, without those of ``NOT_COMPUTING``."""
    names = {name for package in packages for name in _map_packages_to_distributions().get(package, [])}
    found = {name.lower().replace("_", "-"): metadata.version(name) for name in sorted(names)}
    return {name: version for name, version in sorted(found.items()) if name not in NOT_COMPUTING}
