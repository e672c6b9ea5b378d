"""Check this machine: system libraries, rendering, native packages, disk space for the next campaign, detector models.

Native packages are loaded in separate processes: a crash there is a line in the report, and no two native libraries are
loaded into one process.
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

from facadelake.campaigns import check_grids
from facadelake.core.cache import DIAGNOSTICS, WORK_SIZE_FILE, CacheEntry, open_stage_cache
from facadelake.core.errors import ModelError
from facadelake.core.proj.grids import list_installed_grids
from facadelake.core.system_libraries import LIBRARIES, Library, format_install_command, is_present
from facadelake.detection import find_default_model
from facadelake.lake import read_stage_keys
from facadelake.registry import Building

GIB = 1024**3
DISK_NEEDED_GIB = 5.0  # before a first campaign has shown what one takes
DISK_RESERVE = 1.2  # of what the largest campaign took
MEMORY_NEEDED_GIB = 4.0  # SIFT on two 6 Mpx photographs at once, in addition to Prefect
PROBE_LIMIT_S = 120.0
REPEAT_SETUP = "make distclean setup"


class Status(StrEnum):
    """Result of a check."""

    OK = "ok"
    WARNING = "warning"
    MISSING = "missing"


@dataclass(frozen=True, kw_only=True)
class Check:
    """One line of the report: the object, what was found, and the remedy (empty where nothing is missing)."""

    name: str
    status: Status
    found: str
    remedy: str = ""


@dataclass(frozen=True, kw_only=True)
class Probe:
    """Python code that prints its finding in the last line, or fails."""

    name: str
    code: str
    remedy: str = REPEAT_SETUP


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

# LOAD of a file: nothing is downloaded, and DuckDB verifies the signature.
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


def run_checks(lake: Path, model_files: Sequence[Path], buildings: Sequence[Building] = ()) -> list[Check]:
    """Run all checks, in a few seconds, without changing anything; failed checks are results, not exceptions.

    ``lake`` is the folder of the lake; ``model_files`` are the detector models and ``buildings`` the buildings of the
    portfolio.
    """
    with ThreadPoolExecutor(max_workers=count_cores()) as pool:
        probes = list(pool.map(check_probe, PROBES))
    libraries = [check_library(library) for library in LIBRARIES]
    machine = [check_python(), *libraries, *probes, check_memory(), check_cores()]
    grids = [check_building_grids(building) for building in buildings]
    return [*machine, check_disk(lake), check_writable(lake), *check_models(model_files), *grids]


def count_cores() -> int:
    """Number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0))


def check_python() -> Check:
    """Interpreter and architecture; pycolmap has wheels only for Linux on x86-64."""
    found = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    supported = (3, 11) <= sys.version_info[:2] < (3, 14) and platform.machine() == "x86_64"
    remedy = "" if supported else "use CPython 3.11, 3.12 or 3.13 on Linux x86_64"
    return Check(name="Python", status=Status.OK if supported else Status.MISSING, found=found, remedy=remedy)


def check_library(library: Library) -> Check:
    """Whether the dynamic loader finds a library."""
    if is_present(library):
        return Check(name=library.file, status=Status.OK, found=f"for {library.needed_by}")
    found = f"not found; needed by {library.needed_by}"
    remedy = format_install_command([library.package])
    return Check(name=library.file, status=Status.MISSING, found=found, remedy=remedy)


def check_probe(probe: Probe) -> Check:
    """Run a probe in a separate process; the finding is the last line of its output, or of its error output."""
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
        found = f"no result within {PROBE_LIMIT_S:.0f} s"
        return Check(name=probe.name, status=Status.MISSING, found=found, remedy=probe.remedy)
    if done.returncode == 0:
        return Check(name=probe.name, status=Status.OK, found=get_last_line(done.stdout))
    found = get_last_line(done.stderr) or f"the process ended with status {done.returncode}"
    return Check(name=probe.name, status=Status.MISSING, found=found, remedy=probe.remedy)


