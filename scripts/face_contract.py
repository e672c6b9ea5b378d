"""Import contract: a package is entered through its face."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from grimp import ImportGraph
from importlinter import Contract, ContractCheck, fields, output


class FaceContract(Contract):
    """Each package directly below ``container`` is imported from outside by its faces alone.

    A face is the package itself, or one of its sub-packages that has a stub ``__init__.pyi``: it hands names on,
    modules and other sub-packages are private. Inside a package, modules are imported by name, never through the
    package's own face (which would be a circle), and below ``container`` nothing is imported through its face, which
    hands on names of every layer. ``public`` are packages all of whose modules are open.
    """

    type_name = "faces"

    container = fields.StringField()
    public = fields.SetField(subfield=fields.StringField(), required=False)

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:
        """Every import that enters a package beside its face, or goes back through its own."""
        container = str(self.container)
        wrong = []
        for importer in sorted(graph.find_modules_that_directly_import(container)):
            if importer.startswith(f"{container}."):
                wrong += self._lines(graph, importer, container)
        packages = sorted(graph.find_children(container))
        for package in packages:
            if package in (self.public or ()):
                continue
            inside = {package, *graph.find_descendants(package)}
            faces = {module for module in inside if module == package or _has_stub(module)}
            for module in sorted(inside):
                for importer in sorted(graph.find_modules_that_directly_import(module)):
                    if (importer in inside) == (module in faces):
                        wrong += self._lines(graph, importer, module)
        return ContractCheck(kept=not wrong, metadata={"wrong": wrong})

    def render_broken_contract(self, check: ContractCheck) -> None:
        """One line an import."""
        for line in check.metadata["wrong"]:
            output.print_error(line, bold=False)

    @staticmethod
    def _lines(graph: ImportGraph, importer: str, module: str) -> list[str]:
        details: list[Any] = graph.get_import_details(importer=importer, imported=module)
        return [f"{importer} -> {module} (l. {detail['line_number']})" for detail in details]


def _has_stub(module: str) -> bool:
    """Whether a package of the checkout (the working directory) has a face."""
    return Path(*module.split("."), "__init__.pyi").is_file()
