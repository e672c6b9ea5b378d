"""Read an IFC in a process of its own, so that a file that crashes the parser becomes an error."""

from __future__ import annotations

import tempfile
from pathlib import Path

import psutil
from pydantic import TypeAdapter

from facadelake.building.ifc.load import IfcModelSettings
from facadelake.building.model import BuildingModel, read_building
from facadelake.core.errors import ModelError
from facadelake.core.processes.parent import get_log_path, run_worker_process

_SILENCE_MAX_S = 900.0  # parsing 1 GB takes two minutes, and cutting the openings of one wall seldom more than one


def read_ifc_building(path: Path, *, settings: IfcModelSettings) -> BuildingModel:
    """Read the building from the IFC at ``path``, as ``load_ifc_building`` does, in a process of its own.

    Raises what ``load_ifc_building`` raises, and ModelError where the process crashes, hangs or lacks memory.
    """
    free_bytes = psutil.virtual_memory().available
    with tempfile.TemporaryDirectory(prefix="facadelake-model-") as name:
        folder = Path(name)
        job = {
            "model": str(path),
            "settings": TypeAdapter(IfcModelSettings).dump_python(settings, mode="json"),
            "folder": name,
            "memory_max_bytes": free_bytes,
        }
        cause = run_worker_process("facadelake.building.ifc.worker", job, folder, silence_max_s=_SILENCE_MAX_S)
        if cause:
            lines = get_log_path(folder).read_text(encoding="utf-8", errors="replace").splitlines()
            last = next((f", its last message: {line.strip()}" for line in reversed(lines) if line.strip()), "")
            raise ModelError(
                f"building model {path} cannot be read: the process that parses it with ifcopenshell {cause}{last}; "
                "check the file with an IFC validator (validate.buildingsmart.org), and export it again; where it is "
                f"large, end other programs, too ({free_bytes / 1e9:.1f} GB of memory were free)"
            )
        return read_building(folder)
