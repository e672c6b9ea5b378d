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
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import NoReturn

from facadelake.core.checkout import CHECKOUT
from facadelake.core.errors import CodeVersionError
from facadelake.core.proj.grids import list_installed_grids

# Imported but without influence on results: scheduling, locks, memory meters, the terminal.
NOT_COMPUTING = frozenset({"filelock", "lazy-loader", "prefect", "psutil", "rich", "typer"})

_LOCATE_SOURCE = "locate_source"
_FACE = ("import lazy_loader", "__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)")
# Names that reach code or files in ways that the closure does not follow, with what to write instead.
_LITERAL = f'write {_LOCATE_SOURCE}("folder/file") with a literal'
_IMPORT = "write an import statement"
_REFUSED = {
    **dict.fromkeys(("CHECKOUT", "__file__", "__path__", "__spec__", "__loader__", _LOCATE_SOURCE), _LITERAL),
    **dict.fromkeys(("__import__", "exec", "eval", "lazy_loader", "import_module"), _IMPORT),
}
# Modules that may use those of _LITERAL: they are this mechanism, or locate what users choose (hashed as an input).
_MAY_LOCATE = (
    "facadelake/core/checkout.py",
    "facadelake/core/code_version.py",
    "facadelake/detection/model_registry.py",
)
_IMPORT_MACHINERY = frozenset({"builtins", "importlib", "pkgutil", "runpy", "zipimport"})
_HARMLESS_MACHINERY = frozenset({("importlib", "metadata"), ("importlib.util", "find_spec")})


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
    for grid, size_bytes in list_installed_grids() if "pyproj" in libraries else ():
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


@dataclass(frozen=True, kw_only=True)
class _References:
    """What a module refers to: modules, names of modules, source files, and strings that may name a module."""

    modules: tuple[str, ...]
    names: tuple[tuple[str, str], ...]
    sources: tuple[str, ...]
    strings: tuple[str, ...]


def _find_dependencies(path: Path, content: bytes, root: Path) -> Iterator[Path | str]:
    """Files of the checkout that a module uses, and top-level names of other packages that it imports."""
    references = _read_references(path, content, root)
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


@cache
def _read_references(path: Path, content: bytes, root: Path) -> _References:
    """The references of a module with this content: many stages share a module, which is parsed once."""
    reader = _ReferenceReader(path, root)
    reader.visit(ast.parse(content, filename=str(path)))
    return _References(
        modules=tuple(reader.modules),
        names=tuple(reader.names),
        sources=tuple(reader.sources),
        strings=tuple(reader.strings),
    )


