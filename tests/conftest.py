"""What every test may use: the shared data folder, and the versions a failure was seen with."""

import os
import signal
from importlib.metadata import version
from pathlib import Path

import pytest

# Threads of OpenBLAS wait for each other in a loop: with matrices as small as the tests' that doubles the time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

REPOSITORY = Path(__file__).resolve().parents[1]
REPORTED = (
    "numpy", "pandas", "pyarrow", "duckdb", "duckdb-extension-ducklake", "prefect", "pycolmap", "open3d", "pyrender",
    "onnxruntime", "opencv-python-headless", "ifcopenshell", "pyproj", "geopandas", "great-expectations",
)  # fmt: skip


def pytest_configure() -> None:
    """Tests interrupt processes; a shell's background job (`make test &`) would have them inherit an ignored SIGINT."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_report_header() -> list[str]:
    """Versions from the packages' metadata: nothing heavy is imported."""
    found = [f"{name} {version(name)}" for name in REPORTED]
    return [", ".join(found[i : i + 5]) for i in range(0, len(found), 5)]


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the real data sets: FACADELAKE_SHARED_DATA, else ../shared/data beside the checkout."""
    named = os.environ.get("FACADELAKE_SHARED_DATA")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "data"
    if not (folder / "castle").is_dir():
        pytest.skip(f"no data sets in {folder}: set FACADELAKE_SHARED_DATA to the folder that holds castle/")
    return folder
