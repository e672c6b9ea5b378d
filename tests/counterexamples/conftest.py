"""The unit tests' writer of small IFC files, for the counterexamples too."""

from tests.unit.building.conftest import write_ifc

__all__ = ["write_ifc"]
