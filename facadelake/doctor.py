"""What this machine has and lacks: system libraries, rendering, native packages, room for the lake, models.

Native packages are tried in processes of their own: what crashes there is a line in the report, not a crash here,
and no two native libraries meet in one process.
"""

import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

from facadelake.core.errors import ModelError
from facadelake.core.system_libraries import LIBRARIES, Library, format_install_command, is_present
from facadelake.detection import find_default_model

GIB = 1024**3
DISK_WANTED_GIB = 5.0  # a campaign's photographs, reconstruction, depth maps and tables, with some to spare
MEMORY_WANTED_GIB = 4.0  # SIFT on two 6 Mpx photographs at once, beside Prefect
PROBE_LIMIT_S = 120.0
SETUP_AGAIN = "make distclean setup"


class Status(StrEnum):
    """What a check came to."""

    OK = "ok"
    WARNING = "warning"
    MISSING = "missing"


@dataclass(frozen=True, kw_only=True)
class Check:
    """One line of the report: what was looked at, what was found, and how to get what is lacking ('' if nothing)."""

    name: str
    status: Status
    found: str
    remedy: str = ""


@dataclass(frozen=True, kw_only=True)
class Probe:
    """Python code that prints what it found in its last line, or fails."""

    name: str
    code: str
    remedy: str = SETUP_AGAIN


RENDER_CODE = """
import numpy as np, trimesh, pyrender
from OpenGL.GL import GL_RENDERER, glGetString
camera_pose = np.eye(4); camera_pose[2, 3] = 3.0
scene = pyrender.Scene(ambient_light=(1.0, 1.0, 1.0))
scene.add(pyrender.Mesh.from_trimesh(trimesh.creation.box((1.0, 1.0, 1.0))))
scene.add(pyrender.PerspectiveCamera(yfov=1.0), pose=camera_pose)
renderer = pyrender.OffscreenRenderer(64, 48)
_, depth = renderer.render(scene)
assert abs(float(depth[24, 32]) - 2.5) < 0.001, f"a box at 2.5 m was rendered at {depth[24, 32]} m"
print(glGetString(GL_RENDERER).decode())
"""

# LOAD of a file: nothing is downloaded, and DuckDB verifies its own signature on it.
EXTENSIONS_CODE = """
import duckdb, importlib.util, pathlib
connection = duckdb.connect(":memory:", config={"autoinstall_known_extensions": False})
for name in ("sqlite_scanner", "ducklake", "spatial"):
    package = importlib.util.find_spec(f"duckdb_extension_{name}")
    assert package and package.origin, f"the package duckdb-extension-{name.replace('_', '-')} is not installed"
    folder = pathlib.Path(package.origin).parent / "extensions" / f"v{duckdb.__version__}"
    connection.execute(f"LOAD '{folder / (name + '.duckdb_extension')}'")
print(f"DuckDB {duckdb.__version__} with ducklake, spatial and sqlite_scanner")
"""

PROBES = (
    Probe(
        name="rendering without a display (EGL)",
        code=RENDER_CODE,
        remedy=format_install_command(["libegl1", "libegl-mesa0", "libgl1", "libgl1-mesa-dri"]),
    ),
    Probe(name="DuckDB extensions", code=EXTENSIONS_CODE),
    Probe(name="pycolmap", code="import pycolmap; print('pycolmap', pycolmap.__version__)"),
    Probe(
        name="Open3D",
        code="import open3d; print('Open3D', open3d.__version__)",
        remedy=format_install_command(["libusb-1.0-0", "libgl1", "libgomp1"]),
    ),
    Probe(name="ONNX Runtime", code="import onnxruntime; print('ONNX Runtime', onnxruntime.__version__)"),
    Probe(name="IfcOpenShell", code="import ifcopenshell.geom; print('IfcOpenShell', ifcopenshell.version)"),
)


def run_checks(lake: Path, model_files: Sequence[Path]) -> list[Check]:
    """Look at everything Facadelake needs here, in a few seconds; nothing is changed and nothing is raised."""
    with ThreadPoolExecutor(max_workers=count_cores()) as pool:
        probed = list(pool.map(check_probe, PROBES))
    libraries = [check_library(library) for library in LIBRARIES]
    here = [check_python(), *libraries, *probed, check_memory(), check_cores()]
    return [*here, check_disk(lake), check_writable(lake), *check_models(model_files)]


def count_cores() -> int:
    """Processor cores this process may use."""
    return len(os.sched_getaffinity(0))


def check_python() -> Check:
    """Interpreter and machine; pycolmap's wheels are for Linux on x86-64 alone."""
    found = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    fits = (3, 11) <= sys.version_info[:2] < (3, 14) and platform.machine() == "x86_64"
    remedy = "" if fits else "use CPython 3.11, 3.12 or 3.13 on Linux x86_64"
    return Check(name="Python", status=Status.OK if fits else Status.MISSING, found=found, remedy=remedy)