def get_last_line(text: str) -> str:
    """The last line that is not blank; empty where there is none."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else ""


def find_nearest_folder(path: Path) -> Path:
    """The path itself, or the nearest existing folder above it."""
    resolved = path.expanduser().resolve()
    return next(folder for folder in (resolved, *resolved.parents) if folder.is_dir())


def check_disk(lake: Path) -> Check:
    """Whether the disk of the lake has room for the next campaign, by the largest one so far."""
    free_gib = shutil.disk_usage(find_nearest_folder(lake)).free / GIB
    largest = find_largest_campaign(lake)
    needed_gib = DISK_NEEDED_GIB if largest is None else DISK_RESERVE * largest.size_bytes / GIB
    took = "" if largest is None else f"; {largest.name} took {largest.size_bytes / GIB:.1f} GiB"
    enough = free_gib >= needed_gib
    remedy = (
        f"the next campaign needs about {needed_gib:.1f} GiB: free space, remove cached results "
        "(facadelake cache prune --older-than 30d), or choose another disk with --lake"
    )
    return Check(
        name="disk space for the next campaign",
        status=Status.OK if enough else Status.WARNING,
        found=f"{free_gib:.1f} GiB free at {lake}{took}",
        remedy="" if enough else remedy,
    )


@dataclass(frozen=True, kw_only=True)
class CampaignSize:
    """Disk space that a campaign took at its largest: cached results, temporary files, published pictures."""

    name: str
    size_bytes: int


def find_largest_campaign(lake: Path) -> CampaignSize | None:
    """The committed campaign that took most space, None where the cache has none; the lake's tables are negligible."""
    sizes = {entry.key: entry for entry in open_stage_cache(lake).list_entries()}
    found = []
    for run in read_stage_keys(lake):
        entries = [sizes[key] for key in run.keys.values() if key in sizes]
        if entries:
            total = sum(entry.size_bytes + read_work_size(entry) for entry in entries)
            pictures = sum(entry.size_bytes for entry in sizes.values() if entry.stage == "draw")
            drawn = sum(entry.stage == "draw" for entry in sizes.values())
            # Pictures are made after the commit, so the run does not name them; each is kept and published.
            total += 2 * pictures // drawn if drawn else 0
            found.append(CampaignSize(name=f"{run.building_id} {run.campaign_id}", size_bytes=total))
    return max(found, key=lambda one: one.size_bytes, default=None)


def read_work_size(entry: CacheEntry) -> int:
    """Bytes of the temporary folder that an entry was made with; 0 where none was recorded."""
    try:
        return int((entry.folder / DIAGNOSTICS / WORK_SIZE_FILE).read_text("utf-8"))
    except (OSError, ValueError):
        return 0


def check_writable(lake: Path) -> Check:
    """Whether files can be created in the folder of the lake, or where it will be created."""
    folder = find_nearest_folder(lake)
    try:
        with tempfile.TemporaryFile(dir=folder):
            return Check(name="write access to the lake", status=Status.OK, found=f"{folder} is writable")
    except OSError as error:
        found = f"{folder}: {error.strerror}"
        remedy = "choose a writable folder with --lake"
        return Check(name="write access to the lake", status=Status.MISSING, found=found, remedy=remedy)


def check_memory() -> Check:
    """Available memory, by the estimate of the kernel."""
    fields = dict(line.split(":", 1) for line in Path("/proc/meminfo").read_text().splitlines())
    available_gib = int(fields["MemAvailable"].split()[0]) * 1024 / GIB
    enough = available_gib >= MEMORY_NEEDED_GIB
    return Check(
        name="memory",
        status=Status.OK if enough else Status.WARNING,
        found=f"{available_gib:.1f} GiB available",
        remedy="" if enough else f"close other programs: {MEMORY_NEEDED_GIB:.0f} GiB are needed",
    )


def check_cores() -> Check:
    """Number of processor cores; a single core is slow."""
    cores = count_cores()
    remedy = "" if cores > 1 else "use two cores or more: reconstruction is slow on one"
    status = Status.OK if cores > 1 else Status.WARNING
    return Check(name="processor cores", status=status, found=str(cores), remedy=remedy)


def check_building_grids(building: Building) -> Check:
    """Whether PROJ has the grids for the CRSs that a building's model and control points state."""
    name, found = f"transformation grids of {building.id}", check_grids(building)
    if found.problems:
        return Check(
            name=name,
            status=Status.WARNING,
            found="; ".join(found.problems),
            remedy="install the grid, or set crs.accept_operation_accuracy_m in the portfolio",
        )
    installed = len(list_installed_grids())
    return Check(
        name=name, status=Status.OK, found=f"{', '.join(found.crs) or 'no CRS stated'}; {installed} grids installed"
    )


def check_models(model_files: Sequence[Path]) -> list[Check]:
    """Check the default detector and each model that the portfolio names."""
    return [check_default_model(), *(check_model(file) for file in model_files)]


def check_default_model() -> Check:
    """Check the default detector, which buildings without a detector use; without it detections must be imported."""
    try:
        return replace(check_model(find_default_model()), name="default detector")
    except ModelError as error:
        found, _, remedy = str(error).partition("; ")
        return Check(name="default detector", status=Status.WARNING, found=found, remedy=remedy)


def check_model(file: Path) -> Check:
    """Check that a model file exists and is not empty."""
    try:
        size_bytes = file.stat().st_size
    except OSError as error:
        found = f"{file}: {error.strerror}"
    else:
        if size_bytes > 0:
            return Check(name="detector model", status=Status.OK, found=f"{file}, {size_bytes / 1e6:.1f} MB")
        found = f"{file} is empty"
    remedy = "copy the ONNX file there, or name another, or a COCO file of detections, in the portfolio"
    return Check(name="detector model", status=Status.MISSING, found=found, remedy=remedy)
