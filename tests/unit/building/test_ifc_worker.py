"""An IFC is read in a process of its own: a file that crashes, hangs or exhausts it is an error that names the file."""

import ast
import logging
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import pytest

from facadelake.building.ifc import worker_process
from facadelake.building.ifc.load import IfcModelSettings, load_ifc_building
from facadelake.building.ifc.worker_process import read_ifc_building
from facadelake.building.storeys import StoreyElevation
from facadelake.core.checkout import CHECKOUT
from facadelake.core.errors import GeoreferenceError, ModelError
from facadelake.core.progress import listen_to_progress
from tests.unit.building.conftest import Box, Ifc
from tests.unit.building.globe_by_hand import CONVERSION, CRS

PLACED = Ifc(conversion=CONVERSION, crs=CRS)


def crashing(path: Path) -> Path:
    """A number where the header names the schema: ifcopenshell's parser ends its process (found by the fuzz)."""
    text = path.read_text(encoding="utf-8")
    start = text.index("FILE_SCHEMA(")
    path.write_text(text[:start] + "FILE_SCHEMA((-1.));" + text[text.index("\n", start) :], encoding="utf-8")
    return path


class Recorder:
    """A progress listener that keeps the labels."""

    def __init__(self) -> None:
        self.labels: list[str] = []

    def begin(self, label: str, total: int | None) -> int:
        self.labels.append(label)
        return 0

    def advance(self, handle: int, steps: int) -> None: ...

    def end(self, handle: int) -> None: ...


def test_the_file_does_crash_its_process(write_ifc: Callable[[Ifc], Path]) -> None:
    path = crashing(write_ifc(PLACED))
    done = subprocess.run([sys.executable, "-c", f"import ifcopenshell; ifcopenshell.open({str(path)!r})"], check=False)
    assert done.returncode < 0


def test_a_crash_of_the_parser_is_an_error_that_names_the_file(write_ifc: Callable[[Ifc], Path]) -> None:
    path = crashing(write_ifc(PLACED))
    with pytest.raises(ModelError) as caught:
        read_ifc_building(path, settings=IfcModelSettings())
    message = str(caught.value)
    assert message.startswith(
        f"building model {path} cannot be read: the process that parses it with ifcopenshell was killed by signal "
        "SIGSEGV; check the file with an IFC validator (validate.buildingsmart.org), and export it again; where it is "
        "large, end other programs, too ("
    )
    assert message.endswith(" GB of memory were free)")


def test_the_model_is_the_one_that_this_process_reads(
    write_ifc: Callable[[Ifc], Path], caplog: pytest.LogCaptureFixture
) -> None:
    path = write_ifc(
        Ifc(
            boxes=[Box(), Box(corner_m=(20.0, 0.0, 0.0)), Box(corner_m=(9000.0, 0.0, 0.0))],
            conversion=CONVERSION,
            crs=CRS,
        )
    )
    settings = IfcModelSettings(storeys=(StoreyElevation(name="ground", floor_m=100.0),))
    here = load_ifc_building(path, settings=settings)
    caplog.clear()
    recorder = Recorder()
    with caplog.at_level(logging.INFO), listen_to_progress(recorder):
        there = read_ifc_building(path, settings=settings)
    assert "Meshing elements" in recorder.labels
    assert any("km from the others" in r.message and r.levelname == "WARNING" for r in caplog.records)
    assert there.elements.equals(here.elements)
    np.testing.assert_array_equal(there.vertices_site_m, here.vertices_site_m)
    np.testing.assert_array_equal(there.triangles, here.triangles)
    assert (there.origin, there.remarks, there.storeys) == (here.origin, here.remarks, here.storeys)


def test_what_the_worker_refuses_is_refused_with_its_own_error(write_ifc: Callable[[Ifc], Path]) -> None:
    with pytest.raises(GeoreferenceError, match="names no projected CRS"):
        read_ifc_building(write_ifc(Ifc()), settings=IfcModelSettings())


def test_a_hang_is_an_error(write_ifc: Callable[[Ifc], Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_process, "_SILENCE_MAX_S", 0.05)  # less than Python takes to start
    with pytest.raises(ModelError, match=r"reported no progress for 0.05 s and was ended; check the file"):
        read_ifc_building(write_ifc(PLACED), settings=IfcModelSettings())
    assert not [child for child in psutil.Process(os.getpid()).children() if "ifc.worker" in " ".join(child.cmdline())]


def test_lack_of_memory_is_an_error(write_ifc: Callable[[Ifc], Path], monkeypatch: pytest.MonkeyPatch) -> None:
    class Memory:
        available = 400_000_000

    monkeypatch.setattr(worker_process.psutil, "virtual_memory", Memory)
    path = write_ifc(PLACED)
    text = path.read_text(encoding="utf-8")
    many = "".join(f"#{9000000 + k}=IFCCARTESIANPOINT((0.,0.,{k}.));\n" for k in range(600_000))
    path.write_text(text.replace("ENDSEC;\nEND-ISO", f"{many}ENDSEC;\nEND-ISO"), encoding="utf-8")
    with pytest.raises(ModelError, match=rf"building model {path} .*0\.4 GB of memory"):
        read_ifc_building(path, settings=IfcModelSettings())


def test_the_product_opens_an_ifc_in_the_worker_alone() -> None:
    callers = set()
    for package in ("cli", "flows", "tasks", "facadelake"):
        for path in (CHECKOUT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Call):
                    name = ast.unparse(node.func)
                    if name in ("load_ifc_building", "open_ifc", "ifcopenshell.open"):
                        callers.add((str(path.relative_to(CHECKOUT)), name))
    assert callers == {
        ("facadelake/building/ifc/meshes.py", "ifcopenshell.open"),
        ("facadelake/building/ifc/load.py", "open_ifc"),
        ("facadelake/building/ifc/worker.py", "load_ifc_building"),
        ("facadelake/demo/building/solids.py", "ifcopenshell.open"),  # the file that the demo has just written
    }