def check_library(library: Library) -> Check:
    """Whether the loader finds a library."""
    if is_present(library):
        return Check(name=library.file, status=Status.OK, found=f"for {library.needed_by}")
    found = f"not found; needed by {library.needed_by}"
    remedy = format_install_command([library.package])
    return Check(name=library.file, status=Status.MISSING, found=found, remedy=remedy)


def check_probe(probe: Probe) -> Check:
    """Run a probe in a process of its own; its last line of output, or of complaint, is what was found."""
    code = f"import facadelake\n{probe.code}"
    try:
        done = subprocess.run(
            [sys.executable, "-c", code],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=PROBE_LIMIT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        found = f"no answer within {PROBE_LIMIT_S:.0f} s"
        return Check(name=probe.name, status=Status.MISSING, found=found, remedy=probe.remedy)
    if done.returncode == 0:
        return Check(name=probe.name, status=Status.OK, found=get_last_line(done.stdout))
    found = get_last_line(done.stderr) or f"the process ended with status {done.returncode}"
    return Check(name=probe.name, status=Status.MISSING, found=found, remedy=probe.remedy)


def get_last_line(text: str) -> str:
    """The last line that is not blank, '' if there is none."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else ""


def find_nearest_folder(path: Path) -> Path:
    """The path itself, or the nearest folder above it that exists."""
    resolved = path.expanduser().resolve()
    return next(folder for folder in (resolved, *resolved.parents) if folder.is_dir())


def check_disk(lake: Path) -> Check:
    """Space free where the lake is, or will be."""
    free_gib = shutil.disk_usage(find_nearest_folder(lake)).free / GIB
    enough = free_gib >= DISK_WANTED_GIB
    return Check(
        name="disk space for the lake",
        status=Status.OK if enough else Status.WARNING,
        found=f"{free_gib:.1f} GiB free at {lake}",
        remedy="" if enough else f"free {DISK_WANTED_GIB:.0f} GiB, or choose another disk with --lake",
    )


def check_writable(lake: Path) -> Check:
    """Whether a file can be made where the lake is, or will be."""
    folder = find_nearest_folder(lake)
    try:
        with tempfile.TemporaryFile(dir=folder):
            return Check(name="lake can be written", status=Status.OK, found=f"{folder} takes files")
    except OSError as error:
        found = f"{folder}: {error.strerror}"
        remedy = "choose a folder of yours with --lake"
        return Check(name="lake can be written", status=Status.MISSING, found=found, remedy=remedy)


def check_memory() -> Check:
    """Memory that new work can have, by the kernel's own estimate."""
    fields = dict(line.split(":", 1) for line in Path("/proc/meminfo").read_text().splitlines())
    available_gib = int(fields["MemAvailable"].split()[0]) * 1024 / GIB
    enough = available_gib >= MEMORY_WANTED_GIB
    return Check(
        name="memory",
        status=Status.OK if enough else Status.WARNING,
        found=f"{available_gib:.1f} GiB available",
        remedy="" if enough else f"close other programs: {MEMORY_WANTED_GIB:.0f} GiB are wanted",
    )


def check_cores() -> Check:
    """Processor cores; one core works, slowly."""
    cores = count_cores()
    remedy = "" if cores > 1 else "two cores or more: reconstruction takes its time on one"
    status = Status.OK if cores > 1 else Status.WARNING
    return Check(name="processor cores", status=status, found=str(cores), remedy=remedy)


def check_models(model_files: Sequence[Path]) -> list[Check]:
    """The default detector, and one line a model that the portfolio names."""
    return [check_default_model(), *(check_model(file) for file in model_files)]


def check_default_model() -> Check:
    """The model that looks for defects where a building names none; without it, detections come from files."""
    try:
        return replace(check_model(find_default_model()), name="default detector")
    except ModelError as error:
        found, _, remedy = str(error).partition("; ")
        return Check(name="default detector", status=Status.WARNING, found=found, remedy=remedy)


def check_model(file: Path) -> Check:
    """Whether a model file is there and holds something."""
    try:
        size_bytes = file.stat().st_size
    except OSError as error:
        found = f"{file}: {error.strerror}"
    else:
        if size_bytes > 0:
            return Check(name="detector model", status=Status.OK, found=f"{file}, {size_bytes / 1e6:.1f} MB")
        found = f"{file} is empty"
    remedy = "put the ONNX file there, or name another (or a COCO file of detections) in the portfolio"
    return Check(name="detector model", status=Status.MISSING, found=found, remedy=remedy)
