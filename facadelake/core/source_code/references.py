"""What a module of the checkout refers to, read from its source; a form that cannot be followed is refused."""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NoReturn

from facadelake.core.errors import CodeVersionError

_LOCATE_SOURCE = "locate_source"
FACE = ("import lazy_loader", "__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)")
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
    "facadelake/core/source_code/references.py",
    "facadelake/detection/model_registry.py",
)
_IMPORT_MACHINERY = frozenset({"builtins", "importlib", "pkgutil", "runpy", "zipimport"})
_HARMLESS_MACHINERY = frozenset({("importlib", "metadata"), ("importlib.util", "find_spec")})


@dataclass(frozen=True, kw_only=True)
class References:
    """What a module refers to: modules, names of modules, source files, and strings that may name a module."""

    modules: tuple[str, ...]
    names: tuple[tuple[str, str], ...]
    sources: tuple[str, ...]
    strings: tuple[str, ...]


@cache
def read_references(path: Path, content: bytes, root: Path) -> References:
    """The references of a module with this content: many stages share a module, which is parsed once."""
    reader = _ReferenceReader(path, root)
    reader.visit(ast.parse(content, filename=str(path)))
    return References(
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
        self._root = root
        self._packages = list_packages(root)
        self._may_locate = path.relative_to(root).as_posix() in _MAY_LOCATE
        self._bound: set[str] = set()  # packages of the checkout that `import package.module` binds
        self._used: dict[str, ast.Name] = {}
        packages = "|".join(self._packages)
        self._path_in_text = re.compile(rf"\b({packages})[./](\w+)")
        self._import_in_text = re.compile(rf"\b(?:from|import)\s+(?:{packages})\b")

    def _names_code(self, text: str) -> bool:
        """Whether a text has code that imports from the checkout, or the name or path of a module of it."""
        named = (self._root / package / name for package, name in self._path_in_text.findall(text))
        exists = any(path.is_dir() or path.with_suffix(".py").is_file() for path in named)
        return exists or self._import_in_text.search(text) is not None

    def _refuse(self, node: ast.AST, what: str, remedy: str) -> NoReturn:
        line = getattr(node, "lineno", 0)
        raise CodeVersionError(
            f"{self._path}:{line}: {what} is not followed, so a cached result could outlive the code it names; {remedy}"
        )

    def visit(self, node: ast.AST) -> None:
        """Visit a statement or expression, without those of a face, which the stub describes."""
        if not (isinstance(node, ast.Import | ast.Assign) and ast.unparse(node) in FACE):
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
        text = "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
        put_together = re.search(rf"\b(?:{'|'.join(self._packages)})[./](?:\w+[./])*\{{", text)
        if put_together or self._names_code(text):
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
        elif self._names_code(text) and not self._may_locate:
            self._refuse(node, f"the module or file named by the text '{text[:60]}'", _IMPORT)


@cache
def list_packages(root: Path) -> tuple[str, ...]:
    """Top-level packages and modules of the checkout."""
    packages = {path.parent.name for path in root.glob("*/__init__.py")}
    return tuple(sorted(packages | {path.stem for path in root.glob("*.py")}))