class _ReferenceReader(ast.NodeVisitor):
    """Collects the references of one module; raises for a form that is not understood."""

    def __init__(self, path: Path, root: Path) -> None:
        self.modules: list[str] = []
        self.names: list[tuple[str, str]] = []
        self.sources: list[str] = []
        self.strings: list[str] = []
        self._path = path
        self._packages = _list_packages(root)
        self._may_locate = path.relative_to(root).as_posix() in _MAY_LOCATE
        self._bound: set[str] = set()  # packages of the checkout that `import package.module` binds
        self._used: dict[str, ast.Name] = {}
        self._in_code = re.compile(
            rf"\b(?:{'|'.join(self._packages)})[./]\w|\b(?:from|import)\s+(?:{'|'.join(self._packages)})\b"
        )

    def _refuse(self, node: ast.AST, what: str, remedy: str) -> NoReturn:
        line = getattr(node, "lineno", 0)
        raise CodeVersionError(
            f"{self._path}:{line}: {what} is not followed, so a cached result could outlive the code it names; {remedy}"
        )

    def _is_of_checkout(self, module: str) -> bool:
        return module.partition(".")[0] in self._packages

    def visit(self, node: ast.AST) -> None:
        """Visit a statement or expression, without those of a face, which the stub describes."""
        if not (isinstance(node, ast.Import | ast.Assign) and ast.unparse(node) in _FACE):
            super().visit(node)

    def visit_Module(self, node: ast.Module) -> None:
        """``import a.b`` binds ``a``, which may not be used: its attributes could be anything."""
        self.generic_visit(node)
        for package in sorted(self._bound & self._used.keys()):
            self._refuse(self._used[package], f"an attribute of {package}", "write from module import name")

    def visit_If(self, node: ast.If) -> None:
        """The body of ``if TYPE_CHECKING`` is never executed; what follows ``else`` is."""
        if ast.unparse(node.test) not in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
            self.generic_visit(node)
        for statement in node.orelse:
            self.visit(statement)

    def visit_Expr(self, node: ast.Expr) -> None:
        """A docstring is no code."""
        if not isinstance(node.value, ast.Constant):
            self.generic_visit(node)

    def visit_Import(self, node: ast.Import) -> None:
        """``import a.b`` executes ``a.b``."""
        for alias in node.names:
            package = alias.name.partition(".")[0]
            if package in _IMPORT_MACHINERY or package == "lazy_loader":
                self._refuse(node, f"import {alias.name}", _IMPORT)
            if package in self._packages:
                if alias.asname:
                    self._refuse(node, f"import {alias.name} as {alias.asname}", f"write from {alias.name} import name")
                self._bound.add(package)
            self.modules.append(alias.name)

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        """Each name is resolved where it is defined."""
        if node.level or node.module is None:
            self._refuse(node, "a relative import", "write the full name of the module")
        package = node.module.partition(".")[0]
        for alias in node.names:
            machinery = package in _IMPORT_MACHINERY or package == "lazy_loader"
            if (
                machinery
                and node.module != "importlib.metadata"
                and (node.module, alias.name) not in _HARMLESS_MACHINERY
            ):
                self._refuse(node, f"from {node.module} import {alias.name}", _IMPORT)
            if alias.name == "*" and package in self._packages:
                self._refuse(node, f"from {node.module} import *", "name what is imported")
            if alias.name == _LOCATE_SOURCE and alias.asname:
                self._refuse(node, f"{_LOCATE_SOURCE} under another name", _LITERAL)
            if alias.name == "CHECKOUT" and package in self._packages and not self._may_locate:
                self._refuse(node, "CHECKOUT", _LITERAL)
            self.names.append((node.module, alias.name))

    def visit_Call(self, node: ast.Call) -> None:
        """``locate_source("...")`` names a file or folder; any other use of it is refused by its name."""
        match node:
            case ast.Call(func=ast.Name(id=name), args=[ast.Constant(value=str(relative))], keywords=[]) if (
                name == _LOCATE_SOURCE
            ):
                self.sources.append(relative)
            case _:
                self.generic_visit(node)

    def visit_Name(self, node: ast.Name) -> None:
        """Names that reach code or files otherwise."""
        self._check_name(node, node.id)
        self._used.setdefault(node.id, node)

    def visit_Attribute(self, node: ast.Attribute) -> None:
        """The same names as attributes, such as ``checkout.locate_source``; ``sys.modules``."""
        if node.attr not in ("eval", "exec"):  # pandas and others have methods of that name
            self._check_name(node, node.attr)
        if ast.unparse(node) == "sys.modules":
            self._refuse(node, "sys.modules", _IMPORT)
        self.generic_visit(node)

    def _check_name(self, node: ast.AST, name: str) -> None:
        remedy = _REFUSED.get(name)
        if remedy and not (self._may_locate and remedy == _LITERAL):
            self._refuse(node, name, remedy)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """A module's name or a path that is put together."""
        text = "".join(str(part.value) if isinstance(part, ast.Constant) else "x" for part in node.values)
        if self._in_code.search(text):
            self._refuse(node, f"the module or file named by the text '{text[:60]}'", _IMPORT)
        for part in node.values:
            if not isinstance(part, ast.Constant):
                self.visit(part)

    def visit_Constant(self, node: ast.Constant) -> None:
        """A string that is the name of a module is followed; code or a path in a string is not."""
        if not isinstance(node.value, str | bytes):
            return
        text = node.value if isinstance(node.value, str) else node.value.decode("latin-1")
        if "." in text and all(part.isidentifier() for part in text.split(".")):
            self.strings.append(text)
        elif self._in_code.search(text) and not self._may_locate:
            self._refuse(node, f"the module or file named by the text '{text[:60]}'", _IMPORT)


@cache
def _list_packages(root: Path) -> tuple[str, ...]:
    """Top-level packages and modules of the checkout."""
    packages = {path.parent.name for path in root.glob("*/__init__.py")}
    return tuple(sorted(packages | {path.stem for path in root.glob("*.py")}))


def _resolve_module(name: str, root: Path) -> Iterator[Path | str]:
    found = _find_module_file(name, root)
    package = name.partition(".")[0]
    if found is not None:
        yield from _include_packages_above(found, root)
    elif package in _list_packages(root):
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
    return source is not None and _FACE[1] in source.content.decode().splitlines()


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
